// SPDX-License-Identifier: GPL-2.0-or-later
declare module "ws" {
    import type { AddressInfo } from "node:net";
    export interface WebSocket {
        send(bytes: Uint8Array): void;
        close(): void;
        pause(): void;
        resume(): void;
        on(event: "message", call: (bytes: Buffer) => void): void;
        on(event: "close", call: () => void): void;
    }
    export class WebSocketServer {
        constructor(options: { host: string; port: number; path: string; handleProtocols: () => string });
        on(event: "connection", call: (web: WebSocket) => void): void;
        on(event: "listening", call: () => void): void;
        address(): AddressInfo | string | null;
        close(): void;
    }
}
