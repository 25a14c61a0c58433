// SPDX-License-Identifier: GPL-2.0-or-later
// The console in real Chromium, with a real server, Entity Managers and robot applications.
import assert from "node:assert/strict";
import { createHash } from "node:crypto";
import { mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { after, before, test } from "node:test";
import { checkOut, closeBrowser, fillAll, goTo, House, obstacles, openEntity, ROOT, runButton, throttleable } from "./support.mjs";

/** Of each test but the transport (web/CMakeLists.txt); usual are a few seconds. */
const limited = { timeout: 90_000 };
const PAGES = ["#/", "#/collaboration", "#/activity", "#/stop"];

const HOSTILE = '"><img src=x onerror="globalThis.hacked=1"><script>globalThis.hacked=2</script>{{7*7}}';
const asXml = (text) => text.replaceAll("&", "&amp;").replaceAll("<", "&lt;").replaceAll('"', "&quot;");

/** Notes when the banner about the server came and went, on the clock of Date.now(). */
const watchBanner = () => {
    globalThis.banners = [];
    let shown = false;
    const look = () => {
        const is = document.querySelector("[role=alert].banner") !== null;
        if (is !== shown) globalThis.banners.push({ shown: (shown = is), at: Date.now() });
    };
    new MutationObserver(look).observe(document, { childList: true, subtree: true });
};

const jobs = mkdtempSync(join(tmpdir(), "axon-jobs-"));
/** @type {House} */
let house;
let greeter;
before(async () => {
    writeFileSync(
        join(jobs, "hostile.xml"),
        `<?xml version="1.0"?>
<GlobalProfile count="1">
  <Service name="Job &lt;b&gt;bold" descr="${asXml(HOSTILE)}">
    <entity category="ROBOT" type="MOBILE" id="0" service_global_id="&lt;img src=x onerror=alert(1)&gt;" preced="1"/>
  </Service>
</GlobalProfile>`,
    );
    house = await House.open({ globalServices: jobs });
    greeter = house.startGreeter();
    house.lab.startCounter("Axon.LeaseGrace=20\n");
});
after(async () => {
    await house?.end();
    await closeBrowser();
    rmSync(jobs, { recursive: true, force: true });
});

test("ANewcomerFinishesATask", limited, async () => {
    const page = await house.person();
    await page.locator("[data-entity=Greeter] .badge", { hasText: "free" }).waitFor();
    await page.locator("[data-entity=Greeter] h3 a").click();
    await runButton(page, "Greet").click({ force: true });
    await page.getByText("Check out Greeter first.").waitFor();
    await page.getByRole("button", { name: "Check out Greeter" }).click();
    await page.getByText("Greeter is yours", { exact: true }).first().waitFor();
    await runButton(page, "Greet").click({ force: true });
    await page.getByText("Still missing: Name.").waitFor();
    await page.getByLabel("Name").fill("client1");
    await page.getByLabel("Times").fill("lots");
    await page.getByText("Expected a whole number, 1 to 1,000.").waitFor();
    await page.getByLabel("Times").fill("2");
    await runButton(page, "Greet").click();
    await page.locator("[data-task=SUCCEEDED]").waitFor();
    assert.match(await page.locator("[data-task]").innerText(), /Hello, client1!/);
    await page.getByRole("button", { name: "Release it" }).click();
    await page.getByRole("button", { name: "Check out Greeter" }).waitFor();
    await page.context().close();
});

test("TwoPeopleWantOneRobot", limited, async () => {
    const [first, second] = await Promise.all([house.person({ name: "client1" }), house.person({ name: "client2" })]);
    await openEntity(first, "Greeter");
    await first.getByRole("button", { name: "Check out Greeter" }).click();
    await openEntity(second, "Greeter");
    await second.getByRole("button", { name: "Ask client1@web for it …" }).click();
    await second.getByLabel("Why you need it").fill("<i>please</i>");
    await second.getByRole("button", { name: "Ask", exact: true }).click();
    await first.getByText("client2@web asks for Greeter.").waitFor();
    await first.getByText("<i>please</i>", { exact: true }).waitFor();
    await first.getByRole("button", { name: "Keep it" }).click();
    await second.getByText(/You are number 1 in line/).waitFor(); // the answer was no, so the second waits
    await second.getByRole("button", { name: "Give up waiting" }).click();
    await second.getByRole("button", { name: "Wait in line" }).click();
    await second.getByText("You are number 1 in line.").waitFor();
    await goTo(first, "#/");
    await first.locator("[data-entity=Greeter]", { hasText: "1 in line" }).waitFor();
    await openEntity(first, "Greeter");
    await first.getByRole("button", { name: "Release it" }).click();
    await second.getByText("Greeter is yours", { exact: true }).first().waitFor();
    // A page that is loaded again has what it held.
    await second.reload();
    await second.getByText("You still have Greeter.").waitFor();
    await openEntity(second, "Greeter");
    await second.getByRole("button", { name: "Release it" }).click();
    await Promise.all([first.context().close(), second.context().close()]);
});

test("EveryPageStopsAtTheSamePlace", limited, async () => {
    const page = await house.person();
    await page.locator("[data-entity=Counter]").waitFor();
    const places = new Set();
    const stop = page.locator(".dock .stop");
    await openEntity(page, "Counter");
    const entity = new URL(page.url()).hash;
    for (const where of [entity, ...PAGES]) {
        await goTo(page, where);
        const box = await stop.boundingBox();
        places.add(`${box.x + box.width} ${Math.round(box.y + box.height)}`);
        assert.equal(await stop.innerText(), where === entity ? "STOP Counter" : "STOP everything");
        await stop.click();
        await page.getByRole("region", { name: "Receipt of the stop" }).getByText(where === entity ? "Confirmed by it." : "Confirmed by all 2.").waitFor();
        await page.locator(".receipt.good .stages", { hasText: "robot told" }).first().waitFor();
        await page.getByRole("button", { name: "Close the receipt" }).click();
    }
    assert.equal(places.size, 1, [...places].join("; "));
    await goTo(page, "#/");
    await page.keyboard.press("Escape");
    await page.keyboard.press("Escape");
    await page.getByText("Confirmed by all 2.").waitFor();
    // However long the button is held, that is one stop.
    await page.getByRole("button", { name: "Close the receipt" }).click();
    await stop.hover();
    await page.mouse.down();
    await page.getByText("Confirmed by all 2.").waitFor();
    await page.waitForTimeout(1200);
    await page.getByRole("button", { name: "Close the receipt" }).evaluate((button) => button.click());
    await page.mouse.up();
    await page.waitForTimeout(100);
    assert.equal(await page.getByRole("region", { name: "Receipt of the stop" }).count(), 0);
    await goTo(page, "#/stop");
    await page.getByRole("button", { name: "Stop Counter", exact: true }).click();
    await page.getByText("Stop of Counter").waitFor();
    await page.getByRole("img", { name: /QR code of/ }).waitFor();
    for (const name of ["Counter", "Greeter"]) {
        await page.locator("main").getByRole("button", { name: `Rearm ${name}` }).click();
        await page.getByText(`${name} is rearmed.`).waitFor();
    }
    await page.getByText("None is stopped.").waitFor();
    await page.context().close();
});

test("AHiddenTabStopsItsRobotAfterAWarning", limited, async () => {
    const page = await house.person();
    await openEntity(page, "Counter");
    await page.getByRole("button", { name: "Check out Counter" }).click();
    await page.locator(".fields").getByLabel("To").fill("5000");
    await runButton(page, "Count").click();
    await page.locator("[data-task=RUNNING]").waitFor();
    await page.locator("[data-stream=count][data-kind=scalar] .plot canvas").waitFor();
    await page.evaluate(() => {
        Object.defineProperty(document, "visibilityState", { value: "hidden", configurable: true });
        document.dispatchEvent(new Event("visibilitychange"));
    });
    await page.waitForFunction(() => document.title.includes("stops in"));
    assert.equal(await page.locator("[data-task=RUNNING]").count(), 1);
    await page.locator("[data-task=STOPPED]").waitFor({ timeout: 5000 });
    await page.evaluate(() => {
        delete document.visibilityState;
        document.dispatchEvent(new Event("visibilitychange"));
    });
    await page.getByText(/Counter was stopped at .* because this tab was out of sight/).first().waitFor();
    await page.locator(".banner").getByRole("button", { name: "Rearm Counter" }).click();
    await page.getByText("Counter is rearmed.").waitFor();
    await page.getByRole("button", { name: "Release it" }).click();
    await page.getByRole("button", { name: "Check out Counter" }).waitFor();
    await page.context().close();
});

test("ABackgroundTabWithoutTimersKeepsItsRobot", limited, async () => {
    const programs = house.startPatientCounter();
    const [page, watcher] = await Promise.all([house.person({ name: "client1", script: `(${throttleable})(); (${watchBanner})();` }), house.person({ name: "client2" })]);
    await page.locator("[data-entity=Patient]").waitFor({ timeout: 20_000 });
    await openEntity(page, "Patient");
    await checkOut(page, "Patient");
    await page.locator(".fields").getByLabel("To").fill("250");
    await runButton(page, "Count").click();
    await page.locator("[data-task=RUNNING]").waitFor();
    await page.evaluate(() => globalThis.throttle(true));
    const card = watcher.locator("[data-entity=Patient]");
    await card.locator(".badge", { hasText: "BUSY" }).waitFor();
    await card.locator(".badge", { hasText: "REG" }).waitFor({ timeout: 15_000 }); // 5 s later, which is more than a watchdog
    assert.match(await card.innerText(), /client1@web/);
    await goTo(watcher, "#/activity");
    assert.equal(await watcher.locator(".entries li", { hasText: "Patient" }).filter({ hasText: /is lost|was stopped/ }).count(), 0);
    await page.evaluate(() => globalThis.throttle(false));
    await page.locator("[data-task=SUCCEEDED]").waitFor();
    assert.deepEqual(await page.evaluate(() => globalThis.banners), []);
    await page.getByRole("button", { name: "Release it" }).click();
    await goTo(watcher, "#/");
    await Promise.all([programs.app.end(), programs.manager.end()]);
    await card.waitFor({ state: "detached" });
    await Promise.all([page.context().close(), watcher.context().close()]);
});

test("ActivityTellsWhatWasRefusedAndHowFastStopsAre", limited, async () => {
    const page = await house.person();
    await openEntity(page, "Counter");
    await page.locator(".dock .stop").click();
    await page.getByText("Confirmed by it.").waitFor();
    await page.locator(".dock").getByRole("button", { name: "Rearm Counter" }).click();
    await page.getByText("Counter is rearmed.").waitFor();
    await goTo(page, "#/activity");
    const figures = (title) => page.getByRole("region", { name: title, exact: true }).locator(".figures", { hasText: "measured" });
    for (const title of ["Stops, confirmed", "To a robot and back", "To an Entity Manager and back"]) {
        await figures(title).waitFor();
        const text = await figures(title).innerText();
        assert.match(text, /^\d+ measured: half within [\d.,]+ ms, 95 % within [\d.,]+ ms, the longest [\d.,]+ ms\.$/);
        await page.getByRole("img", { name: new RegExp(`^${title}: `) }).waitFor();
    }
    await page.locator("[data-margins=Counter] .figures", { hasText: / ms of / }).first().waitFor();
    await page.getByRole("button", { name: "States" }).click();
    assert.equal(await page.locator(".entries [data-kind=state], .entries li.state").count(), 0);
    await page.getByRole("searchbox", { name: "Search" }).fill("counter stops");
    await page.locator(".entries li", { hasText: "this page stops Counter" }).waitFor();
    assert.equal(await page.locator(".entries li", { hasText: "Greeter" }).count(), 0);
    await page.context().close();
});

test("PeopleFindARobotByWhatItIsAndCanDo", limited, async () => {
    const page = await house.person({ name: "client1" });
    await page.locator("[data-entity=Counter]").waitFor();
    const names = () => page.locator("[data-entity]").evaluateAll((all) => all.map((one) => one.dataset.entity));
    await page.getByLabel("Service").locator("option", { hasText: "Greet" }).waitFor({ state: "attached" });
    await page.getByLabel("Service").selectOption("Greet");
    assert.deepEqual(await names(), ["Greeter"]);
    await page.getByRole("heading", { name: "1 of 2" }).waitFor();
    await page.getByLabel("Service").selectOption("any");
    await page.getByLabel("State").selectOption("mine");
    await page.getByText("None of the 2 robots fits.").waitFor();
    await page.getByRole("button", { name: "Show all" }).click();
    assert.deepEqual(await names(), ["Counter", "Greeter"]);
    for (const [label, count] of [
        ["Category", 1],
        ["Type", 1],
    ]) {
        const options = page.getByLabel(label).locator("option");
        assert.ok((await options.count()) > count, label);
        const value = await options.nth(1).getAttribute("value");
        await page.getByLabel(label).selectOption(value);
        assert.ok((await names()).length > 0);
        await page.getByLabel(label).selectOption("any");
    }
    await page.context().close();
});

test("TheServerIsStartedAgain", limited, async () => {
    const page = await house.person();
    await openEntity(page, "Greeter");
    await page.getByRole("button", { name: "Check out Greeter" }).click();
    await page.getByText("Greeter is yours", { exact: true }).first().waitFor();
    // A page may connect to the ports that its policy names, so the server has to be there again.
    const policy = (await page.request.get(house.url)).headers()["content-security-policy"] ?? "";
    [house.sessions, house.signals] = [...policy.matchAll(/ ws:\/\/([^ ;]+)/g)].map(([, host]) => host);
    assert.ok(house.signals !== undefined, policy);
    const begin = performance.now();
    await house.lab.server.end("SIGKILL");
    await page.locator(".banner.bad", { hasText: "No connection to the server" }).waitFor();
    assert.ok(performance.now() - begin < 1000, `it took ${performance.now() - begin} ms`);
    await page.locator(".dock .stop").click();
    await page.getByText(/this stop may reach nobody/).waitFor();
    await goTo(page, "#/");
    await page.locator("[data-entity=Greeter].stale", { hasText: /as it was (a moment|\d+ s) ago/ }).waitFor();
    assert.match(await page.locator("[data-entity=Greeter]").evaluate((one) => getComputedStyle(one).filter), /grayscale/);
    for (const where of PAGES) {
        await goTo(page, where);
        await page.locator(".banner.bad", { hasText: "No connection to the server" }).waitFor();
    }
    // What could not be asked for is asked for when the server is back.
    await openEntity(page, "Counter");
    await house.startServer();
    await page.locator("[data-connection=connected]").waitFor();
    await page.locator("[data-service=Count]").waitFor();
    await goTo(page, "#/");
    await page.locator("[data-entity=Greeter].mine:not(.stale)", { hasText: "Yours" }).waitFor({ timeout: 15_000 });
    await page.locator("[data-entity=Counter]:not(.stale)").waitFor({ timeout: 15_000 });
    await openEntity(page, "Greeter");
    await page.locator(".banner.inline").getByRole("button", { name: "Rearm Greeter" }).click();
    await page.locator(".banner.inline").waitFor({ state: "detached" });
    await page.getByLabel("Name").fill("again");
    await runButton(page, "Greet").click();
    await page.locator("[data-task=SUCCEEDED]").waitFor();
    await page.getByRole("button", { name: "Release it" }).click();
    await goTo(page, "#/activity");
    await page.getByText("the connection to the server is back", { exact: true }).waitFor();
    await page.context().close();
});

test("TheServerFallsSilent", limited, async () => {
    const page = await house.person({ script: watchBanner });
    await openEntity(page, "Counter");
    await page.locator("[data-service=Count]").waitFor();
    const checkOutCounter = page.getByRole("button", { name: "Check out Counter" });
    assert.equal(await checkOutCounter.getAttribute("aria-disabled"), null);
    const server = house.lab.server.child;
    await page.evaluate(() => scrollTo(0, document.body.scrollHeight));
    assert.ok(await page.evaluate(() => scrollY > 0));
    try {
        const begin = Date.now();
        server.kill("SIGSTOP");
        const banner = page.locator(".banner.wait", { hasText: "The server does not answer" });
        await banner.waitFor();
        const [{ at }] = await page.evaluate(() => globalThis.banners);
        // The unit tests of the client bound the notice itself. This is far below the 10 s after which the connection is given
        // up, and leaves time for drawing to a machine that is loaded.
        assert.ok(at - begin < 3000, `it took ${at - begin} ms`);
        await page.locator("[data-connection=silent]").waitFor();
        const box = await banner.boundingBox();
        assert.ok(box.y >= 0 && box.y + box.height < 400, JSON.stringify(box)); // wherever the person has scrolled to
        // Grey, with its age; and what only the server can do is not offered.
        await page.locator(".title.stale", { hasText: /as it was (a moment|\d+ s) ago/ }).waitFor();
        assert.equal(await checkOutCounter.getAttribute("aria-disabled"), "true");
        await checkOutCounter.focus();
        await page.keyboard.press("Enter");
        await page.getByText("Not possible while the server does not answer.").waitFor();
        assert.equal(await page.getByText("Checking out …").count(), 0);
        assert.deepEqual(await obstacles(page), []);
        // The stop can be pressed, and says what it is worth.
        await page.locator(".dock .stop").click();
        await page.getByText("The server does not answer, so this stop may reach nobody.").waitFor();
        // Another name would end the session, and with it what the red button can send.
        await page.getByRole("button", { name: /^Your name:/ }).click();
        await page.getByLabel("Your name, as others see it").fill("another");
        await page.getByLabel("Your name, as others see it").press("Enter");
        assert.equal(await page.getByRole("button", { name: /^Change/ }).getAttribute("aria-disabled"), "true");
        await page.locator("[data-connection=silent]").waitFor();
    } finally {
        server.kill("SIGCONT");
    }
    await page.locator("[data-connection=connected]").waitFor();
    await page.locator(".banner.wait").waitFor({ state: "detached" });
    await page.getByText("Confirmed by it.").waitFor(); // the stop has arrived after all
    await page.locator(".title:not(.stale)").waitFor();
    assert.equal(await checkOutCounter.getAttribute("aria-disabled"), null);
    await checkOut(page, "Counter");
    await page.locator(".banner.inline").getByRole("button", { name: "Rearm Counter" }).click();
    await page.getByText("Counter is rearmed.").waitFor();
    await page.getByRole("button", { name: "Release it" }).click();
    assert.deepEqual(await page.evaluate(() => globalThis.banners.map(({ shown }) => shown)), [true, false]);
    await goTo(page, "#/activity");
    await page.getByText("the server is heard again", { exact: true }).waitFor();
    await page.context().close();
});

test("ATabThatWasFrozenDoesNotBlameTheServer", limited, async () => {
    const page = await house.person({ script: watchBanner });
    await page.locator("[data-entity=Counter]").waitFor();
    const rounds = () => page.evaluate(() => globalThis.rounds);
    await page.evaluate(() => {
        let last = performance.now();
        globalThis.rounds = 0;
        globalThis.gap = 0;
        setInterval(() => {
            const now = performance.now();
            globalThis.gap = Math.max(globalThis.gap, now - last);
            last = now;
            ++globalThis.rounds;
        }, 100);
    });
    // Twice as long as a silence that is told, at least, with the page at work.
    const goesOn = async () => {
        const before = await rounds();
        await page.waitForFunction((least) => globalThis.rounds >= least, before + 15);
    };
    await goesOn();
    for (let i = 0; i < 3; ++i) {
        await page.evaluate(() => (globalThis.gap = 0));
        await house.freezeTabs(2500);
        await page.waitForFunction(() => globalThis.gap > 2000); // it did stand still
    }
    await goesOn();
    assert.deepEqual(await page.evaluate(() => globalThis.banners), []);
    await page.locator("[data-connection=connected]").waitFor();
    await page.context().close();
});

test("TextsAreNeverMarkup", limited, async () => {
    // Two applications of one name are one too many, so the first one goes.
    await Promise.all([greeter.app.end(), greeter.manager.end()]);
    const programs = house.startGreeter((text) =>
        text
            .replace(/(<BasicProfile[^>]*?) descr="[^"]*"/, `$1 descr="${asXml(HOSTILE)}"`)
            .replace('name="Greeter"', 'name="Evil&lt;b&gt;bold"')
            .replaceAll(/descr="(Says hello to|Whom)[^"]*"/g, `descr="${asXml(HOSTILE)}"`)
            .replace('units="s"', `units="&lt;img src=x onerror=alert(1)&gt;"`),
    );
    const page = await house.person({ name: HOSTILE.slice(0, 40), script: () => sessionStorage.setItem("axon-tickets", '{"user": 5}') });
    await page.locator("[data-entity='Evil<b>bold']").waitFor({ timeout: 15_000 });
    await page.locator("[data-entity='Evil<b>bold'] h3 a").click();
    await page.getByText("<img src=x").first().waitFor();
    await page.getByRole("button", { name: "Check out Evil<b>bold" }).click();
    await page.getByLabel("Name").fill(HOSTILE);
    await runButton(page, "Greet").click();
    await page.locator("[data-task=SUCCEEDED]").waitFor();
    assert.match(await page.locator("[data-task]").innerText(), /Hello, "><img src=x/);
    await page.locator("summary", { hasText: "Messages" }).click();
    assert.ok((await fillAll(page, HOSTILE)) >= 3);
    await page.getByRole("button", { name: "Send" }).click();
    await page.locator(".messages .sent", { hasText: "<img src=x" }).waitFor();
    for (const where of PAGES) {
        await goTo(page, where);
        await fillAll(page, HOSTILE);
    }
    await goTo(page, "#/collaboration");
    await page.getByRole("heading", { name: "Job <b>bold", exact: true }).waitFor();
    await page.getByRole("button", { name: /^Plan it Job/ }).click();
    await page.getByText("No robot that is connected offers:").waitFor();
    await page.getByRole("button", { name: /^Your name:/ }).click();
    await page.getByLabel("Your name, as others see it").fill(HOSTILE);
    await page.getByLabel("Your name, as others see it").press("Enter");
    await page.locator("[data-connection=connected]").waitFor();
    for (const hash of [`#/entity/${encodeURIComponent(HOSTILE)}`, "#/%E0%A4%A", `#/${HOSTILE}`]) {
        await goTo(page, hash);
        await page.locator(".dock .stop").waitFor();
    }
    assert.equal(await page.evaluate(() => globalThis.hacked), undefined);
    assert.equal(await page.locator("img[src=x], script:not([src])").count(), 0);
    await page.context().close();
    await Promise.all([programs.app.end(), programs.manager.end()]);
});

test("PagesFitAPhoneAndPeopleWhoSeeDifferently", limited, async () => {
    for (const [width, scheme] of [
        [360, "light"],
        [1280, "dark"],
    ]) {
        const page = await house.person({ width, height: 800, scheme });
        await openEntity(page, "Counter");
        const entity = new URL(page.url()).hash;
        await page.locator("[data-service=Count]").waitFor();
        for (const where of [...PAGES, entity]) {
            await goTo(page, where);
            await page.waitForTimeout(150);
            const over = await page.evaluate(() => document.documentElement.scrollWidth - document.documentElement.clientWidth);
            assert.ok(over <= 0, `${where} is ${over} px too wide for ${width} px`);
            assert.deepEqual(await obstacles(page), [], `${where}, ${width} px, ${scheme}`);
        }
        await page.context().close();
    }
});

test("AFileIsUploadedAndSeveralRobotsWorkTogether", limited, async () => {
    const five = join(ROOT, "examples/05_collaboration");
    const own = await House.open({ globalServices: join(five, "globalservices") });
    try {
        for (const [name, application] of [
            ["arm", "Arm"],
            ["planner", "Planner"],
            ["shuttle", "Shuttle"],
        ])
            own.lab.startEntity(`${name}-entity`, application, [five, own.lab.portsFile]);
        own.lab.startEntity("plotter-entity", "Plotter", [join(ROOT, "examples/03_parameters"), own.lab.portsFile]);
        const page = await own.person();
        await openEntity(page, "Plotter");
        await page.getByRole("button", { name: "Check out Plotter" }).click();
        await page.getByText("Still missing: Size, the file Drawing.").waitFor();
        const file = readFileSync(join(ROOT, "examples/03_parameters/house.txt"), "utf8");
        const dragged = await page.evaluateHandle((text) => {
            const all = new DataTransfer();
            all.items.add(new File([text], "house.txt"));
            return all;
        }, file);
        await page.locator("h1").dispatchEvent("drop", { dataTransfer: dragged }); // beside its place: the page stays
        await page.locator("[data-resource=Drawing]").dispatchEvent("drop", { dataTransfer: dragged });
        await page.getByText("house.txt: uploaded").waitFor();
        assert.equal(await page.locator(".hash code").innerText(), createHash("sha256").update(file).digest("hex"));
        await page.getByLabel("Size").fill("100");
        await page.getByLabel("Color").selectOption("blue");
        await page.getByLabel("Speed").fill("800");
        await page.getByRole("button", { name: "Set Speed" }).click();
        await runButton(page, "Draw").click();
        await page.locator("[data-task=SUCCEEDED] .results", { hasText: "Length" }).waitFor({ timeout: 20_000 });
        await goTo(page, "#/collaboration");
        await page.getByRole("button", { name: "Plan it Go home" }).click();
        await page.getByRole("button", { name: "Check out all 2" }).click();
        await page.getByRole("button", { name: "Check, nothing moves" }).click();
        await page.getByText("It can be run as it is. Nothing has moved.").waitFor();
        await page.getByRole("button", { name: "Run Go home" }).click();
        await page.locator("[data-run=SUCCEEDED] .timeline li.good").nth(1).waitFor({ timeout: 20_000 });
        assert.equal(await page.locator("[data-run=SUCCEEDED] .chart .lane .bar.good").count(), 2);
        assert.deepEqual(own.complaints, []);
    } finally {
        await own.end();
    }
});

test("UsersLogIn", limited, async () => {
    const own = await House.open({
        users: [
            ["olga", "observer", "correct horse"],
            ["anna", "operator", "battery staple"],
            ["robot", "entity", "of iron"],
        ],
    });
    try {
        own.startGreeter((text) => text, "Axon.User=robot\nAxon.Password=of iron\n");
        const page = await own.person();
        await page.getByLabel("User").fill("olga");
        assert.deepEqual(await obstacles(page), []);
        await page.getByLabel("Password").fill("wrong");
        await page.getByRole("button", { name: "Log in" }).click();
        await page.getByRole("alert").getByText(/wrong user or password/i).waitFor();
        await page.getByLabel("Password").fill("correct horse");
        await page.getByRole("button", { name: "Log in" }).click();
        await page.getByText("(observer)").waitFor();
        await openEntity(page, "Greeter");
        await page.getByText("You may look at it and stop it.").waitFor();
        await page.locator(".dock .stop").click();
        await page.getByText("Confirmed by it.").waitFor();
        await page.getByText("Whoever checks it out next, or an administrator, can rearm it.").first().waitFor();
        await page.getByRole("button", { name: "Log out" }).click();
        await page.getByText("You are logged out.").waitFor();
        await page.getByLabel("User").fill("anna");
        await page.getByLabel("Password").fill("battery staple");
        await page.getByLabel("Password").press("Enter");
        await page.getByText("(operator)").waitFor();
        assert.deepEqual(own.complaints, []);
    } finally {
        await own.end();
    }
});

test("AnotherUserLogsInWithTheSameBrowser", limited, async () => {
    const own = await House.open({
        users: [
            ["olga", "observer", "correct horse"],
            ["anna", "operator", "battery staple"],
            ["robot", "entity", "of iron"],
        ],
    });
    try {
        own.startGreeter((text) => text, "Axon.User=robot\nAxon.Password=of iron\n");
        const page = await own.person();
        const logIn = async (name, password) => {
            await page.getByLabel("User").fill(name);
            await page.getByLabel("Password").fill(password);
            await page.getByRole("button", { name: "Log in" }).click();
        };
        await page.evaluate(() => {
            const Plain = WebSocket;
            globalThis.sockets = [];
            globalThis.WebSocket = class extends Plain {
                constructor(...all) {
                    super(...all);
                    globalThis.sockets.push(this);
                }
            };
        });
        await logIn("anna", "battery staple");
        await page.getByText("(operator)").waitFor();
        // The signal lane has a WebSocket of its own.
        await page.waitForFunction(() => globalThis.sockets.some((one) => one.url.endsWith("/axon-signal") && one.readyState === WebSocket.OPEN));
        await openEntity(page, "Greeter");
        await page.getByRole("button", { name: "Check out Greeter" }).click();
        await page.getByText("Greeter is yours", { exact: true }).first().waitFor();
        // In another tab.
        await page.evaluate(() => fetch("login", { method: "POST", body: new URLSearchParams({ user: "olga", password: "correct horse" }) }).then(({ status }) => status));
        await page.evaluate(() => globalThis.sockets.forEach((one) => one.close()));
        await page.getByText("olga has logged in with this browser meanwhile, and this page was anna's.").waitFor();
        await logIn("olga", "correct horse");
        await page.getByText("(observer)").waitFor();
        await openEntity(page, "Greeter");
        await page.getByText("You may look at it and stop it.").waitFor();
        // The server forgets who is logged in; a person logs in, and it is another one.
        const portOf = (path) => page.evaluate((end) => new URL(globalThis.sockets.find(({ url }) => url.endsWith(end)).url).host, path);
        [own.sessions, own.signals] = [await portOf("/axon"), await portOf("/axon-signal")];
        await own.lab.server.end("SIGKILL");
        await own.startServer();
        await page.getByText("The server no longer knows who you are").waitFor();
        await logIn("anna", "battery staple");
        await page.getByText("(operator)").waitFor();
        // Chromium's word for a message to a socket that this test has closed while the page knew nothing of it.
        assert.deepEqual(own.complaints.filter((one) => one !== "WebSocket is already in CLOSING or CLOSED state."), []);
    } finally {
        await own.end();
    }
});

test("TheTransportIsRunFromTheConsole", { timeout: 400_000 }, async () => {
    const own = await House.open({ globalServices: join(ROOT, "lab/globalservices"), transport: true });
    try {
        const page = await own.person({ name: "client1", width: 1440, height: 900 });
        page.setDefaultTimeout(30_000);
        await openEntity(page, "PeopleBot");
        await checkOut(page, "PeopleBot");
        await page.getByRole("tab", { name: "Navigation", exact: true }).click();
        await page.locator("[data-resource=Map] input").setInputFiles(join(ROOT, "lab/worlds/transport.map"));
        await page.getByText("transport.map: uploaded").waitFor();
        // The page knows the walls from then on, and draws the robot where it is.
        await goTo(page, "#/");
        await page.locator("[data-entity=PeopleBot] .battery", { hasText: " V" }).waitFor();
        await page.getByRole("button", { name: "Map", exact: true }).click();
        await page.locator("[data-spot=PeopleBot][data-live=yes]").waitFor();
        await page.getByRole("button", { name: "Without transport.map" }).waitFor();
        await goTo(page, "#/collaboration");
        await page.getByRole("button", { name: "Plan it Transport", exact: true }).click();
        await page.getByLabel(/^Role 1/).selectOption({ label: "PeopleBot" });
        await page.getByLabel(/^Role 2/).selectOption({ label: "Cyton" });
        await page.getByRole("button", { name: "Check out the other 1" }).click();
        await page.getByRole("button", { name: "Check, nothing moves" }).click();
        await page.getByText("It can be run as it is. Nothing has moved.").waitFor();
        await page.getByRole("button", { name: "Run Transport", exact: true }).click();
        const run = page.locator("section[aria-label='Run of Transport']");
        await run.locator(".timeline li.good", { hasText: "Cyton" }).waitFor({ timeout: 60_000 });
        await run.locator(".timeline li.busy", { hasText: "PeopleBot" }).waitFor();
        if (process.env.AXON_LONG_TRIALS === "1") {
            await page.locator("[data-run=SUCCEEDED]").nth(1).waitFor({ timeout: 180_000 });
        } else {
            await run.getByRole("button", { name: "Stop all of them" }).click();
            await page.getByText("Confirmed by all 2.").waitFor();
            await page.locator("[data-run=STOPPED]").waitFor();
        }
        assert.deepEqual(own.complaints, []);
    } finally {
        await own.end();
    }
});

test("NothingComesFromElsewhereAndNothingIsBlocked", limited, async () => {
    const page = await house.person();
    await page.locator("main h1").waitFor();
    const policy = (await page.request.get(house.url)).headers()["content-security-policy"] ?? "";
    assert.match(policy, /script-src|default-src/);
    assert.doesNotMatch(policy, /unsafe-/);
    const before = house.complaints.length;
    const refused = await page.evaluate(() => {
        const script = document.createElement("script");
        script.textContent = "globalThis.hacked = 3";
        document.head.append(script);
        // Later, because the protocol of the test may do what the page may not.
        return new Promise((resolve) =>
            setTimeout(() => {
                try {
                    resolve(new Function("return 'it works'")());
                } catch (error) {
                    resolve(error.name);
                }
            }),
        );
    });
    assert.equal(refused, "EvalError");
    assert.equal(await page.evaluate(() => globalThis.hacked), undefined);
    await page.context().close();
    house.complaints.length = before; // the later ones are about the two of this test
    assert.deepEqual(house.foreign, []);
    assert.deepEqual(house.complaints, []);
});
