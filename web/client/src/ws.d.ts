// SPDX-License-Identifier: GPL-2.0-or-later
declare module "ws" {
    const WebSocketOfWs: unknown;
    export default WebSocketOfWs;
}
