// SPDX-License-Identifier: GPL-2.0-or-later
// By WebSocket, as browsers connect. A relay in this process turns WebSocket into TCP, as a proxy in front of the server may do.
import "../../dist/node_websocket.js";
import assert from "node:assert/strict";
import { connect as connectTcp, type AddressInfo, type Socket } from "node:net";
import { after, before, test } from "node:test";
import { WebSocketServer, type WebSocket as WebSocketOfWs } from "ws";
import { eventually, Laboratory } from "./laboratory.js";

const { connect, Refusal } = await import("../../dist/index.js");

interface Relay {
    readonly url: string;
    /** Ends every connection through it. */
    readonly cut: () => void;
    readonly end: () => void;
    /** Whether it takes what comes from the client: what it does not take fills the network, as a slow one is filled. */
    readonly flow: (on: boolean) => void;
    /** What the server has been given: how many bytes, and before which of them the operations stood that are looked for. */
    readonly bytes: () => number;
    readonly find: (operation: string) => void;
    readonly foundAt: () => number | undefined;
}
function relay(to: string): Promise<Relay> {
    const [host, port] = to.split(":");
    const sockets = new Set<Socket>();
    const webs = new Set<WebSocketOfWs>();
    let bytesOfClient = 0;
    let sought: string | undefined;
    let found: number | undefined;
    const server = new WebSocketServer({ host: "127.0.0.1", port: 0, path: "/axon", handleProtocols: () => "ice.zeroc.com" });
    server.on("connection", (web) => {
        const tcp = connectTcp(Number(port), host);
        sockets.add(tcp);
        tcp.on("data", (bytes) => web.send(bytes));
        tcp.on("close", () => (sockets.delete(tcp), web.close()));
        tcp.on("error", () => web.close());
        webs.add(web);
        web.on("message", (bytes: Buffer) => {
            const at = sought === undefined || found !== undefined ? -1 : bytes.indexOf(sought);
            if (at >= 0) found = bytesOfClient + at;
            bytesOfClient += bytes.length;
            tcp.write(bytes);
        });
        web.on("close", () => (webs.delete(web), tcp.destroy()));
    });
    const flow = (on: boolean): void => webs.forEach((web) => (on ? web.resume() : web.pause()));
    const find = (operation: string): void => void ((sought = operation), (found = undefined));
    const cut = (): void => sockets.forEach((one) => one.destroy());
    return new Promise((resolve) => {
        server.on("listening", () => resolve({ url: `ws://127.0.0.1:${(server.address() as AddressInfo).port}/axon`, cut, end: () => (cut(), server.close()), flow, bytes: () => bytesOfClient, find, foundAt: () => found }));
    });
}

const lab = new Laboratory();
let data: Relay;
let signal: Relay;
before(async () => {
    await lab.startServer();
    lab.startCounter();
    data = await relay(lab.at["client"] ?? "");
    signal = await relay(lab.at["client-signal"] ?? "");
});
after(async () => {
    data.end();
    signal.end();
    await lab.end();
});

test("Two lanes by WebSocket: a task runs, is stopped, and the connection comes back", async () => {
    const client = await connect({ server: data.url, signal: signal.url });
    assert.equal(client.connection().signalLane, "own");
    await client.waitFor("Counter", 10_000);
    const robot = await client.checkOut("Counter");
    const task = robot.run("Count", [{ name: "To", values: [100_000] }]);
    await eventually("it counts", () => (task.report().progress ?? 0) > 0);
    const [receipt] = await client.stop("held", { standstillMs: 1000 });
    assert.deepEqual([receipt?.confirmed, receipt?.atRest], [true, true]);
    assert.equal((await task.wait(5000)).state, "STOPPED");
    const resumed = new Promise<void>((resolve) => robot.onResumed(() => resolve()));
    signal.cut();
    await eventually("the loss is said", () => !client.connected);
    await resumed;
    await client.rearm("Counter");
    assert.equal((await robot.run("Count", [{ name: "To", values: [2] }]).wait(5000)).state, "SUCCEEDED");
    await client.close();
});

test("One lane by WebSocket: stops share it, and still come with their receipts", async () => {
    const client = await connect({ server: data.url, signal: "shared" });
    assert.equal(client.connection().signalLane, "shared");
    await client.waitFor("Counter", 10_000);
    const robot = await client.checkOut("Counter", { waitMs: 5000 });
    if (robot.entity().latched) await client.rearm("Counter");
    const task = robot.run("Count", [{ name: "To", values: [100_000] }]);
    await eventually("it counts", () => (task.report().progress ?? 0) > 0);
    assert.equal((await robot.reset()).tasksEnded, 1);
    assert.equal((await task.wait(5000)).state, "STOPPED");
    const [receipt] = await client.stop(["Counter"], { standstillMs: 1000 });
    assert.ok(receipt?.confirmed && receipt.serverMs !== undefined && receipt.standstillMs !== undefined);
    await client.close();
});

test("A stop on the lane of data leaves at once, with at most 130 KiB of the page's own data before it", async () => {
    const client = await connect({ server: data.url, signal: "shared" });
    await client.waitFor("Counter", 10_000);
    const robot = await client.checkOut("Counter", { waitMs: 5000 });
    if (robot.entity().latched) await client.rearm("Counter");
    data.flow(false);
    const before = data.bytes();
    for (let i = 0; i < 100; ++i) robot.sendRaw(new Uint8Array(60_000).fill(i)); // 6 MB, all admitted
    await new Promise((wake) => setTimeout(wake, 100));
    data.find("sendStopSignal");
    const stopped = client.stop(["Counter"], { deadlineMs: 5000 });
    await new Promise((wake) => setTimeout(wake, 20));
    data.flow(true);
    const [receipt] = await stopped;
    assert.equal(receipt?.confirmed, true);
    const ahead = (data.foundAt() ?? Infinity) - before;
    assert.ok(ahead < 131 * 1024, `${ahead} bytes left before the stop`);
    // What was held back is not lost.
    await eventually("all of it has left", () => data.bytes() - before > 6_000_000);
    await client.rearm("Counter");
    await client.close();
});

test("An address where nothing answers by WebSocket is said", async () => {
    await assert.rejects(connect({ server: "ws://127.0.0.1:1/axon", timeoutMs: 2000 }), (error: unknown) => error instanceof Refusal && error.code === "UNAVAILABLE");
});
