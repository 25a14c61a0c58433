// SPDX-License-Identifier: GPL-2.0-or-later
// The session logic on a clock that tests move, against a server that only remembers.
import assert from "node:assert/strict";
import { test } from "node:test";
import type { CheckOut, ConnectionReport, Refusal as RefusalType, TaskReport } from "../../dist/index.js";
import { connect, Refusal } from "../../dist/index.js";
import { FakeClock, FakeServer, KEY, ME, OTHER, ARM, refusal, ROBOT, settle, type World, world } from "./support.js";

async function held(options: Parameters<typeof world>[0] = {}): Promise<World & { robot: CheckOut }> {
    const all = await world(options);
    const asked = all.client.checkOut("PeopleBot");
    await settle();
    all.server.grant(ROBOT);
    const robot = await asked;
    all.server.status(ROBOT, { state: "REG", holder: ME, held: { epoch: 1, number: 1 } });
    all.server.take();
    return { ...all, robot };
}
const stateNumber = { QUEUED: 1, RUNNING: 3, PAUSED: 4, SUCCEEDED: 5 } as const;
function event(server: FakeServer, taskId: Uint8Array, state: keyof typeof stateNumber, more = {}): void {
    server.say(ROBOT, { task: { taskId, state: stateNumber[state], progress: -1, ...more } });
}

test("Entities join, change and leave, whichever of profile and status comes first", async () => {
    const { server, client } = await world();
    const news: string[] = [];
    client.onEntity(({ presence, entity, connectionLost }) => news.push(`${presence} ${entity.name} ${entity.state}${connectionLost ? " lost" : ""}`));
    server.status(ARM, { state: "BUSY", holder: OTHER });
    server.join(ARM, "Cyton", { state: "BUSY", holder: OTHER });
    server.events.profile("changed", { entity: ROBOT, name: "PeopleBot", category: "", type: "" }, new Uint8Array(0));
    server.events.profile("left", { entity: ARM, name: "", category: "", type: "" }, new Uint8Array(0));
    server.events.closed("the cable was pulled");
    assert.deepEqual(news, ["joined PeopleBot IDLE", "joined Cyton BUSY", "changed Cyton BUSY", "left PeopleBot IDLE", "left Cyton BUSY"]);
    assert.deepEqual(client.entities("all"), []);
});

test("A check-out gives a lease, and commands carry it with the newest stop generation", async () => {
    const { server, robot } = await held();
    server.status(ROBOT, { state: "REG", stopGeneration: 6, holder: ME, held: { epoch: 1, number: 1 } });
    const task = robot.run("drive", [{ name: "Distance", values: [100n] }], 2000);
    const { head, body } = server.message("task");
    assert.deepEqual([head.entity, head.msgType, head.held, head.stopGeneration], [ROBOT, "TASK", { epoch: 1, number: 1 }, 6]);
    assert.deepEqual([body.service, body.params[0]?.values[0]?.dbl, body.notAfterS, task.report().state], ["Drive", 100, 2, "QUEUED"]);
});

test("What the profile does not admit is refused before it is sent", async () => {
    const { server, robot } = await held();
    const refused = (service: string, name: string, value: number | string): RefusalType | undefined => robot.run(service, [{ name, values: [value] }]).report().reason;
    assert.equal(refused("Drive", "Distance", 6000)?.code, "OUT_OF_RANGE");
    assert.equal(refused("Drive", "Mode", "medium")?.code, "OUT_OF_RANGE");
    assert.equal(refused("Drive", "Distanc", 1)?.code, "UNKNOWN_PARAMETER");
    assert.equal(refused("Fly", "Distance", 1)?.code, "UNKNOWN_SERVICE");
    assert.equal(server.take().length, 0);
    server.backlog = { messages: 256, bytes: 0 };
    assert.equal(refused("Drive", "Distance", 1)?.code, "OVERLOADED");
});

test("What the server would end the session for is refused before it is sent or counted", async () => {
    const { server, client, robot } = await held();
    server.take();
    const code = async (call: () => unknown): Promise<string> => (await refusal(async () => void (await call()))).code;
    assert.equal(await code(() => robot.sendText("x".repeat(100_000))), "TOO_LARGE");
    assert.equal(await code(() => robot.sendRaw(new Uint8Array(100_000))), "TOO_LARGE");
    assert.deepEqual([server.take(), client.connected], [[], true]);
    robot.sendText("x".repeat(99_000));
    const first = server.message("text").head.seq;
    await refusal(async () => void robot.sendText("x".repeat(100_000)));
    robot.sendText("short");
    assert.equal(server.message("text").head.seq, first + 1);
});

test("A grant that comes too late is released", async () => {
    const { clock, server, client } = await world();
    const asked = client.checkOut("PeopleBot");
    await settle();
    const { body } = server.message("checkOut");
    await Promise.all([refusal(asked).then(({ code }) => assert.equal(code, "TIMED_OUT")), clock.advance(5001)]);
    assert.equal(server.message("checkOut").body.phase, 4); // ABORT
    server.say(ROBOT, { checkOut: { requestId: body.requestId, phase: 1, lease: { epoch: 1, number: 4, key: KEY } } });
    assert.deepEqual(server.message("release").head.held, { epoch: 1, number: 4 });
    assert.equal(client.held().length, 0);
});

test("Several are reserved and then committed, all or none", async () => {
    const { server, client } = await world();
    server.join(ARM, "Cyton");
    const asked = client.checkOutAll(["PeopleBot", "Cyton"]);
    await settle();
    const [one, two] = [server.message("checkOut"), server.message("checkOut")];
    assert.deepEqual([one.body.phase, two.body.phase], [2, 2]);
    for (const { head, body } of [one, two]) server.say(head.entity, { checkOut: { requestId: body.requestId, phase: 2 } });
    const commits = [server.message("checkOut"), server.message("checkOut")];
    assert.deepEqual(commits.map(({ body }) => body.phase), [3, 3]);
    const [first, second] = commits as [(typeof commits)[0], (typeof commits)[0]];
    server.say(first.head.entity, { checkOut: { requestId: first.body.requestId, phase: 3, lease: { epoch: 1, number: 1, key: KEY }, graceMs: 5000 } });
    server.say(second.head.entity, { checkOut: { requestId: second.body.requestId, phase: 3, refusal: { code: 6, message: "too late" } } });
    assert.equal((await refusal(asked)).code, "EXPIRED");
    assert.equal(server.message("release").head.entity, first.head.entity);
    assert.equal(client.held().length, 0);
});

test("A place in a wait list is asked for again every 5 s, and told", async () => {
    const { clock, server, client } = await world();
    server.status(ROBOT, { state: "REG", holder: OTHER });
    const waits: [number, string][] = [];
    const stop = new AbortController();
    const asked = client.checkOut("PeopleBot", { waitMs: 60_000, onWaiting: ({ place, message }) => waits.push([place, message]), signal: stop.signal });
    await settle();
    const { body } = server.message("checkOut");
    assert.equal(body.wait, true);
    server.say(ROBOT, { checkOut: { requestId: body.requestId, phase: 1, place: 2 } });
    await clock.advance(5001);
    assert.deepEqual(server.message("checkOut").body.requestId, body.requestId);
    server.say(ROBOT, { checkOut: { requestId: body.requestId, phase: 1, place: 1 } });
    assert.deepEqual(waits.map(([place]) => place), [2, 1]);
    assert.match(waits[0]?.[1] ?? "", /Place 2 in the wait list of PeopleBot, which is held by other@there/);
    stop.abort();
    assert.equal((await refusal(asked)).code, "CANCELLED");
    assert.equal(server.message("checkOut").body.phase, 4);
});

test("A heartbeat goes at a fifth of the watchdog, and at once when a task is sent", async () => {
    const { clock, server, robot } = await held();
    await clock.advance(9000);
    assert.equal(server.beats(), 4); // every 2 s
    server.events.heartbeat();
    const task = robot.run("Drive", [{ name: "Distance", values: [1] }]);
    const { body } = server.message("task");
    await clock.advance(0);
    assert.equal(server.beats(), 1);
    event(server, body.taskId, "RUNNING");
    server.status(ROBOT, { state: "BUSY", holder: ME, held: { epoch: 1, number: 1 } });
    for (let i = 0; i < 10; ++i) {
        server.events.heartbeat();
        await clock.advance(100);
    }
    assert.equal(server.beats(), 20); // every 50 ms
    event(server, body.taskId, "SUCCEEDED");
    assert.equal(task.report().state, "SUCCEEDED");
    server.status(ROBOT, { state: "REG", holder: ME, held: { epoch: 1, number: 1 } });
    await clock.advance(2000);
    assert.ok(server.beats() <= 2);
});

test("The program may withhold the heartbeat while a task runs, and only then", async () => {
    let alive = true;
    const { clock, server, robot } = await held({ keepRunning: () => alive });
    alive = false;
    await clock.advance(4000);
    assert.equal(server.beats(), 2);
    robot.run("Drive", [{ name: "Distance", values: [1] }]);
    await clock.advance(500);
    assert.equal(server.beats(), 0);
});

test("A server that is silent is given up: after 1 s while it sees a robot of ours busy, otherwise after 10 s", async () => {
    const { clock, server, client } = await held();
    server.status(ROBOT, { state: "BUSY", holder: ME, held: { epoch: 1, number: 1 } });
    await clock.advance(990);
    assert.ok(client.connected);
    await clock.advance(20);
    assert.equal(client.connection().kind, "lost");
    assert.match(client.connection().reason, /silent/);
});

test("A program that was frozen does not blame the server for it", async () => {
    const { clock, client } = await held();
    await clock.freeze(60_000);
    assert.ok(client.connected);
});

/** What onConnection said of the server's silence, without repetitions. */
function silences(client: World["client"]): boolean[] {
    const said: boolean[] = [];
    client.onConnection(({ silent }) => silent !== said.at(-1) && said.push(silent));
    return said;
}
const NOTICE_MS = 800;

test("A silent server is told in the time that the program has chosen, and no longer than it is silent", async () => {
    const { clock, server, client } = await held({ noticeSilenceMs: NOTICE_MS });
    const said = silences(client);
    server.events.heartbeat();
    await clock.advance(NOTICE_MS - 1);
    assert.equal(client.connection().silent, false);
    await clock.advance(1);
    const now = client.connection();
    assert.deepEqual([now.kind, now.silent, now.silentMs], ["connected", true, NOTICE_MS]);
    await clock.advance(3000);
    assert.deepEqual(said, [false, true]);
    server.status(ROBOT, { state: "REG", holder: ME, held: { epoch: 1, number: 1 } });
    assert.deepEqual([said, client.connection().silent], [[false, true, false], false]);
});

test("Whatever the server sends is a sign of life", async () => {
    const { clock, server, client } = await held({ noticeSilenceMs: NOTICE_MS });
    const said = silences(client);
    const signs = [
        () => server.events.heartbeat(),
        () => server.events.profile("joined", { entity: ARM, name: "Cyton", category: "", type: "" }, new Uint8Array(0)),
        () => server.status(ROBOT, { state: "REG", holder: ME, held: { epoch: 1, number: 1 } }),
        () => server.receipt(ROBOT, 99, {}),
        () => server.events.stopAccepted({ entity: ROBOT, msgType: "STOP", held: { epoch: 0, number: 0 }, stopGeneration: 0, seq: 99, sentAtUs: 0 }, 1),
        () => server.events.refused({ entity: ROBOT, msgType: "STOP", held: { epoch: 0, number: 0 }, stopGeneration: 0, seq: 99, sentAtUs: 0 }, new Refusal("UNAVAILABLE", "away")),
        () => server.events.serverText(0, "hello"),
    ];
    for (const sign of signs) {
        await clock.advance(NOTICE_MS - 1);
        sign();
    }
    assert.deepEqual(said, [false]);
});

test("A server at rest is asked for signs of life, so that it need not send them by itself", async () => {
    const { clock, server, client } = await held({ noticeSilenceMs: NOTICE_MS });
    const said = silences(client);
    server.take();
    let asked = 0;
    for (let i = 0; i < 40; ++i) {
        await clock.advance(100);
        for (const { what } of server.take()) {
            if (what !== "ask") continue;
            ++asked;
            server.events.heartbeat(); // its answer
        }
    }
    assert.equal(asked, 20); // four times in each time of notice
    assert.deepEqual(said, [false]);
});

test("Without a time of notice the server is not asked, and its silence is told only as the end of the connection", async () => {
    const { clock, server, client } = await held();
    const said = silences(client);
    await clock.advance(9000);
    assert.equal(server.take().filter(({ what }) => what === "ask").length, 0);
    assert.deepEqual(said, [false]);
});

test("A question is no heartbeat: it goes on while the program withholds those", async () => {
    const { clock, server, robot } = await held({ noticeSilenceMs: NOTICE_MS, keepRunning: () => false });
    robot.run("Drive", [{ name: "Distance", values: [1] }]);
    server.take();
    await clock.advance(400);
    assert.deepEqual(server.take().map(({ what }) => what), ["ask", "ask"]);
});

test("A program that was frozen does not call the server silent when it goes on", async () => {
    const { clock, server, client } = await held({ noticeSilenceMs: NOTICE_MS });
    const said = silences(client);
    await clock.freeze(60_000);
    await clock.advance(NOTICE_MS - 1); // what has come meanwhile is still to be read
    server.events.heartbeat();
    await clock.advance(0);
    assert.deepEqual(said, [false]);
});

test("A program whose timers ring once in a second calls a silent server silent, and gives it up", async () => {
    const { clock, server, client } = await held({ noticeSilenceMs: NOTICE_MS });
    const said = silences(client);
    for (let i = 0; i < 5; ++i) {
        await clock.advanceThrottled(1000, 1000);
        server.events.heartbeat();
    }
    assert.deepEqual(said, [false]);
    await clock.advanceThrottled(2000, 1000);
    assert.deepEqual([client.connection().kind, said], ["connected", [false, true]]);
    await clock.advanceThrottled(9000, 1000);
    assert.equal(client.connection().kind, "lost");
    assert.match(client.connection().reason, /silent/);
});

test("When the server was last heard stays the same while the computer sleeps", async () => {
    const { clock, server, client } = await held({ noticeSilenceMs: NOTICE_MS });
    server.events.heartbeat();
    const heardAt = clock.date();
    await clock.advance(NOTICE_MS);
    clock.sleep(9 * 3_600_000);
    await clock.advance(1000);
    const { silent, silentMs, heardAt: told } = client.connection();
    assert.deepEqual([silent, silentMs, told], [true, NOTICE_MS + 1000, heardAt]);
    server.events.heartbeat();
    assert.equal(client.connection().heardAt, clock.date());
});

test("A server that was silent before the program was frozen stays silent until it is heard", async () => {
    const { clock, server, client } = await held({ noticeSilenceMs: NOTICE_MS });
    const said = silences(client);
    await clock.advance(NOTICE_MS);
    await clock.freeze(5000);
    assert.deepEqual([said, client.connection().silentMs], [[false, true], NOTICE_MS + 5000]);
    server.events.heartbeat();
    assert.deepEqual(said, [false, true, false]);
});

test("A server that was silent and is lost is no longer called silent, nor after the next log-in", async () => {
    const { clock, server, client } = await held({ noticeSilenceMs: NOTICE_MS });
    const said = silences(client);
    await clock.advance(NOTICE_MS);
    server.events.closed("the cable was pulled");
    assert.deepEqual([client.connection().kind, client.connection().silent, client.connection().silentMs], ["lost", false, NOTICE_MS]);
    await clock.advance(500);
    assert.equal(client.connection().kind, "connected");
    assert.deepEqual(said, [false, true, false]);
});

test("A lost connection is said with its age, and tried again with back-off", async () => {
    const { clock, server, client } = await world();
    const said: ConnectionReport[] = [];
    client.onConnection((report) => said.push(report));
    server.refuse = new Refusal("NOT_CONNECTED", "nothing listens there");
    const logins = server.logins.length;
    server.events.closed("the cable was pulled");
    const at: number[] = [];
    for (let i = 0; i < 700; ++i) {
        await clock.advance(10);
        if (server.logins.length > logins + at.length) at.push((i + 1) * 10);
    }
    assert.deepEqual(at, [100, 300, 700, 1500, 3100, 5100]);
    const now = client.connection();
    assert.deepEqual([now.kind, now.ageMs, now.tries, now.reason], ["lost", 7000, 6, "nothing listens there"]);
    assert.equal((await refusal(client.details("PeopleBot"))).code, "NOT_CONNECTED");
    server.refuse = undefined;
    await clock.advance(200);
    assert.equal(client.connection().kind, "connected");
    assert.deepEqual(said.map(({ kind }) => kind).filter((kind, i, all) => kind !== all[i - 1]).slice(0, 4), ["connected", "lost", "reconnecting", "lost"]);
    assert.equal(said.at(-1)?.kind, "connected");
});

test("Credentials are asked for before every log-in", async () => {
    let count = 0;
    const { clock, server } = await world({ credentials: async () => ({ password: `ticket ${++count}` }), user: "ann" });
    server.events.closed("away");
    await clock.advance(150);
    assert.deepEqual(server.logins.map(({ user, password }) => [user, password]), [["ann", "ticket 1"], ["ann", "ticket 2"]]);
});

test("A lease is resumed with its key, and its tasks are asked after", async () => {
    const { clock, server, client, robot } = await held();
    const heard: string[] = [];
    robot.onOrphaned(() => heard.push("orphaned"));
    robot.onResumed(() => heard.push("resumed"));
    robot.onLost(({ code }) => heard.push(`lost ${code}`));
    const task = robot.run("Drive", [{ name: "Distance", values: [1] }]);
    const { body } = server.message("task");
    event(server, body.taskId, "RUNNING", { progress: 0.5 });
    server.take();
    server.events.closed("the cable was pulled");
    assert.deepEqual([robot.orphaned, task.report().state], [true, "RUNNING"]);
    assert.equal((await refusal(() => robot.sendText("hello"))).code, "NOT_CONNECTED");
    await clock.advance(150);
    assert.equal(client.connection().kind, "connected");
    server.join(ROBOT, "PeopleBot", { state: "REG", latched: true, orphaned: true, holder: { ...ME, id: "old" }, held: { epoch: 1, number: 1 } });
    const resume = server.message("checkOut");
    assert.deepEqual([resume.body.phase, resume.body.resume?.number, [...(resume.body.resume?.key ?? [])], resume.head.held.number], [5, 1, [...KEY], 0]);
    assert.ok(!server.take().some((one) => "body" in one && one.body.task !== undefined), "a task is never sent again");
    server.say(ROBOT, { checkOut: { requestId: resume.body.requestId, phase: 5, lease: { epoch: 1, number: 1 }, stopGeneration: 9, latched: true, graceMs: 5000 } });
    const asked = server.message("statusRequest");
    server.say(ROBOT, { status: { state: 5, stopGeneration: 9, requestId: asked.body.requestId, ended: [{ taskId: body.taskId, state: 7, progress: -1, reason: { code: 68, message: "stopped" } }] } });
    assert.deepEqual([heard, robot.orphaned, task.report().state, task.report().reason?.code], [["orphaned", "resumed"], false, "STOPPED", "STOPPED"]);
});

test("An entity that leaves its server has the grace to come back by another one", async () => {
    const { clock, server, client, robot } = await held();
    const heard: string[] = [];
    robot.onOrphaned(() => heard.push("orphaned"));
    robot.onResumed(() => heard.push("resumed"));
    robot.onLost(({ code }) => heard.push(`lost ${code}`));
    const leave = (): void => server.events.profile("left", { entity: ROBOT, name: "", category: "", type: "" }, new Uint8Array(0));
    leave();
    await clock.advance(4900);
    assert.deepEqual(heard, ["orphaned"]);
    server.join(ROBOT, "PeopleBot", { state: "REG", latched: true, orphaned: true, holder: ME, held: { epoch: 1, number: 1 } });
    server.grant(ROBOT);
    assert.deepEqual([heard, robot.orphaned], [["orphaned", "resumed"], false]);
    server.events.heartbeat();
    leave();
    await clock.advance(4900);
    assert.deepEqual(heard, ["orphaned", "resumed", "orphaned"]);
    await clock.advance(101);
    assert.deepEqual([heard.at(-1), client.connection().kind], ["lost UNAVAILABLE", "connected"]);
});

test("An entity that was away is resumed, also if nobody told that it had left", async () => {
    const { clock, server, robot } = await held();
    const heard: string[] = [];
    robot.onOrphaned(() => heard.push("orphaned"));
    robot.onResumed(() => heard.push("resumed"));
    robot.onLost(({ code }) => heard.push(`lost ${code}`));
    const waits = (orphaned: boolean): void => server.status(ROBOT, { state: "REG", latched: true, orphaned, holder: ME, held: { epoch: 1, number: 1 } });
    server.take();
    waits(true);
    waits(false);
    await clock.advance(1500);
    assert.deepEqual([heard, robot.orphaned], [[], false], "for a moment only");
    waits(true);
    await clock.advance(999);
    assert.deepEqual(heard, [], "the news of it may follow");
    await clock.advance(1);
    assert.deepEqual(heard, ["orphaned"]);
    server.grant(ROBOT);
    assert.deepEqual([heard, robot.orphaned], [["orphaned", "resumed"], false]);
});

test("A task that nobody knows of after a lost connection is UNKNOWN, and a late sign of it is cancelled", async () => {
    const { clock, server, robot } = await held();
    const task = robot.run("Drive", [{ name: "Distance", values: [1] }]);
    const { body } = server.message("task");
    server.events.closed("the cable was pulled");
    await clock.advance(150);
    server.join(ROBOT, "PeopleBot", { state: "REG", latched: true, orphaned: true, holder: { ...ME, id: "old" }, held: { epoch: 1, number: 1 } });
    server.grant(ROBOT);
    server.say(ROBOT, { status: { state: 5, requestId: server.message("statusRequest").body.requestId } });
    assert.deepEqual([task.report().state, task.report().reason?.code], ["UNKNOWN", "OUTCOME_UNKNOWN"]);
    event(server, body.taskId, "RUNNING");
    assert.deepEqual([server.message("taskControl").body.action, task.report().state], [3, "UNKNOWN"]);
});

test("A lease that is not back in time is lost, and its tasks are UNKNOWN", async () => {
    const { clock, server, robot } = await held();
    const lost: string[] = [];
    robot.onLost(({ code }) => lost.push(code));
    const task = robot.run("Drive", [{ name: "Distance", values: [1] }]);
    server.refuse = new Refusal("NOT_CONNECTED", "away");
    server.events.closed("the cable was pulled");
    await clock.advance(14_900);
    assert.deepEqual(lost, []);
    await clock.advance(200); // the grace of 5 s and the 10 s that the server has to notice
    assert.deepEqual([lost, task.report().state], [["NOT_CONNECTED"], "UNKNOWN"]);
    assert.equal((await refusal(() => robot.sendText("x"))).code, "NOT_CONNECTED");
});

test("The lease's loss is told with its reason, whoever took it", async () => {
    const { server, robot, client } = await held();
    const lost: string[] = [];
    robot.onLost(({ code, holder }) => lost.push(`${code} ${holder}`));
    server.say(ROBOT, { leaseEnded: { lease: { epoch: 1, number: 1 }, reason: { code: 4, message: "admin@lab took it over", holder: "admin@lab" } } });
    assert.deepEqual([lost, client.held().length], [["REVOKED_LEASE admin@lab"], 0]);
    assert.equal((await refusal(() => robot.sendText("x"))).code, "NOT_HOLDER");
    assert.equal(robot.run("Drive").report().reason?.code, "NOT_HOLDER");
    const late: string[] = [];
    robot.onLost(({ code }) => late.push(code));
    assert.deepEqual(late, ["REVOKED_LEASE"]);
});

test("A refusal that names a newer lease ends this one", async () => {
    const { server, robot } = await held();
    const done = refusal(robot.set("Drive", { name: "Laps", values: [2] }));
    const { body } = server.message("setParam");
    server.say(ROBOT, { reply: { requestId: body.requestId, refusal: { code: 3, message: "a newer lease exists" } } });
    assert.equal((await done).code, "OLDER_LEASE");
    assert.equal(robot.lost?.code, "OLDER_LEASE");
});

test("Reports of a task never go back, and never leave a final state", async () => {
    const { server, robot } = await held();
    const reports: TaskReport[] = [];
    const task = robot.run("Drive", [{ name: "Distance", values: [1] }]);
    task.onUpdate((report) => reports.push(report));
    const { body } = server.message("task");
    event(server, body.taskId, "RUNNING", { progress: 0.5, feedback: "half" });
    event(server, body.taskId, "QUEUED");
    event(server, body.taskId, "RUNNING", { progress: 0.25 });
    event(server, body.taskId, "SUCCEEDED", { results: [{ name: "__proto__", values: [{ dbl: 3 }] }] });
    event(server, body.taskId, "RUNNING");
    assert.deepEqual(reports.map(({ state, progress, feedback }) => [state, progress, feedback]), [
        ["QUEUED", undefined, ""],
        ["RUNNING", 0.5, "half"],
        ["RUNNING", 0.5, "half"],
        ["SUCCEEDED", 0.5, "half"],
    ]);
    assert.deepEqual(task.report().results.get("__proto__"), [3]);
});

test("Pause resolves when the task is paused, and a newer request takes the place of an older", async () => {
    const { server, robot } = await held();
    const task = robot.run("Drive", [{ name: "Distance", values: [1] }]);
    const { body } = server.message("task");
    event(server, body.taskId, "RUNNING");
    const paused = task.pause();
    assert.equal(server.message("taskControl").body.action, 1);
    event(server, body.taskId, "PAUSED");
    await paused;
    const resumed = refusal(task.resume());
    const cancelled = task.cancel();
    assert.equal((await resumed).code, "CANCELLED");
    server.say(ROBOT, { task: { taskId: body.taskId, state: 8, progress: -1 } });
    await cancelled;
    assert.equal((await refusal(task.pause())).code, "WRONG_STATE");
});

test("A request that nobody answers is refused in time, and a task is cancelled then", async () => {
    const { clock, server, robot } = await held();
    const set = refusal(robot.set("Drive", { name: "Laps", values: [2] }));
    const task = robot.run("Drive", [{ name: "Distance", values: [1] }]);
    for (let i = 0; i < 6; ++i) {
        server.events.heartbeat();
        await clock.advance(900);
    }
    assert.equal((await set).code, "TIMED_OUT");
    assert.deepEqual([task.report().state, server.message("taskControl").body.action], ["UNKNOWN", 3]);
});

test("Somebody asks for the robot: the holder is told, answers, and hears of a withdrawal", async () => {
    const { clock, server, robot } = await held();
    const asked: [string, boolean][] = [];
    robot.onHandOverRequest(({ by, withdrawn }) => asked.push([by, withdrawn]));
    const id = new Uint8Array(16).fill(9);
    server.say(ROBOT, { handOver: { requestId: id, by: "ana", reason: "my turn", answerWithinS: 30, yield: true } });
    server.say(ROBOT, { handOver: { requestId: id, by: "ana", reason: "my turn", answerWithinS: 30, yield: true } });
    await clock.advance(1000);
    assert.equal(robot.handOverRequest()?.answerWithinMs, 29_000);
    robot.answerHandOver(false, "in a minute");
    const { body } = server.message("handOverAnswer");
    assert.deepEqual([[...body.requestId], body.accept, body.reason], [[...id], false, "in a minute"]);
    assert.equal((await refusal(() => robot.answerHandOver(true))).code, "WRONG_STATE");
    server.say(ROBOT, { handOver: { requestId: id, by: "ben", answerWithinS: 30 } });
    server.say(ROBOT, { handOver: { requestId: id, by: "ben", withdrawn: true } });
    assert.deepEqual(asked, [["ana", false], ["ben", false], ["ben", true]]);
});

test("Streams are watched again after a lost connection, and only what is watched is told", async () => {
    const { clock, server, client } = await world();
    const seen: string[] = [];
    const end = client.watch("PeopleBot", ["laser"], ({ stream, sequence, content }) => seen.push(`${stream} ${sequence} ${content.kind}`));
    assert.deepEqual(server.message("watch").body, { streams: ["laser"], on: true });
    server.say(ROBOT, { sample: { stream: "laser", sequence: 1n, scan: { ranges: [1, 2], step: 0.1 } } });
    server.say(ROBOT, { sample: { stream: "camera", sequence: 1n, image: { width: 1, height: 1, encoding: "jpeg" } } });
    server.events.closed("away");
    await clock.advance(150);
    server.join(ROBOT, "PeopleBot");
    assert.equal(server.message("watch").body.on, true);
    server.say(ROBOT, { sample: { stream: "laser", sequence: 7n, pose: { x: 1 } } });
    end();
    assert.equal(server.message("watch").body.on, false);
    server.say(ROBOT, { sample: { stream: "laser", sequence: 8n, pose: { x: 1 } } });
    assert.deepEqual(seen, ["laser 1 scan", "laser 7 pose"]);
});

test("An upload goes on from where the Entity Manager says, within its credit, and says its hash", async () => {
    const { server, robot } = await held();
    const file = new Uint8Array(200_000).map((_, i) => i % 256);
    const progress: number[] = [];
    const done = robot.upload("Drive", "Map", file, { fileName: "lab.map", onProgress: (sent) => progress.push(sent) });
    await settle();
    await settle();
    const offer = server.message("resourceOffer").body;
    assert.deepEqual([offer.fileName, offer.size, offer.sha256.length, offer.resource], ["lab.map", 200_000n, 32, "Map"]);
    server.say(ROBOT, { resourceCredit: { transferId: offer.transferId, offset: 50_000n, window: 100_000n } });
    for (let i = 0; i < 5; ++i) await settle();
    const chunks = server.take().flatMap((one) => ("body" in one && one.body.resourceChunk !== undefined ? [one.body.resourceChunk] : []));
    assert.deepEqual(chunks.map(({ offset, content }) => [Number(offset), content.length]), [[50_000, 65_536], [115_536, 34_464]]);
    server.say(ROBOT, { resourceCredit: { transferId: offer.transferId, offset: 150_000n, window: 100_000n } });
    for (let i = 0; i < 5; ++i) await settle();
    server.say(ROBOT, { resourceDone: { transferId: offer.transferId, resource: "Map" } });
    await done;
    assert.equal(progress.at(-1), 200_000);
});

test("What a callback throws disturbs nobody, and a callback may call everything", async () => {
    const { server, client, errors } = await world();
    const seen: string[] = [];
    client.onEntity(() => {
        throw new Error("of the program");
    });
    client.onEntity(({ entity }) => {
        seen.push(entity.name);
        if (entity.name === "Cyton") void client.checkOut("Cyton").catch(() => undefined);
    });
    server.join(ARM, "Cyton");
    assert.equal(errors.length, 2);
    assert.deepEqual(seen, ["PeopleBot", "Cyton"]);
    assert.equal(server.message("checkOut").head.entity, ARM);
});

test("Hostile messages are counted and change nothing", async () => {
    const { server, client, robot } = await held();
    const head = { entity: ROBOT, msgType: "TASK", held: { epoch: 0, number: 0 }, stopGeneration: 0, seq: 0, sentAtUs: 0 };
    for (const bytes of [new Uint8Array([255]), new Uint8Array(0), new Uint8Array([0x22, 2, 0x0a, 0])]) server.events.entityMessage(head, bytes);
    server.events.entityMessage({ ...head, msgType: "RECEIPT" }, new Uint8Array([255]));
    server.events.profile("joined", { entity: "__proto__", name: "constructor", category: "ROBOT", type: "MOBILE" }, new Uint8Array([255]));
    server.status("__proto__");
    assert.ok(client.malformed >= 4);
    assert.deepEqual(client.entities().map(({ name }) => name), ["PeopleBot", "constructor"]);
    assert.equal(robot.lost, undefined);
});

test("close() releases what is held and ends the session in order", async () => {
    const { server, client } = await held();
    const closed = client.close();
    await settle();
    server.message("release");
    server.say(ROBOT, { leaseEnded: { lease: { epoch: 1, number: 1 } } });
    await closed;
    assert.deepEqual([server.left, client.connection().kind], [true, "closed"]);
    assert.equal((await refusal(client.checkOut("PeopleBot"))).code, "NOT_CONNECTED");
});

test("A log-in that is refused says so, and how to fix it", async () => {
    const server = new FakeServer();
    server.refuse = new Refusal("PERMISSION_DENIED", "wrong user or password");
    const denied = await refusal(connect({ transport: server, clock: new FakeClock(), server: "ws://lab:1" }));
    assert.deepEqual([denied.code, denied.message], ["PERMISSION_DENIED", "No session with the server at ws://lab:1: wrong user or password"]);
});

test("A task whose arguments cannot be read is refused, and nothing stays open", async () => {
    const { clock, server, robot } = await held();
    const mean = {
        name: "Distance",
        get values(): number[] {
            throw new TypeError("of the program");
        },
    };
    const refused = [[mean], [{ name: "Distance", values: [null] }], [{ name: "Distance" }], [undefined], [{ name: "Laps", values: "9" }], 5].map((args) => robot.run("Drive", args as never).report());
    assert.deepEqual(refused.map(({ state }) => state), Array(6).fill("REFUSED"));
    assert.deepEqual(refused.map(({ reason }) => reason?.code), ["MALFORMED", "WRONG_TYPE", "MALFORMED", "MALFORMED", "MALFORMED", "MALFORMED"]);
    assert.equal(server.take().length, 0);
    await clock.advance(4000);
    assert.ok(server.beats() <= 2, "no task is open, so the heartbeats are slow");
    assert.equal((await refusal(robot.set("Drive", { name: "Laps" } as never))).code, "MALFORMED");
});

test("What callbacks throw is reported, and the task, the upload and the heartbeats go on", async () => {
    const { clock, server, client, robot, errors } = await held();
    const oops = (): never => {
        throw new TypeError("of the program");
    };
    const task = robot.run("Drive", [{ name: "Distance", values: [1] }]);
    const { body } = server.message("task");
    task.onUpdate(oops);
    const seen: string[] = [];
    task.onUpdate(({ state }) => seen.push(state));
    client.onConnection(oops);
    event(server, body.taskId, "RUNNING");
    event(server, body.taskId, "SUCCEEDED");
    assert.deepEqual([seen, task.report().state], [["QUEUED", "RUNNING", "SUCCEEDED"], "SUCCEEDED"]);
    assert.equal(errors.length, 4);
    const done = robot.upload("Drive", "Map", new Uint8Array(100_000), { onProgress: oops });
    await settle();
    await settle();
    const offer = server.message("resourceOffer").body;
    server.say(ROBOT, { resourceCredit: { transferId: offer.transferId, offset: 0n, window: 1_000_000n } });
    for (let i = 0; i < 5; ++i) await settle();
    server.say(ROBOT, { resourceDone: { transferId: offer.transferId, resource: "Map" } });
    await done;
    assert.equal(errors.length, 6);
    server.take();
    await clock.advance(4000);
    assert.ok(server.beats() > 0);
});

test("A message that the library cannot handle is counted and reported, and ends nothing", async () => {
    const { server, client, robot, errors } = await held();
    const malformed = client.malformed;
    server.events.status(undefined as never);
    server.events.profile("joined", undefined as never, new Uint8Array(0));
    server.events.entityMessage(undefined as never, new Uint8Array(0));
    assert.deepEqual([client.malformed - malformed, errors.length], [3, 3]);
    assert.deepEqual([client.connected, robot.lost], [true, undefined]);
    server.status(ROBOT, { state: "BUSY", holder: ME, held: { epoch: 1, number: 1 } });
    assert.equal(robot.entity().state, "BUSY");
});

test("An upload sends a chunk when it is its turn, and none after it was cancelled", async () => {
    const { server, robot } = await held();
    const stop = new AbortController();
    const sent: number[] = [];
    const done = refusal(robot.upload("Drive", "Map", new Uint8Array(200_000), { signal: stop.signal, onProgress: (count) => sent.push(count) }));
    await settle();
    await settle();
    const offer = server.message("resourceOffer").body;
    server.noRoom = [];
    server.say(ROBOT, { resourceCredit: { transferId: offer.transferId, offset: 0n, window: 1_000_000n } });
    for (let i = 0; i < 5; ++i) await settle();
    assert.deepEqual([sent, server.noRoom.length, server.take().length], [[], 1, 0]);
    server.noRoom.shift()?.();
    for (let i = 0; i < 5; ++i) await settle();
    assert.deepEqual([sent, server.noRoom.length], [[65_536], 1]);
    stop.abort();
    assert.equal((await done).code, "CANCELLED");
    assert.deepEqual(server.noRoom, []);
});

test("A file that can no longer be read ends its upload in these words", async () => {
    const { robot } = await held();
    const gone = new Blob([new Uint8Array(10)]);
    gone.slice = () => ({ arrayBuffer: () => Promise.reject(new Error("it was moved")) }) as unknown as Blob;
    const why = await refusal(robot.upload("Drive", "Map", gone));
    assert.deepEqual([why.code, why.message], ["UNKNOWN_RESOURCE", "The file cannot be read: it was moved"]);
});

test("If somebody else has logged in meanwhile, the session ends for good, and nothing is resumed under another name", async () => {
    let user = "ann";
    const { clock, server, client, robot, errors } = await held({ credentials: async () => ({ user, password: "a ticket" }) });
    const said: ConnectionReport[] = [];
    const lost: string[] = [];
    client.onConnection((report) => said.push(report));
    robot.onLost(({ code }) => lost.push(code));
    const task = robot.run("Drive", [{ name: "Distance", values: [1] }]);
    user = "ben"; // in another tab
    server.take();
    const logins = server.logins.length;
    server.events.closed("the server was restarted");
    await clock.advance(20_000);
    assert.equal(server.logins.length, logins, "the other's ticket is not used");
    assert.deepEqual([lost, task.report().state, client.held().length], [["NOT_CONNECTED"], "UNKNOWN", 0]);
    const { kind, ended, nextTryMs } = client.connection();
    assert.deepEqual([kind, ended?.code, nextTryMs], ["closed", "PERMISSION_DENIED", undefined]);
    assert.match(ended?.message ?? "", /opened by "ann", and "ben" is logged in now/);
    assert.equal(said.at(-1)?.ended, ended);
    assert.equal((await refusal(client.checkOut("PeopleBot"))).code, "NOT_CONNECTED");
    assert.deepEqual(server.take(), []);
    await client.close();
    assert.deepEqual(errors, []);
});

test("The same user goes on, also where the server has no users", async () => {
    for (const user of ["ann", ""]) {
        const { clock, server, client } = await world({ credentials: async () => ({ user, password: "another ticket" }) });
        server.events.closed("away");
        await clock.advance(150);
        assert.deepEqual([client.connected, client.connection().ended], [true, undefined]);
    }
});

test("What is known of a lost connection is not carried into the next one", async () => {
    const { clock, server, client } = await world();
    server.events.status({ entity: ARM, state: "IDLE", latched: false, stopGeneration: 77, holder: OTHER, held: { epoch: 1, number: 0 }, reason: "", orphaned: false, waiting: 0, stopLatencyUs: 0 });
    server.receipt("33333333-0000-4000-8000-000000000003", 5, { stopGeneration: 88 }, OTHER.id); // of one that was never told of
    server.events.closed("away");
    await clock.advance(150);
    server.join(ROBOT, "PeopleBot");
    server.join("33333333-0000-4000-8000-000000000003", "Third", { stopGeneration: 1 });
    server.take();
    void client.stop(["Third"]);
    assert.equal(server.stops()[0]?.head.stopGeneration, 1);
});

test("Names of many entities that are called the same are found in order of UUID", async () => {
    const { server, client } = await world();
    const id = (i: number): string => `33333333-0000-4000-8000-${String(i).padStart(12, "0")}`;
    for (const i of [5, 3, 9, 1, 7]) server.join(id(i), "Swarm");
    assert.deepEqual([1, 2, 3, 4, 5].map((n) => client.find(`Swarm#${n}`).id), [1, 3, 5, 7, 9].map(id));
    assert.equal(client.label(id(7)), "Swarm#4");
    server.events.profile("left", { entity: id(5), name: "", category: "", type: "" }, new Uint8Array(0));
    assert.deepEqual([client.label(id(3)), client.label(id(7)), client.label(id(9))], ["Swarm#2", "Swarm#3", "Swarm#4"]);
    assert.equal((await refusal(() => client.find("Swarm"))).code, "AMBIGUOUS_ENTITY");
    assert.equal(client.find(id(9).toUpperCase()).id, id(9));
});
