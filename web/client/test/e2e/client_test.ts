// SPDX-License-Identifier: GPL-2.0-or-later
// The library against real processes: axon-server, axon-entity-manager, a robot application that counts.
import assert from "node:assert/strict";
import { execFile } from "node:child_process";
import { after, afterEach, before, test } from "node:test";
import { promisify } from "node:util";
import { type CheckOut, type Client, connect, type Options, Refusal, type TaskReport } from "../../dist/index.js";
import { eventually, Laboratory } from "./laboratory.js";

const lab = new Laboratory({ more: ["--log-level", "info"] });
const clients: Client[] = [];
let counter: ReturnType<Laboratory["startCounter"]>;

async function join(options: Options = {}): Promise<Client> {
    const client = await connect({ server: lab.at["client"] ?? "", displayName: "web@test", ...options });
    clients.push(client);
    return client;
}
async function codeOf(of: Promise<unknown>): Promise<string> {
    return of.then(
        () => "",
        (error: unknown) => (error instanceof Refusal ? error.code : String(error)),
    );
}
/** Free, and not latched: whatever the test before has left. */
async function fresh(client: Client): Promise<CheckOut> {
    await client.waitFor("Counter", 10_000);
    const robot = await client.checkOut("Counter", { waitMs: 5000 });
    if (robot.entity().latched) await client.rearm("Counter");
    return robot;
}
const to = (count: number) => [{ name: "To", values: [BigInt(count)] }];

before(async () => {
    await lab.startServer();
    counter = lab.startCounter();
});
afterEach(async () => {
    await Promise.all(clients.splice(0).map((client) => client.close()));
});
after(() => lab.end());

test("A task runs, reports its progress and its results, while its stream is watched by another", async () => {
    const [client, watcher] = await Promise.all([join(), join()]);
    const { name, category } = await client.waitFor("Counter", 10_000);
    assert.deepEqual([name, category, client.connection().signalLane], ["Counter", "MACHINE", "own"]);
    const robot = await fresh(client);
    const parameter = robot.service("Count").parameters.find((one) => one.name === "To");
    assert.deepEqual([parameter?.dataType, parameter?.required, parameter?.minimum, parameter?.maximum], ["INT", true, 1, 100_000]);
    await watcher.waitFor("Counter", 5000);
    const samples: number[] = [];
    const end = watcher.watch("Counter", ["count"], ({ content }) => content.kind === "scalar" && samples.push(content.value));
    const reports: TaskReport[] = [];
    const task = robot.run("count", [{ name: "To", values: ["10"], fromText: true }]);
    task.onUpdate((report) => reports.push(report));
    const last = await task.wait(10_000);
    assert.equal(last.state, "SUCCEEDED", last.reason?.message);
    assert.deepEqual(last.results.get("Total"), [10n]);
    assert.ok(reports.some(({ progress, feedback }) => progress !== undefined && progress > 0 && progress < 1 && feedback.startsWith("at ")));
    await eventually("the other has its samples", () => samples.includes(10));
    end();
    const details = await watcher.details("Counter");
    assert.ok(details.watchdogs.length > 0);
    await robot.release();
    await eventually("it is free", () => client.find("Counter").holder === undefined);
});

test("Parameters are granted and denied by the robot application, and checked before", async () => {
    const client = await join();
    const robot = await fresh(client);
    await robot.set("Count", { name: "Step", values: [2] });
    await eventually("the holder hears of it", () => robot.service("Count").parameters.find(({ name }) => name === "Step")?.values[0] === 2n);
    await assert.rejects(robot.set("Count", { name: "Step", values: [13] }), (error: Refusal) => error.code === "DENIED" && /bad luck/.test(error.message));
    assert.equal(await codeOf(robot.set("Count", { name: "Step", values: [14] })), "OUT_OF_RANGE");
    await robot.set("Count", { name: "Step", values: [1] });
    assert.equal(robot.run("Count").report().state, "QUEUED");
    assert.equal((await robot.run("Count").wait(5000)).reason?.code, "MISSING_DEPENDENCY");
    await robot.release();
});

test("Pause, resume and cancel, a queue, a reset and a clear", async () => {
    const client = await join();
    const robot = await fresh(client);
    const task = robot.run("Count", to(100_000));
    await eventually("it counts", () => (task.report().progress ?? 0) > 0);
    await task.pause();
    assert.equal(task.report().state, "PAUSED");
    await task.resume();
    const next = robot.run("Count", to(100_000));
    await eventually("it waits in the queue", () => next.report().accepted);
    const reset = await robot.reset();
    assert.equal(reset.tasksEnded, 1);
    assert.equal((await task.wait(5000)).state, "STOPPED");
    await eventually("the next one runs", () => next.report().state === "RUNNING");
    await next.cancel();
    assert.equal(next.report().state, "CANCELLED");
    const cleared = [robot.run("Count", to(100_000)), robot.run("Count", to(100_000))];
    await eventually("both are there", () => cleared.every((one) => one.report().accepted));
    const clear = await robot.clear();
    assert.deepEqual([clear.tasksEnded, clear.tasksRemoved], [1, 1]);
    const ends = await Promise.all(cleared.map((one) => one.wait(5000)));
    assert.deepEqual(ends.map(({ state }) => state), ["STOPPED", "CANCELLED"]);
    assert.equal(client.find("Counter").latched, false);
    await robot.release();
});

test("Anybody stops the robot, with a receipt of every stage; it latches until it is rearmed", async () => {
    const [client, bystander] = await Promise.all([join(), join()]);
    const robot = await fresh(client);
    const task = robot.run("Count", to(100_000));
    await eventually("it counts", () => (task.report().progress ?? 0) > 0);
    await bystander.waitFor("Counter", 5000);
    const stages: string[] = [];
    const [receipt] = await bystander.stop(["Counter"], {
        standstillMs: 2000,
        onProgress: ([one]) => one && stages.push(one.standstillMs !== undefined ? "standstill" : one.callbackReturnedMs !== undefined ? "callback" : one.managerMs !== undefined ? "manager" : "server"),
    });
    assert.ok(receipt);
    assert.deepEqual([receipt.confirmed, receipt.atRest, receipt.applicationLost, receipt.fault], [true, true, "", ""]);
    assert.ok((receipt.standstillMs ?? 0) >= 25, `it stands still 30 ms after the callback: ${JSON.stringify(receipt)}`);
    assert.equal(stages.at(-1), "standstill");
    assert.equal((await task.wait(5000)).state, "STOPPED");
    await eventually("it is latched", () => client.find("Counter").latched);
    assert.equal((await robot.run("Count", to(1)).wait(5000)).reason?.code, "LATCHED");
    await client.rearm("Counter");
    assert.equal((await robot.run("Count", to(1)).wait(5000)).state, "SUCCEEDED");
    const all = await client.stop("all");
    assert.ok(all.length >= 1 && all.every(({ confirmed }) => confirmed));
    assert.deepEqual((await client.stop("held")).map(({ name, confirmed }) => [name, confirmed]), [["Counter", true]]);
    const [drill] = await bystander.drill(["Counter"], 2, 20);
    assert.ok(drill?.callbackMs.every((ms) => ms !== undefined && ms < 500), JSON.stringify(drill));
    await client.rearm("Counter");
    await robot.release();
});

test("Waiting, asking, refusing and handing over", async () => {
    const [ann, ben] = await Promise.all([join({ displayName: "ann@test" }), join({ displayName: "ben@test" })]);
    const robot = await fresh(ann);
    await ben.waitFor("Counter", 5000).catch(() => undefined);
    assert.equal(await codeOf(ben.checkOut("Counter")), "ALREADY_HELD");
    const asked = new Promise<string>((resolve) => robot.onHandOverRequest(({ by, reason }) => resolve(`${by}: ${reason}`)));
    const first = codeOf(ben.checkOut("Counter", { ask: true, reason: "my turn" }));
    assert.match(await asked, /^ben@test.*: my turn$/);
    robot.answerHandOver(false, "in a minute");
    assert.equal(await first, "HAND_OVER_REFUSED");
    const places: number[] = [];
    const second = ben.checkOut("Counter", { ask: true, waitMs: 5000, reason: "now", onWaiting: ({ place }) => places.push(place) });
    await eventually("the question is there", () => robot.handOverRequest() !== undefined);
    const lost = new Promise<string>((resolve) => robot.onLost(({ code, holder }) => resolve(`${code} ${holder}`)));
    robot.answerHandOver(true);
    const his = await second;
    assert.match(await lost, /^REVOKED_LEASE ben@test/);
    assert.equal(his.entity().holder?.name.startsWith("ben@test") ?? true, true);
    const third = ann.checkOut("Counter", { waitMs: 5000 });
    await eventually("she waits", () => ben.find("Counter").waiting === 1);
    await his.release();
    await (await third).release();
});

test("A lost connection: the robot is stopped, the lease is resumed, and what became of the task is known", async () => {
    const client = await join();
    const robot = await fresh(client);
    const heard: string[] = [];
    robot.onOrphaned(() => heard.push("orphaned"));
    robot.onResumed(() => heard.push("resumed"));
    robot.onLost(({ code }) => heard.push(`lost ${code}`));
    const task = robot.run("Count", to(100_000));
    await eventually("it counts", () => (task.report().progress ?? 0) > 0);
    await lab.server.end("SIGKILL");
    await eventually("the loss is said", () => client.connection().kind !== "connected");
    assert.equal(await codeOf(client.stop("all")), "NOT_CONNECTED");
    await lab.startServer();
    await eventually("it is connected again", () => client.connected);
    await eventually("the lease is resumed", () => heard.includes("resumed"));
    assert.deepEqual(heard, ["orphaned", "resumed"]);
    const end = await task.wait(5000);
    assert.equal(end.state, "STOPPED", `${end.reason?.code} ${end.reason?.message}`);
    await eventually("it is latched", () => client.find("Counter").latched);
    await client.rearm("Counter");
    assert.equal((await robot.run("Count", to(1)).wait(5000)).state, "SUCCEEDED");
    await robot.release();
});

test("A ticket takes the lease over, and the session that had it hears of it", async () => {
    const [old, fresher] = await Promise.all([join(), join()]);
    const robot = await fresh(old);
    await fresher.waitFor("Counter", 5000).catch(() => undefined);
    const lost = new Promise<string>((resolve) => robot.onLost(({ code }) => resolve(code)));
    const taken = await fresher.resume(robot.ticket());
    assert.equal(await lost, "REVOKED_LEASE");
    assert.equal((await robot.run("Count", to(1)).wait(5000)).reason?.code, "NOT_HOLDER");
    await taken.release();
});

test("A program that withholds its heartbeat loses its robot, which stops", async () => {
    let alive = true;
    const client = await join({ keepRunning: () => alive, reconnect: false });
    const robot = await fresh(client);
    const before = counter.app.output.split("stop: ").length;
    const task = robot.run("Count", to(100_000));
    await eventually("it counts", () => (task.report().progress ?? 0) > 0);
    alive = false;
    await eventually("the robot is stopped", () => counter.app.output.split("stop: ").length > before, 2000);
    await eventually("the loss is said", () => client.connection().kind === "lost");
    await eventually("the task has an end", () => task.report().state === "UNKNOWN");
});

test("A program that cannot join is told why", async () => {
    assert.equal(await codeOf(connect({ server: "127.0.0.1:1" })), "UNAVAILABLE");
    await assert.rejects(connect({ server: lab.at["entity"] ?? "" }), (error: Refusal) => error.code === "MALFORMED" && /not where clients log in/.test(error.message));
    assert.equal(await codeOf(connect({ server: "nonsense" })), "MALFORMED");
    assert.equal(await codeOf(connect({ server: "ssl://lab:1" })), "NOT_SUPPORTED");
});

test("The example checks out, runs and releases", async () => {
    const client = await join();
    await (await fresh(client)).release();
    const done = await promisify(execFile)(process.execPath, ["examples/drive.mjs", lab.at["client"] ?? "", "Counter", "Count", "To=20"], { timeout: 15_000 });
    assert.match(done.stdout, /RUNNING 50 % at 10/);
    assert.match(done.stdout, /count: 20\n(.*\n)*SUCCEEDED.*\{ Total: \[ 20n \] \}/);
});
