// SPDX-License-Identifier: GPL-2.0-or-later
// As a page of the web console: a session over WebSocket, for which the server names a second endpoint for the signal lane.
import "../../dist/node_websocket.js";
import assert from "node:assert/strict";
import { request } from "node:http";
import { after, afterEach, before, test } from "node:test";
import type { CheckOut, Client, Credentials, Options } from "../../dist/index.js";
import { eventually, Laboratory } from "./laboratory.js";

interface Socket {
    readonly url: string;
    onmessage: ((event: unknown) => void) | null;
    send(bytes: Uint8Array): void;
    terminate(): void;
}
type SocketClass = new (url: string, protocol: string) => Socket;

/** What went over which lane, and which sockets there are. */
const sent: { readonly lane: "data" | "signal"; readonly operation: string }[] = [];
const sockets = { data: new Set<Socket>(), signal: new Set<Socket>() };
/** As a proxy that does not know of the signal lane. */
let signalIsClosed = false;
/** What the server sends after it was asked to attach the signal lane arrives so much later. */
let attachDelayMs = 0;
const Plain = (globalThis as unknown as { WebSocket: SocketClass }).WebSocket;
class Recorded extends Plain {
    private readonly lane: "data" | "signal";
    constructor(url: string, protocol: string) {
        const lane = url.endsWith("/axon-signal") ? "signal" : "data";
        super(lane === "signal" && signalIsClosed ? "ws://127.0.0.1:1/axon-signal" : url, protocol);
        this.lane = lane;
        sockets[lane].add(this);
    }
    override send(bytes: Uint8Array): void {
        const text = Buffer.from(bytes).toString("latin1");
        const operation = /sendStopSignal|keepAlive|sendToEntity|attachSignalLane/.exec(text)?.[0];
        if (operation !== undefined) sent.push({ lane: this.lane, operation });
        if (operation === "attachSignalLane" && attachDelayMs > 0) this.holdBack(attachDelayMs);
        super.send(bytes);
    }
    private holdBack(ms: number): void {
        const { onmessage } = this;
        const came: unknown[] = [];
        this.onmessage = (event) => void came.push(event);
        setTimeout(() => {
            this.onmessage = onmessage;
            for (const event of came) onmessage?.call(this, event);
        }, ms);
    }
}
(globalThis as unknown as { WebSocket: SocketClass }).WebSocket = Recorded;
const { connect } = await import("../../dist/index.js");

const lab = new Laboratory({ more: ["--console-endpoint", "127.0.0.1:0", "--console-session-endpoint", "127.0.0.1:0", "--console-signal-endpoint", "127.0.0.1:0"] });
const clients: Client[] = [];

/** As ticketFrom() in a page, whose browser adds the origin. */
function ticket(): Promise<Credentials> {
    const url = new URL("ticket", lab.at["console"]);
    return new Promise((resolve, reject) => {
        const asked = request(url, { method: "POST", headers: { Origin: url.origin } }, (answer) => {
            let text = "";
            answer.on("data", (part: Buffer) => (text += part.toString()));
            answer.on("end", () => {
                const { user, password, endpoint } = JSON.parse(text) as Record<string, string>;
                resolve({ user: user ?? "", password: password ?? "", server: endpoint ?? "" });
            });
        });
        asked.on("error", reject);
        asked.end();
    });
}
async function join(options: Options = {}): Promise<Client> {
    const client = await connect({ credentials: ticket, displayName: "page@test", ...options });
    clients.push(client);
    return client;
}
async function fresh(client: Client): Promise<CheckOut> {
    await client.waitFor("Counter", 10_000);
    const robot = await client.checkOut("Counter", { waitMs: 5000 });
    if (robot.entity().latched) await client.rearm("Counter");
    return robot;
}
const lanesOf = (operation: string): string[] => [...new Set(sent.filter((one) => one.operation === operation).map(({ lane }) => lane))];

before(async () => {
    await lab.startServer();
    lab.startCounter();
});
afterEach(async () => {
    await Promise.all(clients.splice(0).map((client) => client.close()));
});
after(() => lab.end());

test("The server names the signal lane of a page, and stops and heartbeats go over it", async () => {
    const client = await join();
    await eventually("the signal lane is there", () => client.connection().signalLane === "own");
    const robot = await fresh(client);
    sent.length = 0;
    const task = robot.run("Count", [{ name: "To", values: [100_000] }]);
    await eventually("it counts", () => (task.report().progress ?? 0) > 0);
    const [receipt] = await client.stop(["Counter"], { standstillMs: 1000 });
    assert.deepEqual([receipt?.confirmed, receipt?.atRest], [true, true]);
    assert.equal((await task.wait(5000)).state, "STOPPED");
    assert.deepEqual([lanesOf("keepAlive"), lanesOf("sendToEntity")], [["signal"], ["data"]]);
    assert.equal(sent.find(({ operation }) => operation === "sendStopSignal")?.lane, "signal");
    await client.rearm("Counter");
    await eventually("it is known to be rearmed", () => !robot.entity().latched);
    assert.ok((await robot.reset()).managerMs !== undefined);
});

test("A lost signal lane ends the session; the next one has both lanes, and the lease is resumed", async () => {
    const client = await join();
    await eventually("the signal lane is there", () => client.connection().signalLane === "own");
    const robot = await fresh(client);
    const heard: string[] = [];
    robot.onOrphaned(() => heard.push("orphaned"));
    robot.onResumed(() => heard.push("resumed"));
    [...sockets.signal].at(-1)?.terminate();
    await eventually("the loss is said", () => heard.includes("orphaned"));
    assert.equal(client.connection().signalLane, "shared");
    await eventually("the lease is resumed", () => heard.includes("resumed"));
    await eventually("both lanes are there", () => client.connected && client.connection().signalLane === "own");
    const [receipt] = await client.stop("held");
    assert.equal(receipt?.confirmed, true);
});

test("An answer that comes late does not cost the session", async () => {
    attachDelayMs = 3000; // longer than a try to connect may take
    const client = await join();
    const robot = await fresh(client);
    await eventually("the signal lane is there", () => client.connection().signalLane === "own", 20_000);
    attachDelayMs = 0;
    assert.deepEqual([robot.lost, client.connection().tries], [undefined, 0]);
    assert.ok(client.connection().ageMs >= 3000, "it is still the first connection");
    const [receipt] = await client.stop(["Counter"]);
    assert.equal(receipt?.confirmed, true);
});

test("Where the signal lane cannot be reached, stops go over the lane of data, until it can", async () => {
    signalIsClosed = true;
    const client = await join();
    const robot = await fresh(client);
    assert.deepEqual([client.connected, client.connection().signalLane], [true, "shared"]);
    sent.length = 0;
    const [receipt] = await client.stop(["Counter"]);
    assert.equal(receipt?.confirmed, true);
    assert.deepEqual(lanesOf("sendStopSignal"), ["data"]);
    signalIsClosed = false;
    // It is tried after 1, 3, 7, 15 and 31 s, and this machine may have been slow until here.
    await eventually("the signal lane is there", () => client.connection().signalLane === "own", 40_000);
    assert.equal(robot.lost, undefined);
    sent.length = 0;
    const [again] = await client.stop(["Counter"]);
    assert.equal(again?.confirmed, true);
    assert.equal(sent.find(({ operation }) => operation === "sendStopSignal")?.lane, "signal");
    await client.rearm("Counter");
    assert.equal((await robot.run("Count", [{ name: "To", values: [2] }]).wait(5000)).state, "SUCCEEDED");
});
