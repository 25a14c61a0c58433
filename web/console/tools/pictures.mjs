// SPDX-License-Identifier: GPL-2.0-or-later
// Takes pictures of the pages, while two mobile robots and two arms of the virtual laboratory work:
// python3 web/console/test/console_test.py --pictures FOLDER
// With AXON_ALL_PICTURES=1 also those that are not in the documentation: every page, light and dark, and on a phone.
import { mkdirSync, statSync } from "node:fs";
import { join } from "node:path";
import { checkOut, goTo, House, openEntity, ROOT, runButton } from "../test/e2e/support.mjs";

const to = process.argv[2];
const all = process.env.AXON_ALL_PICTURES === "1";
const MOST_BYTES = 220_000;
const QUALITY = 82;
mkdirSync(to, { recursive: true });
const map = join(ROOT, "lab/worlds/transport.map");
const house = await House.open({ globalServices: join(ROOT, "lab/globalservices") });
const names = new Set();

async function take(page, name, documented = false) {
    if (!documented && !all) return;
    const file = documented ? name.replace(/_(desktop|phone)_(light|dark)$/, "") : name;
    names.add(file);
    const path = join(to, `console_${file}.jpg`);
    await page.waitForTimeout(300);
    await page.screenshot({ path, type: "jpeg", quality: QUALITY });
    if (statSync(path).size > MOST_BYTES) throw new Error(`${path} has more than ${MOST_BYTES} bytes`);
}
const look = { desktop: [1440, 900], phone: [360, 740], wide: [3840, 2160] };
/** Another person's page, of each size and scheme. */
async function each(path, name, documented, ready = async () => {}) {
    for (const [size, scheme] of all
        ? [
              ["desktop", "light"],
              ["desktop", "dark"],
              ["phone", "light"],
              ["phone", "dark"],
              ["wide", "light"],
          ]
        : [["desktop", "light"]]) {
        const page = await house.person({ name: "client2", width: look[size][0], height: look[size][1], scheme, path });
        await page.locator("main h1").waitFor();
        await ready(page);
        await page.waitForTimeout(1500);
        await take(page, `${name}_${size}_${scheme}`, documented && size === "desktop" && scheme === "light");
        await page.context().close();
    }
}

try {
    await house.startTransport();
    house.startGreeter();
    house.lab.startEntity("plotter-entity", "Plotter", [join(ROOT, "examples/03_parameters"), house.lab.portsFile]);
    const first = await house.person({ name: "client1", width: 1440, height: 900 });
    first.setDefaultTimeout(60_000);
    for (const name of ["Cyton", "PeopleBot", "PeopleBot2"]) {
        await openEntity(first, name);
        await checkOut(first, name);
        if (!name.startsWith("PeopleBot")) continue;
        await first.getByRole("tab", { name: "Navigation" }).click();
        await first.getByLabel("Map", { exact: true }).setInputFiles(map);
        await first.getByText("transport.map: uploaded").waitFor();
    }
    await openEntity(first, "PeopleBot2");
    await first.getByRole("tab", { name: "Navigation" }).click();
    await first.locator(".fields").getByLabel("Destination").fill("Middle");
    await runButton(first, "Navigation").click();
    await first.locator("[data-task=RUNNING]").waitFor();
    await goTo(first, "#/collaboration");
    await first.getByRole("button", { name: "Plan it Transport", exact: true }).click();
    await first.getByRole("button", { name: "Check, nothing moves" }).waitFor();
    await take(first, "plan_desktop_light", false);
    await first.getByRole("button", { name: "Run Transport", exact: true }).click();
    await first.locator("[data-run=RUNNING]").waitFor();
    await first.waitForTimeout(9000);
    await take(first, "collaboration_desktop_light", true);
    await goTo(first, "#/");
    await first.locator("[data-entity]").nth(5).waitFor();
    await take(first, "mine_desktop_light", false);
    await first.getByRole("button", { name: "Map" }).click();
    await first.waitForTimeout(2500);
    await take(first, "map_desktop_light", true);
    await openEntity(first, "PeopleBot");
    await first.waitForTimeout(4000);
    await take(first, "entity_desktop_light", true);
    await first.locator("[data-stream]").first().scrollIntoViewIfNeeded();
    await first.evaluate(() => document.querySelector(".streams")?.scrollIntoView({ block: "start" }));
    await take(first, "streams_desktop_light", true);
    await each("#/", "laboratory", true, (page) => page.locator("[data-entity]").nth(5).waitFor());
    const hash = await (async () => {
        await openEntity(first, "PeopleBot");
        return new URL(first.url()).hash;
    })();
    await each(hash, "visitor", false, (page) => page.locator("[data-service]").waitFor());
    await each("#/", "map", false, async (page) => {
        await page.locator("[data-entity]").nth(5).waitFor();
        await page.getByRole("button", { name: "Map" }).click();
    });
    await each("#/collaboration", "jobs", false);
    await goTo(first, "#/activity");
    await first.waitForTimeout(4000);
    await take(first, "activity_desktop_light", true);
    await each("#/activity", "activity2", false);
    const phone = await house.person({ name: "phone", width: 360, height: 740, scheme: "dark", path: "#/stop" });
    phone.setDefaultTimeout(20_000);
    await phone.locator("main .rows .danger").first().waitFor();
    await take(phone, "stop_before_phone_dark");
    await phone.locator(".dock .stop").click();
    await phone.locator(".receipt.good").nth(5).waitFor();
    await take(phone, "stop_phone_dark", true);
    await each("#/stop", "stopped", false);
    await goTo(first, "#/collaboration");
    await take(first, "collaboration_stopped_desktop_light");
    await openEntity(first, "PeopleBot");
    await take(first, "entity_stopped_desktop_light");
} finally {
    await house.end();
}
console.log(`pictures: ${[...names].join(", ")}`);
