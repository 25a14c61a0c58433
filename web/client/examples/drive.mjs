// SPDX-License-Identifier: GPL-2.0-or-later
// Checks an entity out, runs a task, and shows what it hears. Without a console, in Node:
//     node examples/drive.mjs 127.0.0.1:10410 Counter Count To=40
// Ctrl+C stops the entity, waits for the receipt and ends.
import { connect, Refusal } from "@axon/client";

const [server = "127.0.0.1:10410", name = "", service = "", ...words] = process.argv.slice(2);
// The entity's profile knows the types: values go as texts.
const given = words.map((word) => ({ name: word.split("=")[0], values: [word.slice(word.indexOf("=") + 1)], fromText: true }));

try {
    const client = await connect({ server });
    client.onConnection(({ kind, reason }) => console.log(`connection: ${kind} ${reason}`));
    for (const entity of client.entities()) console.log(`${client.label(entity.id)}: ${entity.state}${entity.holder ? `, held by ${entity.holder.name}` : ""}`);

    const entity = await client.waitFor(name, 5000);
    const robot = await client.checkOut(entity.id, { waitMs: 60_000, onWaiting: ({ message }) => console.log(message) });
    robot.onLost((why) => console.log(`lost: ${why.message}`));
    robot.onHandOverRequest(({ by, reason }) => console.log(`${by} asks for it: ${reason}`));
    client.watch(entity.id, [], ({ stream, content }) => console.log(`${stream}:`, content.kind === "scalar" ? content.value : content.kind));
    if (robot.entity().latched) await client.rearm(entity.id);

    process.once("SIGINT", async () => {
        // Only `confirmed` says that the robot application was told.
        for (const receipt of await client.stop([entity.id])) console.log(`stop of ${receipt.name}: ${receipt.confirmed ? "confirmed" : `NOT confirmed. ${receipt.applicationLost}`}`);
    });
    const task = robot.run(service, given);
    task.onUpdate(({ state, progress, feedback }) => console.log(`${state} ${progress === undefined ? "" : `${Math.round(100 * progress)} %`} ${feedback}`));
    const { state, results, reason } = await task.wait();
    console.log(state, reason?.message ?? Object.fromEntries(results));
    await client.close(); // releases it
} catch (error) {
    if (!(error instanceof Refusal)) throw error;
    console.error(`${error.message} (${error.code}: ${error.meaning}${error.remedy && `; fix: ${error.remedy}`})`);
    process.exitCode = 1;
}
