// SPDX-License-Identifier: GPL-2.0-or-later
import assert from "node:assert/strict";
import { test } from "node:test";
import type { CheckOut, GlobalService } from "../../dist/index.js";
import { type Candidate, propose, rolesOf } from "../../dist/core/proposal.js";
import { ARM, refusal, ROBOT, settle, type World, world } from "./support.js";

const step = (role: number, service: string, more = {}) => ({ role, category: "ROBOT", type: "MOBILE", serviceGlobalId: service, preced: role, name: "", parameters: [], sources: [], ...more });
const SERVICE: GlobalService = { name: "Fetch", descr: "", file: "fetch.xml", onFailure: "stop-all", steps: [step(1, "drive", { name: "go" }), step(2, "drive")], compensation: [] };

async function both(): Promise<World & { held: CheckOut[] }> {
    const all = await world();
    all.server.join(ARM, "Cyton");
    const held: CheckOut[] = [];
    for (const [entity, name] of [[ROBOT, "PeopleBot"], [ARM, "Cyton"]] as const) {
        const asked = all.client.checkOut(name);
        await settle();
        all.server.grant(entity);
        held.push(await asked);
    }
    all.server.take();
    return { ...all, held };
}
const bindings = new Map([[1, "PeopleBot"], [2, "Cyton"]]);

test("A run gives the master a sealed sub-lease for each participant, and reports its steps", async () => {
    const { server, client } = await both();
    const run = client.runGlobal(SERVICE, bindings, "Cyton");
    const { head, body } = server.message("collaboration");
    assert.deepEqual([head.entity, body.checkOnly, body.participants.map(({ role, entity }) => [role, entity])], [ARM, false, [[1, ROBOT], [2, ARM]]]);
    assert.ok(body.participants.every(({ lease }) => lease?.proof.length === 32 && lease.stopGeneration === 3));
    assert.deepEqual([run.report().state, run.report().steps.map(({ name, called }) => [name, called])], ["CHECKING", [["PeopleBot", "go"], ["Cyton", ""]]]);
    server.say(ARM, { run: { runId: body.runId, sequence: 1n, state: 2, progress: 0.25, atS: 1.5, steps: [{ step: 0, entity: ROBOT, name: "PeopleBot", service: "drive", state: 3, beganS: 0.5, endedS: -1 }] } });
    server.say(ARM, { run: { runId: body.runId, sequence: 1n, state: 4 } }); // the same event again
    const { steps, elapsedMs, state } = run.report();
    assert.deepEqual([state, elapsedMs, steps[0]?.state, steps[0]?.called, steps[0]?.beganMs, steps[1]?.state], ["RUNNING", 1500, "RUNNING", "go", 500, undefined]);
    const paused = run.pause();
    server.say(ARM, { run: { runId: body.runId, sequence: 2n, state: 3 } });
    await paused;
    server.say(ARM, { run: { runId: body.runId, sequence: 3n, state: 8, reason: { code: 67, message: "no grip" } } });
    assert.deepEqual([(await run.wait()).state, run.report().reason?.message], ["FAILED", "no grip"]);
});

test("A service that cannot be written leaves no run open", async () => {
    const { clock, server, client } = await both();
    const broken = { ...SERVICE, steps: [step(1, "drive", { parameters: [{ name: "Distance" }] }), step(2, "drive")] } as GlobalService;
    assert.throws(() => client.runGlobal(broken, bindings, "Cyton"), TypeError);
    assert.deepEqual(server.take(), []);
    await clock.advance(4000);
    assert.ok(server.beats() <= 2, "no run is open, so the heartbeats are slow");
    assert.equal(client.runGlobal(SERVICE, bindings, "Cyton").report().state, "CHECKING");
});

test("One event may tell of every step, known and new", async () => {
    const { server, client } = await both();
    const run = client.runGlobal(SERVICE, bindings, "Cyton");
    const { body } = server.message("collaboration");
    const steps = [3, 1, 0, 1].map((one, i) => ({ step: one, entity: ROBOT, name: "PeopleBot", service: "drive", state: 3, progress: i / 10, endedS: -1 }));
    const before = client.malformed;
    server.say(ARM, { run: { runId: body.runId, sequence: 1n, state: 2, steps: [...steps, { step: -1 }, { step: 5000 }] } });
    assert.deepEqual(run.report().steps.map(({ step: number, called, progress }) => [number, called, progress]), [[0, "go", 0.2], [1, "", 0.3], [3, "", 0]]);
    assert.equal(client.malformed - before, 2);
});

test("A run is stopped by a stop of every participant", async () => {
    const { server, client } = await both();
    const run = client.runGlobal(SERVICE, bindings, "Cyton");
    void run.stop();
    assert.deepEqual(server.stops().map(({ entities }) => [...entities].sort()), [[ROBOT, ARM]]);
});

test("What can be said at once is said, and nothing is sent", async () => {
    const { server, client, held } = await both();
    const code = async (players: Map<number, string>, master = "Cyton"): Promise<string> => (await refusal(() => client.runGlobal(SERVICE, players, master))).code;
    assert.equal(await code(new Map([[1, "PeopleBot"]])), "MALFORMED");
    assert.equal(await code(new Map([[1, "Cyton"], [2, "Cyton"]])), "DUPLICATE");
    await Promise.all([held[0]?.release(), Promise.resolve().then(() => server.say(ROBOT, { leaseEnded: { lease: { epoch: 1, number: 1 } } }))]);
    assert.equal(await code(bindings), "NOT_HOLDER");
    assert.ok(!server.take().some((one) => "body" in one && one.body.collaboration !== undefined));
});

test("Problems of a check are listed in the order of the steps, and nothing has moved", async () => {
    const { server, client } = await both();
    const check = client.checkGlobal(SERVICE, bindings, "Cyton");
    const { body } = server.message("collaboration");
    const problems = [{ step: 1, entity: "Cyton", refusal: { code: 8, message: "it is latched" } }, { step: 0, entity: "PeopleBot", refusal: { code: 29, message: "no map" } }];
    server.say(ARM, { run: { runId: body.runId, sequence: 1n, state: 11, problems, reason: { code: 8, message: "2 problems" } } });
    const report = await check.wait();
    assert.deepEqual([report.check, report.state, report.problems.map(({ refusal: { code } }) => code)], [true, "REFUSED", ["MISSING_DEPENDENCY", "LATCHED"]]);
});

test("A master that is lost leaves the run UNKNOWN; one that is back is asked every second", async () => {
    const { clock, server, client } = await both();
    const run = client.runGlobal(SERVICE, bindings, "Cyton");
    const { body } = server.message("collaboration");
    server.say(ARM, { run: { runId: body.runId, sequence: 1n, state: 2 } });
    server.events.closed("the cable was pulled");
    await clock.advance(150);
    server.join(ARM, "Cyton", { state: "REG", held: { epoch: 1, number: 1 }, holder: { id: "old", name: "me", role: "operator" } });
    server.grant(ARM);
    const asked = server.message("runHistory").body.requestId;
    server.say(ARM, { runHistory: { requestId: asked, runs: [] } });
    await clock.advance(1000);
    server.say(ARM, { runHistory: { requestId: server.message("runHistory").body.requestId, runs: [{ runId: body.runId, state: 9, reason: { code: 70, message: "its client was lost" } }] } });
    assert.deepEqual([run.report().state, run.report().reason?.code], ["STOPPED", "CLIENT_LOST"]);
});

test("A run that is under way after a lost connection stays so, however quiet it is", async () => {
    const { clock, server, client } = await both();
    const run = client.runGlobal(SERVICE, bindings, "Cyton");
    const { body } = server.message("collaboration");
    server.say(ARM, { run: { runId: body.runId, sequence: 1n, state: 2, steps: [{ step: 0, state: 3, feedback: "on its way" }] } });
    server.events.closed("the cable was pulled");
    await clock.advance(150);
    server.join(ARM, "Cyton", { state: "REG", held: { epoch: 1, number: 1 }, holder: { id: "old", name: "me", role: "operator" } });
    server.grant(ARM);
    const record = { runId: body.runId, state: 4, durationS: 2.5, reason: { code: 70, message: "its client was lost" }, steps: [{ step: 0, state: 5 }] };
    server.say(ARM, { runHistory: { requestId: server.message("runHistory").body.requestId, runs: [record] } });
    const { state, elapsedMs, reason, steps } = run.report();
    assert.deepEqual([state, elapsedMs, reason?.code, steps[0]?.state, steps[0]?.feedback], ["HELD", 2500, "CLIENT_LOST", "SUCCEEDED", "on its way"]);
    await clock.advance(20_000);
    assert.equal(run.report().state, "HELD");
    server.say(ARM, { run: { runId: body.runId, sequence: 2n, state: 7 } });
    assert.equal((await run.wait()).state, "SUCCEEDED");
});

const candidate = (entity: string, more: Partial<Candidate> = {}): Candidate => {
    const service = { name: "Drive", globalId: "drive", kind: "SMPL", descr: "", notes: "", active: true, inactiveReason: "", executing: false, blocking: true, pausable: true, onClientLoss: "stop", parameters: [], resources: [], missing: [], parts: [] } as const;
    return { entity, name: entity, category: "ROBOT", type: "MOBILE", state: "IDLE", latched: false, holder: "", heldHere: false, services: [service], silent: "", ...more };
};

test("As many roles as possible are played, by entities that are held where that can be", () => {
    const found = propose(rolesOf(SERVICE), [candidate("a"), candidate("b"), candidate("c", { heldHere: true })], new Map([[2, "a"]]));
    assert.deepEqual(found.roles.map(({ entity }) => entity), ["c", "a"]);
    assert.equal(found.why, undefined);
    assert.deepEqual(found.roles[0]?.able, ["c", "a", "b"]);
});

test("A proposal says what is missing, nearest first", () => {
    const found = propose(rolesOf(SERVICE), [candidate("a"), candidate("b", { latched: true }), candidate("c", { holder: "ana@lab" }), candidate("d", { services: [] })], new Map());
    assert.deepEqual(found.roles[1]?.unfit.map(({ name, distance }) => [name, distance]), [["b", 1], ["c", 3], ["d", 7]]);
    assert.equal(found.why?.code, "UNAVAILABLE");
    assert.match(found.why?.message ?? "", /role 2 \(ROBOT\/MOBILE\): a plays other roles/);
    const none = propose(rolesOf(SERVICE), [candidate("d", { services: [] })], new Map());
    assert.deepEqual([none.nobodyOffers, none.why?.code], [["drive"], "UNKNOWN_SERVICE"]);
});
