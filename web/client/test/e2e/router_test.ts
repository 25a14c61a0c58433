// SPDX-License-Identifier: GPL-2.0-or-later
// Through a Glacier2 router by WebSocket (docs/reference/routers.md).
import "../../dist/node_websocket.js";
import assert from "node:assert/strict";
import { existsSync, mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { createServer, type AddressInfo } from "node:net";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { after, test } from "node:test";
import { eventually, Laboratory, ROOT } from "./laboratory.js";

const { connect } = await import("../../dist/index.js");
const ROUTER = "/usr/bin/glacier2router";

/** One that nobody had a moment ago. */
function freePort(): Promise<number> {
    return new Promise((resolve) => {
        const one = createServer().listen(0, "127.0.0.1", () => {
            const { port } = one.address() as AddressInfo;
            one.close(() => resolve(port));
        });
    });
}

const folder = mkdtempSync(join(tmpdir(), "axon-web-router-"));
writeFileSync(join(folder, "server.cfg"), "FrontEndServerRouter.Endpoints=127.0.0.1:0\n");
const lab = new Laboratory({ more: ["--config", join(folder, "server.cfg")] });
after(async () => {
    await lab.end();
    rmSync(folder, { recursive: true });
});

test("Both lanes go through a router, and a server that dies behind it is noticed", { skip: existsSync(ROUTER) ? false : "there is no glacier2router; install zeroc-glacier2" }, async () => {
    await lab.startServer();
    lab.startCounter();
    const port = await freePort();
    const inner = (lab.at["client-router"] ?? "").split(":")[1] ?? "";
    const text = readFileSync(join(ROOT, "deploy/config/clientrouter.cfg"), "utf8")
        .replace("Client.Endpoints=tcp -h 127.0.0.1 -p 10414", `Client.Endpoints=ws -h 127.0.0.1 -p ${port}`)
        .replaceAll("-p 10415", "-p 0")
        .replaceAll("-p 10416", `-p ${inner}`);
    writeFileSync(join(folder, "router.cfg"), `${text}Ice.PrintAdapterReady=1\n`);
    const router = lab.start("router", ROUTER, `--Ice.Config=${join(folder, "router.cfg")}`);
    await router.line("Glacier2.Client ready");

    const client = await connect({ server: `Axon.Clients/router:ws -h 127.0.0.1 -p ${port}`, reconnect: false });
    assert.equal(client.connection().signalLane, "own");
    await client.waitFor("Counter", 10_000);
    const robot = await client.checkOut("Counter");
    const task = robot.run("Count", [{ name: "To", values: [100_000] }]);
    await eventually("it counts", () => (task.report().progress ?? 0) > 0);
    assert.ok((await client.stop("held")).every(({ confirmed }) => confirmed));
    assert.equal((await task.wait(5000)).state, "STOPPED");
    await lab.server.end("SIGKILL");
    await eventually("the loss is said", () => client.connection().kind === "lost");
    await client.close();
});
