// SPDX-License-Identifier: GPL-2.0-or-later
// A laboratory whose console is open in real browsers.
import { cpSync, mkdirSync, readFileSync, writeFileSync } from "node:fs";
import { join } from "node:path";
import axe from "axe-core";
import { chromium } from "playwright-core";
import { Laboratory, ROOT } from "../../../client/dist-test/e2e/laboratory.js";

export { ROOT };
const DIST = new URL("../../dist", import.meta.url).pathname;
/** A machine that runs a browser, a server and robots in tests has its own ideas of 250 ms. */
const CONFIG = "FrontEndServer.WatchdogBusyMs = 2000\n";

export class House {
    /** What browsers complained about: errors of scripts, and what the content security policy has blocked. */
    complaints = [];
    foreign = [];

    static async open({ users, globalServices, config = "" } = {}) {
        const house = new House();
        house.lab = new Laboratory({ ...(globalServices === undefined ? {} : { globalServices }) });
        const file = join(house.lab.folder, "server.cfg");
        writeFileSync(file, CONFIG + config, { mode: 0o600 });
        house.options = ["--config", file, "--console-files", DIST];
        for (const [name, role, password] of users ?? []) await house.lab.addUser(name, role, password);
        await house.startServer();
        house.browser = await chromium.launch({ executablePath: process.env.AXON_CHROMIUM ?? "/usr/bin/chromium", args: ["--no-sandbox", "--disable-gpu"] });
        return house;
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
    /** The profiles of an example, with texts replaced. */
    startGreeter(change = (text) => text, config = "") {
        const folder = join(this.lab.folder, `profiles-${this.lab.programs.length}`);
        mkdirSync(folder);
        cpSync(join(ROOT, "examples/01_hello_entity"), folder, { recursive: true });
        for (const name of ["basic.xml", "services.xml"]) writeFileSync(join(folder, name), change(readFileSync(join(folder, name), "utf8")));
        return this.lab.startEntity("hello-entity", "Greeter", [folder, this.lab.portsFile], `Axon.LeaseGrace=20\n${config}`);
    }
    /** A page of a browser of its own, as another person's. */
    async person({ width = 1280, height = 800, scheme = "light", name = "", path = "" } = {}) {
        const context = await this.browser.newContext({ viewport: { width, height }, colorScheme: scheme, locale: "en-GB" });
        const page = await context.newPage();
        page.setDefaultTimeout(8000);
        page.on("pageerror", (error) => this.complaints.push(error.message));
        page.on("console", (message) => message.type() === "error" && !/Failed to load resource|WebSocket connection/.test(message.text()) && this.complaints.push(message.text()));
        page.on("dialog", (dialog) => (this.complaints.push(`a dialog: ${dialog.message()}`), dialog.dismiss()));
        page.on("request", (request) => /^https?:/.test(request.url()) && !request.url().startsWith(this.url) && this.foreign.push(request.url()));
        if (name !== "") await page.addInitScript((own) => localStorage.setItem("axon-name", own), name);
        await page.goto(this.url + path);
        return page;
    }
    async end() {
        await this.browser?.close();
        await this.lab.end();
    }
}

export async function goTo(page, where) {
    await page.evaluate((hash) => (location.hash = hash), where);
    await page.waitForTimeout(50);
}
export async function openEntity(page, name) {
    await goTo(page, "#/");
    await page.locator(`[data-entity="${name}"] h3 a`).click();
    await page.getByRole("heading", { name, level: 1 }).waitFor();
}
export const runButton = (page, service) => page.locator(`[data-service="${service}"] .act button[type=submit]`);

/** What axe-core calls serious or critical, in words. */
export async function obstacles(page) {
    await page.evaluate(axe.source);
    const { violations } = await page.evaluate(() => globalThis.axe.run(document, { resultTypes: ["violations"] }));
    return violations.filter(({ impact }) => impact === "serious" || impact === "critical").map(({ id, help, nodes }) => `${id}: ${help}: ${nodes.slice(0, 3).map(({ html, any }) => `${html} ${any[0]?.message ?? ""}`).join(" | ")}`);
}
