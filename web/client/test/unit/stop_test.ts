// SPDX-License-Identifier: GPL-2.0-or-later
import assert from "node:assert/strict";
import { test } from "node:test";
import { type Receipt, Refusal } from "../../dist/index.js";
import { ARM, ME, OTHER, refusal, ROBOT, settle, world } from "./support.js";

// Of axon.proto.StopReceipt.Stage.
const MANAGER = 2;
const CALLBACK_RETURNED = 3;
const STANDSTILL = 4;
const NO_APPLICATION = 5;

test("A stop goes at once, on the signal lane, and needs no lease", async () => {
    const { server, client, clock } = await world();
    const done = client.stop(["PeopleBot"]);
    const [stop] = server.stops();
    assert.ok(stop);
    assert.deepEqual([stop.lane, stop.entities, stop.cause, stop.head.held, stop.head.stopGeneration, stop.head.seq], ["signal", [ROBOT], "requested", { epoch: 0, number: 0 }, 3, 1]);
    server.events.stopAccepted(stop.head, 1);
    await clock.advance(20);
    server.receipt(ROBOT, 1, { stage: MANAGER });
    server.receipt(ROBOT, 1, { stage: CALLBACK_RETURNED, atUs: 5n, standstillFollows: true });
    const [receipt] = await done;
    assert.deepEqual([receipt?.serverMs, receipt?.managerMs, receipt?.callbackReturnedMs, receipt?.confirmed, receipt?.atRest], [0, 20, 20, true, false]);
    assert.equal(receipt?.name, "PeopleBot");
});

test("A stop that is not confirmed is sent again with the same number, on both lanes", async () => {
    const { server, client, clock } = await world();
    const done = client.stop(["PeopleBot"], { deadlineMs: 700 });
    const sent: string[] = [];
    for (let ms = 0; ms < 800; ms += 10) {
        for (const { lane, head } of server.stops()) sent.push(`${ms} ${lane} ${head.seq} ${head.stopGeneration}`);
        await clock.advance(10);
    }
    assert.deepEqual(sent, ["0 signal 1 3", "100 signal 1 0", "100 data 1 0", "350 signal 1 0", "350 data 1 0", "600 signal 1 0", "600 data 1 0"]);
    const [receipt] = await done;
    assert.deepEqual([receipt?.confirmed, receipt?.managerMs], [false, undefined]);
});

test("Without a signal lane of its own a stop is sent again once", async () => {
    const { server, client, clock } = await world({}, (one) => void (one.signalLane = "shared"));
    const done = client.stop(["PeopleBot"], { deadlineMs: 200 });
    await clock.advance(210);
    assert.deepEqual(server.stops().map(({ lane }) => lane), ["signal", "signal"]);
    await done;
});

test("All are stopped by one message, known here or not, and those that are silent are not taken for stopped", async () => {
    const { server, client, clock } = await world();
    server.join(ARM, "Cyton");
    const done = client.stop("all", { deadlineMs: 500 });
    const [stop] = server.stops();
    assert.deepEqual([stop?.head.entity, stop?.entities], ["", []]);
    if (stop) server.events.stopAccepted(stop.head, 3);
    server.receipt(ROBOT, 1, { stage: CALLBACK_RETURNED });
    server.receipt(ARM, 1, { stage: NO_APPLICATION, absence: 1 });
    await clock.advance(500);
    const receipts = await done;
    assert.deepEqual(receipts.map(({ name, confirmed }) => [name, confirmed]), [["PeopleBot", true], ["Cyton", true], ["(an entity that has not answered)", false]]);
});

test("Those that this client holds are stopped together; if it holds none, nothing is sent", async () => {
    const { server, client } = await world();
    assert.deepEqual(await client.stop("held"), []);
    assert.deepEqual(server.stops(), []);
    server.join(ARM, "Cyton");
    for (const [entity, name] of [[ROBOT, "PeopleBot"], [ARM, "Cyton"]] as const) {
        const asked = client.checkOut(name);
        await settle();
        server.grant(entity);
        await asked;
    }
    server.take();
    void client.stop("held");
    const [stop] = server.stops();
    assert.deepEqual([stop?.head.entity, [...(stop?.entities ?? [])].sort()], ["", [ROBOT, ARM]]);
});

test("An application that is gone is no confirmation, until it comes back", async () => {
    const { server, client } = await world();
    const seen: Receipt[] = [];
    const done = client.stop(["PeopleBot"], { onProgress: ([one]) => one && seen.push(one) });
    server.receipt(ROBOT, 1, { stage: NO_APPLICATION, absence: 3, absenceReason: "it was killed", absentForMs: 1500n, atUs: 1n });
    assert.deepEqual([seen.at(-1)?.confirmed, seen.at(-1)?.applicationLost, seen.at(-1)?.applicationLostForMs], [false, "it was killed", 1500]);
    server.receipt(ROBOT, 1, { stage: CALLBACK_RETURNED, atUs: 2n });
    const [receipt] = await done;
    assert.deepEqual([receipt?.confirmed, receipt?.applicationLost], [true, ""]);
});

test("With standstillMs it waits for those that come to rest, and no longer", async () => {
    const { server, client, clock } = await world();
    let over = false;
    const done = client.stop(["PeopleBot"], { standstillMs: 3000 }).then((receipts) => ((over = true), receipts));
    server.receipt(ROBOT, 1, { stage: CALLBACK_RETURNED, standstillFollows: true, atUs: 1n });
    await clock.advance(2000);
    assert.equal(over, false);
    server.receipt(ROBOT, 1, { stage: STANDSTILL, atUs: 2n });
    const [receipt] = await done;
    assert.deepEqual([receipt?.standstillMs, receipt?.atRest], [2000, true]);
});

test("A stop of somebody else raises the generation, and a stop by a name that is not known stops the others", async () => {
    const { server, client } = await world();
    server.receipt(ROBOT, 77, { stage: CALLBACK_RETURNED, stopGeneration: 12 }, OTHER.id);
    const done = refusal(client.stop(["PeopleBot", "Nobody"]));
    const [stop] = server.stops();
    assert.deepEqual([stop?.entities, stop?.head.stopGeneration], [[ROBOT], 12]);
    server.receipt(ROBOT, 1, { stage: CALLBACK_RETURNED });
    assert.match((await done).message, /No entity is called "Nobody".*The others were stopped/);
});

test("An open stop goes on over the next connection", async () => {
    const { server, client, clock } = await world();
    const done = client.stop(["PeopleBot"], { deadlineMs: 2000 });
    server.events.closed("the cable was pulled");
    server.take();
    await clock.advance(150);
    const again = server.stops();
    assert.deepEqual(again.map(({ head, entities }) => [head.seq, entities]), [[1, [ROBOT]], [1, [ROBOT]]]);
    server.receipt(ROBOT, 1, { stage: CALLBACK_RETURNED });
    assert.equal((await done)[0]?.confirmed, true);
});

test("Without a connection a stop is refused, in words that say what happens instead", async () => {
    const { server, client } = await world({ reconnect: false });
    server.events.closed("the cable was pulled");
    assert.match((await refusal(client.stop("all"))).message, /stopped by the server's own watchdog; for the rest use the robot's own stop/);
});

test("A receipt that a stranger's name makes look like ours is none", async () => {
    const { server, client, clock } = await world();
    const done = client.stop(["PeopleBot"], { deadlineMs: 300 });
    for (const stopId of [`${OTHER.id}:1`, `${ME.id}:2`, `${ME.id}:1x`, "1", ":1", `${ME.id}:`]) {
        server.say(ROBOT, { receipt: { stopId, stage: CALLBACK_RETURNED } }, "RECEIPT");
    }
    server.receipt(ARM, 1, { stage: CALLBACK_RETURNED });
    await clock.advance(300);
    assert.equal((await done)[0]?.confirmed, false);
});

test("Reset and clear are numbered with the stops, carry the lease, and resolve with their receipt", async () => {
    const { server, client } = await world();
    const asked = client.checkOut("PeopleBot");
    await settle();
    server.grant(ROBOT);
    const robot = await asked;
    server.take();
    const reset = robot.reset();
    const [sent] = server.take();
    assert.ok(sent?.what === "reset");
    assert.deepEqual([sent.head.seq, sent.head.held], [1, { epoch: 1, number: 1 }]);
    server.receipt(ROBOT, 1, { stage: CALLBACK_RETURNED, tasksEnded: 2 });
    assert.equal((await reset).tasksEnded, 2);
    const clear = refusal(robot.clear());
    const reply = { reply: { requestId: new TextEncoder().encode(`${ME.id}:2`), refusal: { code: 60, message: "it takes part in a run" } } };
    const { encode } = await import("../../dist/wire/codec.js");
    server.events.entityMessage({ entity: ROBOT, msgType: "REPLY", held: { epoch: 1, number: 1 }, stopGeneration: 0, seq: 0, sentAtUs: 0 }, encode("ToClient", reply));
    assert.equal((await clear).code, "WRONG_STATE");
});

test("A drill stops nothing and is sent once", async () => {
    const { server, client, clock } = await world();
    const done = client.drill(["PeopleBot"]);
    await clock.advance(30);
    server.receipt(ROBOT, 1, { stage: CALLBACK_RETURNED });
    assert.deepEqual((await done).map(({ name, callbackMs }) => [name, callbackMs]), [["PeopleBot", [30]]]);
    assert.deepEqual(server.stops().map(({ cause }) => cause), ["drill"]);
});

test("Rearming says how it went", async () => {
    const { server, client } = await world();
    const done = client.rearm("PeopleBot");
    await settle();
    server.say(ROBOT, { reply: { requestId: server.message("rearm").body.requestId } });
    await done;
});

test("A signal lane that the server names is opened after the log-in, tried again until it is there, and then used", async () => {
    const away = new Refusal("NOT_CONNECTED", "a firewall is before it");
    const { server, client, clock } = await world({}, (one) => {
        one.signalLane = "shared";
        one.attachFails = [away, away, away];
    });
    const said: string[] = [];
    client.onConnection(({ signalLane }) => said.push(signalLane));
    assert.deepEqual([client.connected, client.connection().signalLane, server.attached], [true, "shared", 1]);
    const first = client.stop(["PeopleBot"], { deadlineMs: 150 });
    await clock.advance(150);
    assert.deepEqual(server.stops().map(({ lane }) => lane), ["signal", "signal"]); // there is one connection: it is not sent twice
    await first;
    const at: number[] = [];
    for (let ms = 150; ms < 10_000; ms += 50) {
        server.events.heartbeat();
        await clock.advance(50);
        if (server.attached > 1 + at.length) at.push(ms + 50);
    }
    assert.deepEqual([at, said, client.connection().signalLane], [[1000, 3000, 7000], ["shared", "own"], "own"]);
    server.take();
    const second = client.stop(["PeopleBot"], { deadlineMs: 150 });
    await clock.advance(150);
    assert.deepEqual(server.stops().map(({ lane }) => lane), ["signal", "signal", "data"]);
    await second;
});

test("The next connection begins without a signal lane, and opens its own", async () => {
    const { server, client, clock } = await world({}, (one) => {
        one.signalLane = "shared";
        one.attachFails = [];
    });
    assert.equal(client.connection().signalLane, "own");
    server.attachFails = [new Refusal("TIMED_OUT", "nobody answers")];
    server.events.closed("either lane broke");
    assert.equal(client.connection().signalLane, "shared");
    await clock.advance(101);
    assert.deepEqual([client.connected, client.connection().signalLane], [true, "shared"]);
    await clock.advance(1000);
    assert.equal(client.connection().signalLane, "own");
    await client.close();
    const tries = server.attached;
    await clock.advance(5000);
    assert.equal(server.attached, tries);
});

test("A signal lane whose opening is not answered ends the session, and the next one waits before it tries", async () => {
    const { server, client, clock } = await world({}, (one) => {
        one.signalLane = "shared";
        one.attachFails = ["late", "late"];
    });
    const at: number[] = [];
    const lost: number[] = [];
    for (let ms = 0; ms < 6000; ms += 50) {
        if (server.attached > at.length) at.push(ms);
        if (server.dropped > lost.length) lost.push(ms);
        server.events.heartbeat();
        await clock.advance(50);
    }
    // Each time 100 ms until the next log-in; then after 1 s, and after 2 s.
    assert.deepEqual([at, lost], [[0, 1100, 3200], [0, 1100]]);
    assert.deepEqual([client.connected, client.connection().signalLane, server.logins.length], [true, "own", 3]);
});

test("While a robot of this client moves, the signal lane is not tried again", async () => {
    const { server, client, clock } = await world({}, (one) => {
        one.signalLane = "shared";
        one.attachFails = [new Refusal("NOT_CONNECTED", "a firewall is before it")];
    });
    const asked = client.checkOut("PeopleBot");
    await settle();
    server.grant(ROBOT);
    await asked;
    const status = (state: "BUSY" | "IDLE"): void => server.status(ROBOT, { state, holder: ME, held: { epoch: 1, number: 1 } });
    const wait = async (ms: number): Promise<void> => {
        for (let gone = 0; gone < ms; gone += 50) {
            server.events.heartbeat();
            await clock.advance(50);
        }
    };
    status("BUSY");
    await wait(10_000);
    assert.deepEqual([server.attached, client.connection().signalLane], [1, "shared"]);
    status("IDLE");
    await wait(1000);
    assert.deepEqual([server.attached, client.connection().signalLane], [2, "own"]);
});

test("Receipts of very many entities cost no more each than those of few", async () => {
    const cost = async (count: number): Promise<{ calls: number; shown: number; last: readonly Receipt[]; ms: number }> => {
        const { server, client, clock } = await world();
        const ids = Array.from({ length: count }, (_, i) => `33333333-0000-4000-8000-${String(i).padStart(12, "0")}`);
        for (const id of ids) server.join(id, "Swarm"); // all of one name, as robots of one kind have
        let calls = 0;
        let shown = 0;
        let last: readonly Receipt[] = [];
        const began = performance.now();
        const done = client.stop(ids, { deadlineMs: 5000, standstillMs: 4000, onProgress: (all) => (++calls, (shown += all.length), (last = all)) });
        for (const stage of [MANAGER, CALLBACK_RETURNED, STANDSTILL]) for (const id of ids) server.receipt(id, 1, { stage, atUs: BigInt(stage), standstillFollows: stage !== STANDSTILL });
        const receipts = await done;
        const ms = performance.now() - began;
        await clock.advance(0);
        assert.ok(receipts.length === count && receipts.every(({ atRest, name }, i) => atRest && name === `Swarm#${i + 1}`));
        return { calls, shown, last, ms };
    };
    const [few, many] = [await cost(32), await cost(256)];
    // On a clock that stands still: the first of them, and what was true at the end.
    assert.deepEqual([few.calls, many.calls], [2, 2]);
    assert.ok(many.last.every(({ atRest }) => atRest));
    assert.ok(many.shown <= 2 * 256, `${many.shown} receipts were shown`);
});

test("Progress of many entities is told every 20 ms, and of few at once", async () => {
    const { server, client, clock } = await world();
    const ids = Array.from({ length: 40 }, (_, i) => `33333333-0000-4000-8000-${String(i).padStart(12, "0")}`);
    ids.forEach((id, i) => server.join(id, `R${i}`));
    const confirmed: number[] = [];
    const done = client.stop(ids, { onProgress: (all) => confirmed.push(all.filter((one) => one.confirmed).length) });
    for (const id of ids.slice(0, 30)) server.receipt(id, 1, { stage: CALLBACK_RETURNED });
    assert.deepEqual(confirmed, [1]);
    await clock.advance(20);
    assert.deepEqual(confirmed, [1, 30]);
    for (const id of ids.slice(30)) server.receipt(id, 1, { stage: CALLBACK_RETURNED });
    assert.equal((await done).length, 40);
    assert.deepEqual(confirmed, [1, 30, 40]);
});
