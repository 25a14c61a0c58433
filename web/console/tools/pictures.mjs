// SPDX-License-Identifier: GPL-2.0-or-later
// Takes pictures of the pages: python3 web/console/test/console_test.py --pictures FOLDER
import { statSync } from "node:fs";
import { join } from "node:path";
import { goTo, House, openEntity, ROOT, runButton } from "../test/e2e/support.mjs";

const to = process.argv[2];
const MOST_BYTES = 150_000;
const five = join(ROOT, "examples/05_collaboration");
const house = await House.open({ globalServices: join(five, "globalservices") });
const take = async (page, name) => {
    const path = join(to, `console_${name}.png`);
    await page.waitForTimeout(300);
    await page.screenshot({ path });
    if (statSync(path).size > MOST_BYTES) throw new Error(`${path} has more than ${MOST_BYTES} bytes`);
};
try {
    house.startGreeter();
    house.lab.startCounter();
    for (const [name, application] of [
        ["arm", "Arm"],
        ["planner", "Planner"],
        ["shuttle", "Shuttle"],
    ])
        house.lab.startEntity(`${name}-entity`, application, [five, house.lab.portsFile]);
    house.lab.startEntity("cart-entity", "Cart", [join(ROOT, "examples/04_stop"), house.lab.portsFile]);
    const second = await house.person({ name: "client2" });
    await openEntity(second, "Shuttle");
    await second.getByRole("button", { name: "Check out Shuttle" }).click();
    const first = await house.person({ name: "client1" });
    await openEntity(first, "Counter");
    await first.getByRole("button", { name: "Check out Counter" }).click();
    await first.locator(".fields").getByLabel("To").fill("2000");
    await runButton(first, "Count").click();
    await first.locator("[data-task=RUNNING]").waitFor();
    await first.getByRole("button", { name: "Dismiss" }).click();
    await first.waitForTimeout(4000);
    await take(first, "entity");
    await goTo(first, "#/");
    await first.locator("[data-entity]").nth(5).waitFor();
    await take(first, "laboratory");
    const phone = await house.person({ name: "phone", width: 360, height: 740, scheme: "dark", path: "#/stop" });
    await phone.locator("main .rows .danger").first().waitFor();
    await phone.locator(".dock .stop").click();
    await phone.locator(".receipt.good").nth(5).waitFor();
    await take(phone, "stop");
} finally {
    await house.end();
}
