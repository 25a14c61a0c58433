// SPDX-License-Identifier: GPL-2.0-or-later
// Takes pictures of the pages, while two mobile robots and two arms of the virtual laboratory work:
// python3 web/console/test/console_test.py --pictures FOLDER
// With AXON_ALL_PICTURES=1 also those that are not in the documentation: every page, light and dark, and on a phone.
import { mkdirSync, statSync } from "node:fs";
import { join } from "node:path";
import { checkOut, closeBrowser, goTo, House, openEntity, ROOT, runButton } from "../test/e2e/support.mjs";

const to = process.argv[2];
const all = process.env.AXON_ALL_PICTURES === "1";
const MOST_BYTES = 220_000;
const QUALITY = 82;
mkdirSync(to, { recursive: true });
const map = join(ROOT, "lab/worlds/transport.map");
const house = await House.open({ globalServices: join(ROOT, "lab/globalservices"), transport: true });
house.patienceMs = 60_000; // a whole laboratory runs beside the browser

/** Documented ones have a short name. */
async function take(page, name, { look = "desktop_light", documented = false } = {}) {
    if (!documented && !all) return;
    const path = join(to, documented ? `console_${name}.jpg` : `console_${name}_${look}.jpg`);
    await page.waitForTimeout(300);
    await page.screenshot({ path, type: "jpeg", quality: QUALITY });
    console.log(path);
    if (documented && statSync(path).size > MOST_BYTES) throw new Error(`${path} has more than ${MOST_BYTES} bytes`);
}
/** Another person's page, in each size and scheme. */
async function visit(path, name, ready = async () => {}) {
    if (!all) return;
    for (const [size, scheme, width, height] of [
        ["desktop", "dark", 1440, 900],
        ["phone", "light", 360, 740],
        ["phone", "dark", 360, 740],
        ["wide", "light", 3840, 2160],
    ]) {
        const page = await house.person({ name: "client2", width, height, scheme, path });
        await page.locator("main h1").waitFor();
        await ready(page);
        await page.waitForTimeout(1500);
        await take(page, name, { look: `${size}_${scheme}` });
        await page.context().close();
    }
}
const wait = (page, hasText) => page.getByText(hasText).first().waitFor();

try {
    house.startGreeter();
    house.lab.startEntity("plotter-entity", "Plotter", [join(ROOT, "examples/03_parameters"), house.lab.portsFile]);
    const first = await house.person({ name: "client1", width: 1440, height: 900 });
    await first.locator("[data-entity=PeopleBot2]").waitFor();
    for (const name of ["PeopleBot", "PeopleBot2"]) {
        await openEntity(first, name);
        await checkOut(first, name);
        await first.getByRole("tab", { name: "Navigation", exact: true }).click();
        await first.locator("[data-resource=Map] input").setInputFiles(map);
        await wait(first, "transport.map: uploaded");
    }
    await first.locator(".fields").getByLabel("Destination").fill("Middle");
    await runButton(first, "Navigation").click();
    await first.locator("[data-task=RUNNING]").waitFor();
    await first.waitForTimeout(2500);
    await take(first, "entity", { documented: true });
    await first.getByRole("heading", { name: "What it measures" }).evaluate((one) => one.scrollIntoView({ block: "start" }));
    await first.waitForTimeout(1500);
    await take(first, "streams", { documented: true });
    const hash = new URL(first.url()).hash;
    await goTo(first, "#/");
    await first.locator("[data-entity]").nth(5).waitFor();
    await first.locator("[data-entity=PeopleBot] .battery").waitFor();
    await take(first, "laboratory", { documented: true });
    await first.getByRole("button", { name: "Map", exact: true }).click();
    await first.waitForTimeout(2500);
    await take(first, "map", { documented: true });
    await visit("#/", "laboratory", (page) => page.locator("[data-entity]").nth(5).waitFor());
    await visit("#/", "map", async (page) => {
        await page.locator("[data-entity]").nth(5).waitFor();
        await page.getByRole("button", { name: "Map", exact: true }).click();
    });
    await visit(hash, "entity", (page) => page.locator("[data-service]").waitFor());

    const second = await house.person({ name: "client2", width: 1440, height: 900 });
    await goTo(second, hash);
    await second.getByRole("button", { name: "Wait in line" }).click();
    await wait(second, "You are number 1 in line.");
    await take(second, "waiting");
    await openEntity(first, "PeopleBot2");
    await first.getByRole("button", { name: "Release it" }).click();
    await second.context().close();
    await openEntity(first, "Cyton");
    await checkOut(first, "Cyton");
    await goTo(first, "#/collaboration");
    await first.getByRole("button", { name: "Plan it Transport", exact: true }).click();
    await first.getByLabel(/^Role 1/).selectOption({ label: "PeopleBot" });
    await first.getByLabel(/^Role 2/).selectOption({ label: "Cyton" });
    await first.getByRole("button", { name: "Run Transport", exact: true }).waitFor();
    await take(first, "plan");
    await first.getByRole("button", { name: "Check, nothing moves" }).click();
    await wait(first, "It can be run as it is. Nothing has moved.");
    await take(first, "check");
    await first.getByRole("button", { name: "Run Transport", exact: true }).click();
    await first.locator("section[aria-label='Run of Transport'] .timeline li.busy", { hasText: "PeopleBot" }).waitFor({ timeout: 120_000 });
    await first.waitForTimeout(4000);
    await first.evaluate(() => scrollTo(0, 0));
    await take(first, "collaboration", { documented: true });
    await visit("#/collaboration", "collaboration");

    const phone = await house.person({ name: "phone", width: 360, height: 740, scheme: "dark", path: "#/stop" });
    await phone.locator("main .rows .danger").first().waitFor();
    await take(phone, "stop_before", { look: "phone_dark" });
    await phone.locator(".dock .stop").click();
    await phone.locator(".receipt.good").nth(5).waitFor();
    await take(phone, "stop", { documented: true });
    await take(first, "collaboration_stopped");
    await openEntity(first, "PeopleBot");
    await take(first, "entity_stopped");
    await first.locator(".dock .stop").click();
    await wait(first, "Confirmed by it.");
    await goTo(first, "#/activity");
    await first.locator(".figures", { hasText: "measured" }).nth(3).waitFor();
    await first.waitForTimeout(9000);
    await take(first, "activity", { documented: true });
    await visit("#/activity", "activity", (page) => page.waitForTimeout(4000));
    await visit("#/stop", "stop");
} finally {
    await house.end();
    await closeBrowser();
}
