// SPDX-License-Identifier: GPL-2.0-or-later
// A visitor of the console over HTTPS, in a Chromium that trusts who its user trusts: node visit.mjs URL USER PASSWORD ENTITY
import assert from "node:assert/strict";
import { once } from "node:events";
import { createServer } from "node:http";
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
    page.on("websocket", (socket) => sockets.push(socket.url()));

    const first = await page.goto(url);
    const { protocol, issuer } = await first.securityDetails();
    assert.match(protocol, /^TLS 1\.[23]$/);
    assert.match(issuer, /Axon|CA/i);
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
    await page.locator(".dock .stop").click();
    await page.getByText("Confirmed by it.").waitFor();
    assert.ok(sockets.length > 0 && sockets.every((one) => one.startsWith("wss://")), sockets.join(" "));
    console.log(`sessions at ${[...new Set(sockets)].join(" ")}`);

    // Another page of the same browser: neither its WebSocket nor its request is taken, where the console's own are.
    const session = sockets[0];
    const opens = (address) =>
        new Promise((resolve) => {
            const socket = new WebSocket(address, "ice.zeroc.com");
            socket.onopen = () => (socket.close(), resolve(true));
            socket.onerror = () => resolve(false);
        });
    assert.equal(await page.evaluate(opens, session), true);
    const elsewhere = createServer((_, answer) => answer.end("<!doctype html><title>elsewhere</title>")).listen(0, "127.0.0.1");
    await once(elsewhere, "listening");
    try {
        const foreign = await context.newPage();
        await foreign.goto(`http://127.0.0.1:${elsewhere.address().port}/`);
        for (const address of new Set(sockets)) assert.equal(await foreign.evaluate(opens, address), false, `a foreign page opened ${address}`);
        const answered = foreign.waitForResponse((answer) => answer.url() === `${url}ticket`);
        await foreign.evaluate((address) => fetch(address, { method: "POST", mode: "no-cors", credentials: "include" }).catch(() => undefined), `${url}ticket`);
        assert.equal((await answered).status(), 403);
        await foreign.close();
    } finally {
        elsewhere.close();
    }
    assert.deepEqual(complaints, []);
    await page.getByRole("button", { name: "Log out" }).click();
    await page.getByText("You are logged out.").waitFor();
} finally {
    await browser.close();
}
