// SPDX-License-Identifier: GPL-2.0-or-later
// The browsers of bench/console.py: each line of standard input is a command in JSON, and is answered with a line of JSON.
//   {"do": "open", "page": "laboratory" | "entity", "url": …, "name": entity}   a Chromium of its own
//   {"do": "processes"}                 of each page: those that run pages, and the one that has their connections
//   {"do": "frames", "seconds": 30}     of each page: milliseconds between its frames
//   {"do": "memory"}                    of each page: its JavaScript heap, and what its process has
//   {"do": "stop", "page": …}           presses the stop button; milliseconds until the receipt stands there, and when it was
//                                       pressed, in nanoseconds of CLOCK_MONOTONIC
//   {"do": "connected"}                 waits until each page has its session again
//   {"do": "close"}
import { readFileSync } from "node:fs";
import { createInterface } from "node:readline";
import { chromium } from "playwright-core";

const SETTLED_MS = 60_000;
/** @type {Map<string, { browser: import("playwright-core").Browser, page: import("playwright-core").Page, cdp: import("playwright-core").CDPSession, zero: number }>} */
const open = new Map();

/** In the page: from a press to its receipt. A press counts from when the browser took it from the mouse. */
function watchStops() {
    let pressed;
    let tell;
    const look = () => {
        if (pressed === undefined || document.querySelector(".receipts .receipt.good") === null) return;
        const { input, handled } = pressed;
        const now = performance.now();
        pressed = undefined;
        const [server, manager, robot] = [...document.querySelectorAll(".receipts .receipt.good .stages b")].map((one) => one.textContent);
        requestAnimationFrame(() => setTimeout(() => tell?.({ input, receipt_ms: now - input, handled_ms: handled - input, painted_ms: performance.now() - input, stages: { server, manager, robot } })));
    };
    addEventListener("pointerdown", (event) => (pressed = { input: event.timeStamp, handled: performance.now() }), true);
    document.addEventListener("DOMContentLoaded", () => new MutationObserver(look).observe(document.body, { subtree: true, childList: true, attributes: true, attributeFilter: ["class"] }));
    globalThis.nextReceipt = () =>
        new Promise((resolve) => {
            tell = resolve;
            setTimeout(() => resolve({}), 5000);
        });
    globalThis.countFrames = (ms) =>
        new Promise((resolve) => {
            const between = [];
            let begin;
            let before;
            const step = (at) => {
                begin ??= at;
                if (before !== undefined) between.push(at - before);
                before = at;
                if (at - begin >= ms) resolve(between);
                else requestAnimationFrame(step);
            };
            requestAnimationFrame(step);
        });
}

/** Those that run pages, and the one that has their connections. */
async function processes(browser) {
    const session = await browser.newBrowserCDPSession();
    const { processInfo } = await session.send("SystemInfo.getProcessInfo");
    await session.detach();
    return processInfo.flatMap(({ id }) => {
        const words = readFileSync(`/proc/${id}/cmdline`, "utf8");
        if (words.includes("--type=renderer")) return [{ type: "renderer", pid: id }];
        return words.includes("network.mojom.NetworkService") ? [{ type: "network", pid: id }] : [];
    });
}
/** What the page has spent so far, in milliseconds, and its heap in bytes. */
async function spent(cdp) {
    const { metrics } = await cdp.send("Performance.getMetrics");
    const of = (wanted) => metrics.find(({ name }) => name === wanted).value;
    return { script_ms: of("ScriptDuration") * 1000, style_ms: of("RecalcStyleDuration") * 1000, layout_ms: of("LayoutDuration") * 1000, heap: of("JSHeapUsedSize") };
}
/** The page tells its time in steps. */
const STEP_MS = 0.2;
const monotonicMs = () => Number(process.hrtime.bigint()) / 1e6;
/**
 * In CLOCK_MONOTONIC, the zero of the page's performance.now(), in milliseconds. Chromium has it from that clock; what the page
 * says when it is asked for its time must agree.
 */
async function zeroOf(page, cdp) {
    const { metrics } = await cdp.send("Performance.getMetrics");
    const zero = metrics.find(({ name }) => name === "NavigationStart").value * 1000;
    let [earliest, latest] = [-Infinity, Infinity];
    for (let i = 0; i < 50; ++i) {
        const before = monotonicMs();
        const now = await page.evaluate(() => performance.now());
        earliest = Math.max(earliest, before - now);
        latest = Math.min(latest, monotonicMs() - now);
    }
    if (zero < earliest - STEP_MS || zero > latest + STEP_MS) throw new Error(`the clock of the page begins between ${earliest} and ${latest} ms, and Chromium says at ${zero} ms: its times cannot be compared with those of a robot`);
    return zero;
}
/** In MiB. */
function memoryOf(pid) {
    const of = (file, key) => Number(new RegExp(`^${key}:\\s+(\\d+)`, "m").exec(readFileSync(`/proc/${pid}/${file}`, "utf8"))?.[1] ?? 0) / 1024;
    return { resident: of("status", "VmRSS"), own: of("status", "RssAnon"), share: of("smaps_rollup", "Pss") };
}

const commands = {
    async open({ page: which, url, name, select }) {
        const browser = await chromium.launch({ executablePath: process.env.AXON_CHROMIUM ?? "/usr/bin/chromium", args: ["--no-sandbox", "--disable-gpu"] });
        const page = await (await browser.newContext({ viewport: { width: 1280, height: 800 }, locale: "en-GB" })).newPage();
        page.setDefaultTimeout(SETTLED_MS);
        await page.addInitScript(watchStops);
        await page.goto(url);
        await page.locator(`[data-entity="${name}"] h3 a`).waitFor();
        if (which === "entity") {
            await page.locator(`[data-entity="${name}"] h3 a`).click();
            await page.locator("[data-kind=scan] canvas").waitFor();
        } else if (select !== undefined) {
            await page.locator(`[data-entity="${select}"] input[type=checkbox]`).check();
        }
        const cdp = await page.context().newCDPSession(page);
        await cdp.send("Performance.enable");
        open.set(which, { browser, page, cdp, zero: await zeroOf(page, cdp) });
        return {};
    },
    async processes() {
        const found = {};
        for (const [which, { browser }] of open) found[which] = await processes(browser);
        return found;
    },
    async frames({ seconds }) {
        const all = [...open].map(async ([which, { page }]) => [which, await page.evaluate((ms) => globalThis.countFrames(ms), seconds * 1000)]);
        return Object.fromEntries(await Promise.all(all));
    },
    async memory() {
        const found = {};
        for (const [which, { browser, cdp }] of open) {
            const heap = (await spent(cdp)).heap / 2 ** 20;
            // The browser has other renderers, which are smaller.
            const [page] = (await processes(browser)).filter(({ type }) => type === "renderer").map(({ pid }) => memoryOf(pid)).sort((a, b) => b.own - a.own);
            found[which] = { heap, ...page };
        }
        return found;
    },
    async stop({ page: which }) {
        const { page, cdp, zero } = open.get(which);
        const box = await page.locator(".dock .stop").boundingBox();
        await page.mouse.move(box.x + box.width / 2, box.y + box.height / 2);
        const receipt = page.evaluate(() => globalThis.nextReceipt());
        const before = await spent(cdp);
        await page.mouse.down();
        const { input, ...told } = await receipt;
        const after = await spent(cdp);
        await page.mouse.up();
        await page.evaluate(() => document.querySelector('.receipts [aria-label="Close the receipt"]')?.click());
        return { ...told, ...(input === undefined ? {} : { pressed_at_ns: Math.round((zero + input) * 1e6) }), ...Object.fromEntries(["script_ms", "style_ms", "layout_ms"].map((key) => [key, after[key] - before[key]])) };
    },
    async connected() {
        for (const { page } of open.values()) await page.locator("[data-connection=connected]").waitFor();
        return {};
    },
    async close() {
        for (const { browser } of open.values()) await browser.close();
        open.clear();
        return {};
    },
};

for await (const line of createInterface({ input: process.stdin })) {
    const command = JSON.parse(line);
    let answer;
    try {
        answer = await commands[command.do](command);
    } catch (error) {
        answer = { failed: String(error?.message ?? error) };
    }
    process.stdout.write(`${JSON.stringify(answer)}\n`);
}
await commands.close();
