// SPDX-License-Identifier: GPL-2.0-or-later
// A global service of three entities (examples/05_collaboration), led by one of them.
import assert from "node:assert/strict";
import { join } from "node:path";
import { after, before, test } from "node:test";
import { type Client, connect, type RunReport } from "../../dist/index.js";
import { eventually, Laboratory, ROOT } from "./laboratory.js";

const folder = join(ROOT, "examples/05_collaboration");
const lab = new Laboratory({ globalServices: join(folder, "globalservices") });
let client: Client;
before(async () => {
    await lab.startServer();
    for (const kind of ["Shuttle", "Arm", "Planner"]) {
        lab.startEntity(`${kind.toLowerCase()}-entity`, kind, [folder, lab.portsFile, "--speed", "10"]);
    }
    client = await connect({ server: lab.at["client"] ?? "" });
    for (const name of ["Shuttle", "Arm", "Planner"]) await client.waitFor(name, 10_000);
});
after(async () => {
    await client.close();
    await lab.end();
});

test("A global service is listed, bound, checked, run, and its steps are reported", async () => {
    const { services, files } = await client.globalServices();
    assert.deepEqual([files.map(({ name }) => name), services.map(({ name }) => name)], [["delivery.xml"], ["Delivery", "Heavy delivery", "Go home"]]);
    const [delivery, heavy] = services;
    assert.ok(delivery && heavy);
    assert.deepEqual([delivery.onFailure, delivery.steps[2]?.sources, delivery.steps[1]?.parameters[0]?.values], ["compensate", [{ parameter: "From", step: "start", output: "Cell" }], ["cup"]]);
    const proposal = await client.propose(delivery);
    assert.deepEqual(proposal.roles.map(({ role, name }) => [role, name]), [[0, "Shuttle"], [1, "Arm"], [2, "Planner"]]);
    assert.equal(proposal.why, undefined);
    const bindings = new Map(proposal.roles.map(({ role, name }) => [role, name]));
    const held = await client.checkOutAll([...bindings.values()]);

    const check = await client.checkGlobal(delivery, bindings, "Arm").wait(5000);
    assert.deepEqual([check.state, check.check], ["SUCCEEDED", true]);

    const reports: RunReport[] = [];
    const run = client.runGlobal(delivery, bindings, "Arm");
    run.onUpdate((report) => reports.push(report));
    const end = await run.wait(20_000);
    assert.equal(end.state, "SUCCEEDED", end.reason?.message);
    assert.ok(end.steps.slice(0, 10).every(({ state, beganMs, endedMs }) => state === "SUCCEEDED" && beganMs !== undefined && endedMs !== undefined));
    assert.ok(reports.some(({ state, progress }) => state === "RUNNING" && progress > 0 && progress < 1));

    const second = client.runGlobal(heavy, bindings, "Planner");
    await eventually("it is held", () => second.report().state === "HELD", 15_000);
    assert.match(second.report().steps.find(({ state }) => state === "FAILED")?.reason?.message ?? "", /anvil/);
    const receipts = await second.stop();
    assert.deepEqual(receipts.map(({ name, confirmed }) => [name, confirmed]).sort(), [["Arm", true], ["Planner", true], ["Shuttle", true]]);
    assert.equal((await second.wait(5000)).state, "STOPPED");
    const refused = await client.checkGlobal(heavy, bindings, "Planner").wait(5000);
    assert.deepEqual([refused.state, refused.problems[0]?.refusal.code ?? refused.reason?.code], ["REFUSED", "LATCHED"]);

    const history = await client.runHistory();
    assert.deepEqual(history.runs.map(({ service, state }) => [service.name, state]).slice(0, 2), [["Heavy delivery", "STOPPED"], ["Delivery", "SUCCEEDED"]]);
    await Promise.all(held.map((one) => one.release()));
});
