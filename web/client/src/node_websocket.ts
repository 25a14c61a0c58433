// SPDX-License-Identifier: GPL-2.0-or-later
// For Node before version 22, which has no WebSocket: import this before "@axon/client", because Ice looks for it when it is
// loaded. It needs the package `ws`.
import WebSocketOfWs from "ws";

const scope = globalThis as { WebSocket?: unknown; navigator?: unknown };
scope.WebSocket ??= WebSocketOfWs;
scope.navigator ??= { userAgent: "Node" };
