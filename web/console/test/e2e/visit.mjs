// SPDX-License-Identifier: GPL-2.0-or-later
// A visitor of the console over HTTPS, in a Chromium that trusts who its user trusts: node visit.mjs URL USER PASSWORD ENTITY
import assert from "node:assert/strict";
import { once } from "node:events";
import { readFile } from "node:fs/promises";
import { createServer } from "node:http";
import { extname, join, normalize } from "node:path";
import { chromium } from "playwright-core";

const [url, user, password, entity] = process.argv.slice(2);
const browser = await chromium.launch({ executablePath: process.env.AXON_CHROMIUM ?? "/usr/bin/chromium", args: ["--no-sandbox", "--disable-gpu"] });
try {
    const context = await browser.newContext({ locale: "en-GB" });
    const page = await context.newPage();
    page.setDefaultTimeout(30_000);
    const complaints = [];
    const sockets = [];
    page.on("pageerror", (error) => complaints.push(error.message));
    page.on("console", (message) => message.type() === "error" && !/Failed to load resource/.test(message.text()) && complaints.push(message.text()));
    page.on("request", (request) => /^https?:/.test(request.url()) && !request.url().startsWith(url) && complaints.push(`asks ${request.url()}`));
    /** Of the connections to the signal lane: what was sent, and how much has come. */
    const signals = [];
    page.on("websocket", (socket) => {
        sockets.push(socket.url());
        if (!socket.url().endsWith("/axon-signal")) return;
        const one = { url: socket.url(), sent: [], received: 0, open: true };
        signals.push(one);
        socket.on("framesent", ({ payload }) => one.sent.push(/attachSignalLane|keepAlive|sendStopSignal/.exec(payload.toString("latin1"))?.[0]));
        socket.on("framereceived", () => ++one.received);
        socket.on("close", () => (one.open = false));
    });
    const signalLane = () => signals.find(({ open, sent, received }) => open && received > 0 && sent.includes("keepAlive"));

    const first = await page.goto(url);
    const { protocol, issuer } = await first.securityDetails();
    assert.match(protocol, /^TLS 1\.[23]$/);
    assert.equal(issuer, "Axon laboratory CA");
    assert.equal(await page.evaluate(() => isSecureContext), true);

    await page.getByLabel("User").fill(user);
    await page.getByLabel("Password").fill(password);
    await page.getByRole("button", { name: "Log in" }).click();
    await page.getByText("(operator)").waitFor();
    const cookies = await context.cookies();
    assert.equal(cookies.length, 1);
    assert.deepEqual([cookies[0].secure, cookies[0].httpOnly, cookies[0].sameSite, cookies[0].path], [true, true, "Strict", "/"]);
    assert.match(cookies[0].name, /^__Host-axon-/);
    assert.equal(await page.evaluate(() => document.cookie), "");

    await page.locator(`[data-entity="${entity}"] h3 a`).click();
    // Heartbeats go over it as soon as the server has attached it, and every 2 s.
    for (const end = Date.now() + 30_000; signalLane() === undefined; await page.waitForTimeout(50)) assert.ok(Date.now() < end, `no signal lane: ${JSON.stringify(signals)}`);
    await page.locator(".dock .stop").click();
    await page.getByText("Confirmed by it.").waitFor();
    assert.ok(signalLane()?.sent.includes("sendStopSignal"), `the stop has not gone over the signal lane: ${JSON.stringify(signals)}`);
    console.log(`stops at ${signalLane().url}`);
    assert.ok(sockets.length > 0 && sockets.every((one) => one.startsWith("wss://")), sockets.join(" "));
    console.log(`sessions at ${[...new Set(sockets)].join(" ")}`);

    // A copy of the console at another address, in the same browser. Its request for a ticket is refused, and with a ticket that
    // it has got otherwise it opens no session.
    const stolen = () => page.evaluate(async () => (await fetch("ticket", { method: "POST" })).text());
    const types = { ".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml" };
    const copy = createServer(async (request, answer) => {
        if (request.method === "POST") return answer.end(await stolen());
        const path = join("dist", normalize(new URL(request.url, "http://copy").pathname).replace(/\/$/, "/index.html"));
        answer.setHeader("Content-Type", types[extname(path)] ?? "text/plain");
        answer.end(await readFile(path).catch(() => ""));
    }).listen(0, "127.0.0.1");
    await once(copy, "listening");
    try {
        const foreign = await context.newPage();
        foreign.setDefaultTimeout(30_000);
        const tried = foreign.waitForEvent("websocket");
        await foreign.goto(`http://127.0.0.1:${copy.address().port}/`);
        assert.match((await tried).url(), /^wss:/);
        await foreign.getByText("Log in to see the robots of this laboratory.").waitFor();
        assert.equal(await foreign.locator(".dock").count(), 0);
        const ask = (address) => fetch(address, { method: "POST", mode: "no-cors", credentials: "include" }).then(() => "answered", () => "kept from it");
        assert.equal(await foreign.evaluate(ask, `${url}ticket`), "kept from it");
        await foreign.close();
    } finally {
        copy.close();
    }
    assert.deepEqual(complaints, []);
    await page.getByRole("button", { name: "Log out" }).click();
    await page.getByText("You are logged out.").waitFor();
} finally {
    await browser.close();
}
