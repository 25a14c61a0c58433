// SPDX-License-Identifier: GPL-2.0-or-later
// A laboratory whose console is open in real browsers.
import { cpSync, mkdirSync, readFileSync, writeFileSync } from "node:fs";
import { join } from "node:path";
import axe from "axe-core";
import { chromium } from "playwright-core";
import { Laboratory, ROOT } from "../../../client/dist-test/e2e/laboratory.js";

export { ROOT };
process.setMaxListeners(100); // each program of a laboratory wants to be ended with this one
const DIST = new URL("../../dist", import.meta.url).pathname;
/** A machine that runs a browser, a server and robots in tests has its own ideas of 250 ms. */
const CONFIG = "FrontEndServer.WatchdogBusyMs = 2000\n";

/** One for all houses of a run. */
let browser;
export async function closeBrowser() {
    await browser?.close();
    browser = undefined;
}

export class House {
    /** What browsers complained about: errors of scripts, and what the content security policy has blocked. */
    complaints = [];
    foreign = [];
    contexts = [];
    /** For a page, and for each thing that is looked for on it. */
    patienceMs = 8000;

    /** With `transport`, the virtual laboratory runs first; a slow machine wants AXON_LAB_SPEED below 1, and everything takes the laboratory's time. */
    static async open({ users, globalServices, config = "", transport = false } = {}) {
        const house = new House();
        house.lab = new Laboratory({ ...(globalServices === undefined ? {} : { globalServices }) });
        const file = join(house.lab.folder, "server.cfg");
        writeFileSync(file, CONFIG + config, { mode: 0o600 });
        house.options = ["--config", file, "--console-files", DIST];
        for (const [name, role, password] of users ?? []) await house.lab.addUser(name, role, password);
        if (transport) await house.startWorld();
        await house.startServer();
        if (transport) house.startTransport();
        browser ??= await chromium.launch({ executablePath: process.env.AXON_CHROMIUM ?? "/usr/bin/chromium", args: ["--no-sandbox", "--disable-gpu"] });
        return house;
    }
    async startWorld() {
        const { lab } = this;
        const speed = process.env.AXON_LAB_SPEED ?? "1";
        const clock = join(lab.folder, "clock");
        const program = lab.start("axon-lab", "axon-lab", "--port", "0", ...(speed === "1" ? [] : ["--speed", speed, "--clock", clock]));
        this.world = Object.fromEntries((await program.line("ready ", 60_000)).split(" ").slice(1).map((word) => [word.slice(0, word.indexOf("=")), word.slice(word.indexOf("=") + 1)]));
        if (speed !== "1") lab.env.AXON_CLOCK = clock;
    }
    /** The virtual laboratory of the transport: two mobile robots and two arms, each with its application and Entity Manager. */
    startTransport() {
        const { lab, world: at } = this;
        for (const [name, place] of Object.entries({ PeopleBot: "2400,2000,180", PeopleBot2: "2400,4000,180", Cyton: "555,2000,660", Cyton2: "555,4000,660" })) {
            const robot = at[name] ?? "";
            const words = name.startsWith("Cyton") ? ["--arm", robot] : ["--robot", robot, "--camera", at[`${name}.camera`] ?? ""];
            const application = `web-${process.pid}-${name}`;
            lab.start(`application of ${name}`, name.startsWith("Cyton") ? "axon-cyton" : "axon-peoplebot", ...words, "--application", application, "--name", name, "--ports", lab.ports, "--at", place);
            const file = join(lab.folder, `${name}.cfg`);
            writeFileSync(file, "Axon.LeaseGrace=20\n", { mode: 0o600 });
            lab.start(`manager of ${name}`, "axon-entity-manager", "--application", application, "--ports", lab.ports, "--server", lab.at.entity, "--config", file);
        }
    }
    async startServer() {
        const { lab } = this;
        // The same ports again after a restart, as those of a real laboratory.
        const console = this.url === undefined ? "127.0.0.1:0" : new URL(this.url).host;
        const own = lab.serverOptions.length;
        lab.serverOptions.push(...this.options, "--console-endpoint", console, "--console-session-endpoint", this.sessions ?? "127.0.0.1:0");
        if (this.signals !== undefined) lab.serverOptions.push("--console-signal-endpoint", this.signals);
        await lab.startServer();
        lab.serverOptions.length = own;
        this.url ??= lab.at.console;
    }
    /** A copy of a folder of profiles, with texts replaced. */
    profiles(from, change) {
        const folder = join(this.lab.folder, `profiles-${this.lab.programs.length}`);
        mkdirSync(folder);
        cpSync(join(ROOT, from), folder, { recursive: true });
        for (const name of ["basic.xml", "services.xml"]) writeFileSync(join(folder, name), change(readFileSync(join(folder, name), "utf8")));
        return folder;
    }
    /** That a counter finishes although its client is lost. */
    startPatientCounter() {
        const application = `web-${process.pid}-patient`;
        const folder = this.profiles("tests/foreign/robot", (text) => text.replace('blocking="true"', 'blocking="true" on_client_loss="finish" max_duration="60"').replace('name="Counter"', 'name="Patient"'));
        return this.lab.startEntity("foreign-counter", application, [folder, this.lab.portsFile, application]);
    }
    startGreeter(change = (text) => text, config = "") {
        const folder = this.profiles("examples/01_hello_entity", change);
        return this.lab.startEntity("hello-entity", "Greeter", [folder, this.lab.portsFile], `Axon.LeaseGrace=20\n${config}`);
    }
    /** A page of a browser of its own, as another person's. `script` is run in the page before its own. */
    async person({ width = 1280, height = 800, scheme = "light", name = "", path = "", locale = "en-GB", script } = {}) {
        const context = await browser.newContext({ viewport: { width, height }, colorScheme: scheme, locale });
        this.contexts.push(context);
        const page = await context.newPage();
        page.setDefaultTimeout(this.patienceMs);
        page.on("pageerror", (error) => this.complaints.push(error.message));
        page.on("console", (message) => message.type() === "error" && !/Failed to load resource|WebSocket connection/.test(message.text()) && this.complaints.push(message.text()));
        page.on("dialog", (dialog) => (this.complaints.push(`a dialog: ${dialog.message()}`), dialog.dismiss()));
        page.on("request", (request) => /^https?:/.test(request.url()) && !request.url().startsWith(this.url) && this.foreign.push(request.url()));
        if (script !== undefined) await page.addInitScript(script);
        if (name !== "") await page.addInitScript((own) => localStorage.setItem("axon-name", own), name);
        await page.goto(this.url + path);
        return page;
    }
    /** All of them, with their workers, as a browser may do that is short of memory. Their clocks go on, unlike those of a computer that sleeps. */
    async freezeTabs(ms) {
        const session = await browser.newBrowserCDPSession();
        const { processInfo } = await session.send("SystemInfo.getProcessInfo");
        await session.detach();
        // A tab may end meanwhile.
        const ifThere = (use) => {
            try {
                return use();
            } catch (error) {
                if (error.code !== "ENOENT" && error.code !== "ESRCH") throw error;
                return undefined;
            }
        };
        const tabs = processInfo.map(({ id }) => id).filter((id) => ifThere(() => readFileSync(`/proc/${id}/cmdline`, "utf8"))?.includes("--type=renderer"));
        try {
            for (const id of tabs) ifThere(() => process.kill(id, "SIGSTOP"));
            await new Promise((wake) => setTimeout(wake, ms));
        } finally {
            for (const id of tabs) ifThere(() => process.kill(id, "SIGCONT"));
        }
    }
    async end() {
        await Promise.all(this.contexts.map((one) => one.close()));
        await this.lab.end();
    }
}

export async function goTo(page, where) {
    await page.evaluate((hash) => (location.hash = hash), where);
    await page.waitForTimeout(50);
}
export async function openEntity(page, name) {
    await goTo(page, "#/");
    await page.locator(`[data-entity="${name}"], [data-spot="${name}"]`).first().waitFor();
    if ((await page.locator("[data-spot]").count()) > 0) await page.getByRole("button", { name: "Cards", exact: true }).click();
    await page.locator(`[data-entity="${name}"] h3 a`).click();
    await page.getByRole("heading", { name, level: 1 }).waitFor();
}
/** Of the entity whose page is open. */
export async function checkOut(page, name) {
    await page.getByRole("button", { name: `Check out ${name}` }).click();
    await page.getByText(`${name} is yours`, { exact: true }).first().waitFor();
}
/**
 * What a browser does to the timers of a tab that has been in the background for long: they wait. Those of workers do not.
 * Real throttling needs a window and five minutes.
 */
export const throttleable = () => {
    const held = new Map();
    let throttled = false;
    const plain = Object.fromEntries([setTimeout, clearTimeout, setInterval, requestAnimationFrame].map((one) => [one.name, one.bind(globalThis)]));
    globalThis.setTimeout = (call, ms, ...words) => {
        const run = () => (throttled ? held.set(id, run) : call(...words));
        const id = plain.setTimeout(run, ms);
        return id;
    };
    globalThis.clearTimeout = (id) => (held.delete(id), plain.clearTimeout(id));
    globalThis.setInterval = (call, ms, ...words) => plain.setInterval(() => throttled || call(...words), ms);
    globalThis.requestAnimationFrame = (call) => {
        const run = (at) => (throttled ? held.set(run, () => run(performance.now())) : call(at));
        return plain.requestAnimationFrame(run);
    };
    globalThis.throttle = (on) => {
        throttled = on;
        Object.defineProperty(document, "visibilityState", { value: on ? "hidden" : "visible", configurable: true });
        document.dispatchEvent(new Event("visibilitychange"));
        if (on) return;
        const all = [...held.values()];
        held.clear();
        for (const run of all) run();
    };
};
/** Into every field that a person can type in now. */
export async function fillAll(page, text) {
    let count = 0;
    for (const field of await page.locator("input:not([type=file], [type=checkbox], [type=range]):visible, textarea:visible").all()) {
        if (!(await field.isEditable())) continue;
        await field.fill(text);
        ++count;
    }
    return count;
}
export const runButton = (page, service) => page.locator(`[data-service="${service}"] .act button[type=submit]`);

/** What axe-core calls serious or critical, in words. */
export async function obstacles(page) {
    await page.evaluate(axe.source);
    const { violations } = await page.evaluate(() => globalThis.axe.run(document, { resultTypes: ["violations"] }));
    return violations.filter(({ impact }) => impact === "serious" || impact === "critical").map(({ id, help, nodes }) => `${id}: ${help}: ${nodes.slice(0, 3).map(({ html, any }) => `${html} ${any[0]?.message ?? ""}`).join(" | ")}`);
}
