// SPDX-License-Identifier: GPL-2.0-or-later
// A server with users, hello-entity, and a plotter that takes files.
import assert from "node:assert/strict";
import { join } from "node:path";
import { after, before, test } from "node:test";
import { connect, type Options, type Refusal } from "../../dist/index.js";
import { Laboratory, read, ROOT } from "./laboratory.js";

const lab = new Laboratory();
const examples = join(ROOT, "examples");
const login = (user: string, more: Options = {}): Options => ({ server: lab.at["client"] ?? "", user, password: `word of ${user}`, displayName: "web@tablet", ...more });
before(async () => {
    for (const [user, role] of [["ann", "operator"], ["guest", "observer"], ["robot", "entity"]] as const) await lab.addUser(user, role, `word of ${user}`);
    await lab.startServer();
    const config = "Axon.User=robot\nAxon.Password=word of robot\n";
    lab.startEntity("hello-entity", "Greeter", [join(examples, "01_hello_entity"), lab.portsFile], config);
    lab.startEntity("plotter-entity", "Plotter", [join(examples, "03_parameters"), lab.portsFile], config);
});
after(() => lab.end());

test("A wrong password is refused, a role is what the server says, and an observer may stop everything", async () => {
    await assert.rejects(connect(login("ann", { password: "wrong" })), (error: Refusal) => error.code === "PERMISSION_DENIED");
    const guest = await connect(login("guest"));
    assert.deepEqual([guest.self.name, guest.self.role], ["guest@tablet", "observer"]);
    await guest.waitFor("Greeter", 10_000);
    await assert.rejects(guest.checkOut("Greeter"), (error: Refusal) => error.code === "PERMISSION_DENIED");
    const ann = await connect(login("ann", { password: "", credentials: async () => ({ password: "word of ann" }) }));
    const greeter = await ann.checkOut("Greeter");
    const task = greeter.run("Greet", [{ name: "Name", values: ["web"] }, { name: "Times", values: [2] }]);
    const heard: string[] = [];
    task.onUpdate(({ feedback }) => heard.push(feedback));
    assert.equal((await task.wait(5000)).state, "SUCCEEDED");
    assert.ok(heard.includes("Hello, web!"));
    assert.ok((await guest.stop("all")).every(({ confirmed }) => confirmed));
    await Promise.all([ann.close(), guest.close()]);
});

test("Files are uploaded with their progress, and what the robot application does not like is refused", async () => {
    const ann = await connect(login("ann"));
    await ann.waitFor("Plotter", 10_000);
    const plotter = await ann.checkOut("Plotter");
    if (plotter.entity().latched) await ann.rearm("Plotter");
    const progress: [number, number][] = [];
    const house = read(join(examples, "03_parameters/house.txt"));
    await plotter.upload("Draw", "Drawing", house, { fileName: "house.txt", onProgress: (...both) => progress.push(both) });
    assert.deepEqual(progress.at(-1), [house.length, house.length]);
    await assert.rejects(plotter.upload("Draw", "Drawing", new Blob(["0 0\n1 zero\n"]), { fileName: "broken.txt" }), (error: Refusal) => error.code === "DENIED" && /line 2/.test(error.message));
    await assert.rejects(plotter.upload("Draw", "Drawing", house, { fileName: "../house.txt" }), (error: Refusal) => error.code === "BAD_NAME");
    await assert.rejects(plotter.upload("Draw", "Paper", house), (error: Refusal) => error.code === "UNKNOWN_RESOURCE");
    // A longer one, in many chunks through the window of credits.
    const points = new TextEncoder().encode(Array.from({ length: 60_000 }, (_, i) => `${(i % 100) / 100} ${(i % 7) / 7}`).join("\n"));
    await plotter.upload("Draw", "Drawing", new Blob([points]), { fileName: "many.txt" });
    const stop = new AbortController();
    stop.abort();
    await assert.rejects(plotter.upload("Draw", "Drawing", points, { signal: stop.signal }), (error: Refusal) => error.code === "CANCELLED");
    assert.equal(plotter.service("Draw").resources[0]?.ready, true);
    await ann.close();
});
