// SPDX-License-Identifier: GPL-2.0-or-later
// By WebSocket, as browsers connect. A relay in this process turns WebSocket into TCP, as a proxy in front of the server may do.
import "../../dist/node_websocket.js";
import assert from "node:assert/strict";
import { connect as connectTcp, type AddressInfo, type Socket } from "node:net";
import { after, before, test } from "node:test";
import { WebSocketServer } from "ws";
import { eventually, Laboratory } from "./laboratory.js";

const { connect, Refusal } = await import("../../dist/index.js");

/** Its URL, and what ends every connection through it. */
function relay(to: string): Promise<{ url: string; cut: () => void; end: () => void }> {
    const [host, port] = to.split(":");
    const sockets = new Set<Socket>();
    const server = new WebSocketServer({ host: "127.0.0.1", port: 0, path: "/axon", handleProtocols: () => "ice.zeroc.com" });
    server.on("connection", (web) => {
        const tcp = connectTcp(Number(port), host);
        sockets.add(tcp);
        tcp.on("data", (bytes) => web.send(bytes));
        tcp.on("close", () => (sockets.delete(tcp), web.close()));
        tcp.on("error", () => web.close());
        web.on("message", (bytes: Buffer) => tcp.write(bytes));
        web.on("close", () => tcp.destroy());
    });
    const cut = (): void => sockets.forEach((one) => one.destroy());
    return new Promise((resolve) => {
        server.on("listening", () => resolve({ url: `ws://127.0.0.1:${(server.address() as AddressInfo).port}/axon`, cut, end: () => (cut(), server.close()) }));
    });
}

const lab = new Laboratory();
let data: Awaited<ReturnType<typeof relay>>;
let signal: Awaited<ReturnType<typeof relay>>;
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

test("An address where nothing answers by WebSocket is said", async () => {
    await assert.rejects(connect({ server: "ws://127.0.0.1:1/axon", timeoutMs: 2000 }), (error: unknown) => error instanceof Refusal && error.code === "UNAVAILABLE");
});
