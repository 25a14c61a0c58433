// SPDX-License-Identifier: GPL-2.0-or-later
// Parts of the pages that need no browser.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { test } from "node:test";
import { build } from "esbuild";

const sources = new URL("../../src/", import.meta.url).pathname;
let loads = 0;
/** Each time a module of its own, with a state of its own. */
async function load(file) {
    const { outputFiles } = await build({ entryPoints: [join(sources, file)], bundle: true, write: false, format: "esm", platform: "node", jsx: "automatic", jsxImportSource: "preact", loader: { ".css": "empty" }, external: ["ice", "ws"] });
    return import(`data:text/javascript;base64,${Buffer.from(`${outputFiles[0].text}\n// ${++loads}`).toString("base64")}`);
}
const { parseFloor } = await load("state/floor.ts");
const { boxAround, viewOf, linesBetween } = await load("parts/view.ts");
const { paintTrail } = await load("parts/paint.ts");
const { agoOf, isOld, keepOnly, liveOf, Subscriptions, take } = await load("state/live_store.ts");
const { isDue } = await load("state/due.ts");
const { quantile } = await load("parts/histogram.tsx");
const { formatMs, formatSpan, plainNumber } = await load("words/format.ts");
const { heldMeanwhile } = await load("words/words.ts");

test("AMapOfMapper3HasWallsAndGoals", () => {
    const floor = parseFloor(readFileSync(join(process.env.AXON_ROOT, "lab/worlds/transport.map"), "utf8"), "transport.map");
    assert.equal(floor.lines.length, 36);
    assert.deepEqual(floor.lines[0], [0, 0, 0, 6]);
    assert.deepEqual(
        floor.goals.map(({ name }) => name),
        ["West table", "West table 2", "East table", "East table 2", "Middle"],
    );
    assert.deepEqual([floor.goals[4].x, floor.goals[4].y], [4, 3]);
});
test("WhatIsNoMapIsRefused", () => {
    for (const text of ["", "a house", "2D-Map\n", "2D-Map\nLINES\nDATA\n", "2D-Map\nLINES\n1 2 3\n", "2D-Map\nLINES\n1 2 3 x\n"]) assert.equal(parseFloor(text, "x"), undefined, text);
    const some = parseFloor("2D-Map\nCairn: Goal 1 x 0 \"\" ICON \"no place\"\nLINES\n0 0 1000 2000\nnonsense\nDATA\n5 5 5 5\n", "x".repeat(300));
    assert.deepEqual(some.lines, [[0, 0, 1, 2]]);
    assert.deepEqual(some.goals, []);
    assert.equal(some.name.length, 100);
});
test("AQuantileIsAValueThatWasMeasured", () => {
    assert.equal(quantile([], 0.5), 0);
    assert.equal(quantile([7], 0.95), 7);
    assert.equal(quantile([1, 2, 3, 4], 0.5), 2);
    assert.equal(quantile(Array.from({ length: 100 }, (_, i) => i + 1), 0.95), 95);
});
test("TimesAreAsCoarseAsPeopleSayThem", () => {
    assert.equal(formatMs(4.26), "4.3 ms");
    assert.equal(formatMs(87.6), "88 ms");
    assert.equal(formatSpan(400), "a moment");
    assert.equal(formatSpan(3_700_000), "1 h 1 min");
    assert.equal(plainNumber(" 1 234 "), "1234");
});

test("NoTaskIsSaidToOutliveTheServer", () => {
    assert.equal(heldMeanwhile([], true), "");
    assert.equal(heldMeanwhile(["A", "B"], true), "What you hold (A, B) is stopped if this lasts. Only if the server still runs does a task go on that may do so without you. ");
    assert.equal(heldMeanwhile(["A"], false), "What you hold (A) is stopped. Only if the server still runs does a task go on that may do so without you. ");
});

const MAP = "2D-Map\nCairn: Goal 1000 0 0 \"\" ICON \"Table\"\nLINES\n0 0 1000 2000\nDATA\n";
/** The storage of a browser, which takes so many characters. */
function storage(most = Infinity) {
    const all = new Map();
    globalThis.localStorage = {
        getItem: (key) => all.get(key) ?? null,
        setItem: (key, text) => {
            if (text.length > most) throw new Error("QuotaExceededError");
            all.set(key, text);
        },
        removeItem: (key) => all.delete(key),
    };
    return all;
}
const fileOf = (text, name = "a.map") => ({ name, size: text.length, text: async () => text });

test("WallsThatAreNowhereAreLeftOut", () => {
    const floor = parseFloor("2D-Map\nCairn: Goal 1e300 0 0 \"\" ICON \"Far\"\nLINES\n0 0 1e13 0\n0 0 1000 1000\n", "x");
    assert.deepEqual([floor.lines, floor.goals], [[[0, 0, 1, 1]], []]);
});
test("AMapIsKeptAndAnOldOneDoesNotComeBack", async () => {
    const kept = storage(1000);
    const first = await load("state/floor.ts");
    assert.equal(await first.openFloor(fileOf(MAP, "small.map")), undefined);
    assert.deepEqual((await load("state/floor.ts")).floor.value, { name: "small.map", lines: [[0, 0, 1, 2]], goals: [{ name: "Table", x: 1, y: 0 }] });
    // One that the browser has no room for is shown, and after a reload there is none.
    assert.equal(await first.openFloor(fileOf(MAP.replace("DATA", `${"0 0 1000 2000\n".repeat(200)}DATA`), "large.map")), undefined);
    assert.equal(first.floor.value.name, "large.map");
    assert.equal(kept.size, 0);
    assert.equal((await load("state/floor.ts")).floor.value, undefined);
    delete globalThis.localStorage;
    first.closeFloor();
    assert.equal(first.floor.value, undefined);
});
test("AFileThatIsNotShownSaysWhy", async () => {
    storage();
    const { openFloor, floor } = await load("state/floor.ts");
    assert.match(await openFloor({ ...fileOf(MAP), text: () => Promise.reject(new Error("NotReadableError.")) }), /^It cannot be read: NotReadableError\. .*choose it again/);
    assert.match(await openFloor(fileOf("a house")), /no map of Mapper3/);
    assert.match(await openFloor({ ...fileOf(MAP), size: 9e6 }), /more than 8 MB/);
    assert.equal(floor.value, undefined);
});
test("WhatIsNoFloorInTheStorageIsNotShown", async () => {
    const good = { name: "x", lines: [[0, 0, 1, 1]], goals: [{ name: "Table", x: 1, y: 0 }] };
    for (const [fits, found] of [
        [true, good],
        [false, null],
        [false, 5],
        [false, { ...good, lines: [[0, 0, 1]] }],
        [false, { ...good, lines: [[0, 0, 1, 1e9]] }],
        [false, { ...good, goals: [null] }],
        [false, { ...good, goals: [{ name: 5, x: 1, y: 0 }] }],
        [false, { ...good, goals: [{ name: "Table", x: null, y: 0 }] }],
    ]) {
        storage().set("axon-floor", JSON.stringify(found));
        assert.equal((await load("state/floor.ts")).floor.value !== undefined, fits, JSON.stringify(found));
    }
});
test("AGridHasFewLinesHoweverFarTheRobotsAre", () => {
    for (const places of [[], [{ x: 0, y: 0 }], [{ x: 1e6, y: 1e6 }], [{ x: -1e6, y: 0 }, { x: 1e6, y: 3 }]]) {
        const view = viewOf(places, places.length === 0 ? [[0, 0, 5, 5]] : undefined, 800, 400);
        const left = -view.x(0) / view.scale;
        const lines = linesBetween(left, left + 800 / view.scale, view.step);
        assert.ok(lines.length >= 4 && lines.length <= 100, `${lines.length} lines`);
        for (const line of lines) assert.ok(view.x(line) >= -1 && view.x(line) <= 801, String(view.x(line)));
    }
    assert.deepEqual(linesBetween(-1.1, 2.2, 1), [-1, 0, 1, 2]);
    assert.equal(linesBetween(0, 1e12, 1).length, 400);
    // Where a step is too small to be added to a place.
    assert.ok(linesBetween(1e17, 1e17 + 1000, 1).length <= 400);
    assert.deepEqual(linesBetween(Number.NaN, Number.NaN, 1), []);
    assert.deepEqual(linesBetween(5, 4, 1), []);
});
test("WhatARobotSeesIsInsideTheMapAndTheMapStandsStill", () => {
    const robot = { x: 1.5, y: 2 };
    const seen = [{ x: 5.7, y: 2 }, { x: 1.5, y: -1.2 }];
    const box = boxAround(undefined, robot, seen);
    for (const view of [viewOf([robot, box.low, box.high], undefined, 800, 400), viewOf([robot, box.low, box.high], undefined, 300, 500)]) {
        for (const { x, y } of seen) assert.ok(view.x(x) >= 0 && view.x(x) <= view.wide && view.y(y) >= 0 && view.y(y) <= view.high, `${view.x(x)} ${view.y(y)}`);
    }
    // Distances that tremble, a person who walks by and is gone, a robot that drives: it is the same, or larger.
    assert.deepEqual(boxAround(box, robot, [{ x: 5.72, y: 2 }, { x: 1.5, y: -1.15 }]), box);
    assert.deepEqual(boxAround(box, { x: 2, y: 1 }, []), box);
    assert.deepEqual(boxAround(box, { x: -4.5, y: 2 }, []), { low: { x: -5, y: -2 }, high: box.high });
    // One that was told a wrong place, and then the right one: the wrong one is not kept in the picture.
    const wrong = boxAround(box, { x: 300, y: 2 }, []);
    assert.deepEqual(wrong, { low: { x: 300, y: 2 }, high: { x: 300, y: 2 } });
    assert.deepEqual(boxAround(wrong, robot, seen), box);
    // What is too far away to be worth it is cut off.
    assert.deepEqual(boxAround(undefined, { x: 0, y: 0 }, [{ x: 1e30, y: 0 }, { x: 0, y: -80 }]), { low: { x: 0, y: -10 }, high: { x: 10, y: 0 } });
});
test("ATrailCostsTheSameHoweverFarARobotSaysThatItWent", () => {
    for (const far of [1, 1e6, 1e9]) {
        let calls = 0;
        const pen = new Proxy({}, { get: () => () => ++calls, set: () => true });
        paintTrail({ x: far, y: -far, yaw: 0 }, [{ x: 0, y: 0 }], pen, 300, 200, () => "");
        assert.ok(calls < 300, `${calls} calls for ${far} m`);
    }
});
test("WhatIsOldIsSaidToBe", () => {
    const sample = (stream, content, arrivedAtMs) => take("a", { entity: "a", stream, sequence: 1, takenAtUs: 0, arrivedAtMs, content });
    sample("battery", { kind: "scalar", value: 12.34, units: "V" }, 1000);
    sample("pose", { kind: "pose", x: 1, y: 2, yaw: 0 }, 5000);
    const live = liveOf("a");
    assert.deepEqual([live.battery, agoOf(live.batteryAt, 3000), agoOf(live.batteryAt, 63_500), agoOf(live.poseAt, 6000)], ["12.3 V", "", "1 min ago", ""]);
    assert.deepEqual([isOld(live.poseAt, 7000), isOld(live.poseAt, 7001)], [false, true]);
    assert.deepEqual([live.hasOld(3000), live.hasOld(3001)], [false, true]);
    keepOnly(new Map([["a", 1]]));
    assert.equal(liveOf("a"), live);
    keepOnly(new Map());
    assert.equal(liveOf("a"), undefined);
});
/** Time that stands still until it is told to go on; `end` gives the real one back. */
function heldTime(now) {
    const plain = { setTimeout, setInterval, clearTimeout, clearInterval, now: Date.now };
    const waiting = new Map();
    let last = 0;
    const start = (every) => (call, ms) => (waiting.set(++last, { call, at: now + ms, every: every ? ms : 0 }), last);
    globalThis.setTimeout = start(false);
    globalThis.setInterval = start(true);
    globalThis.clearTimeout = globalThis.clearInterval = (id) => waiting.delete(id);
    Date.now = () => now;
    return {
        advance(ms) {
            for (const end = now + ms; ; ) {
                const [id, next] = [...waiting].sort(([, a], [, b]) => a.at - b.at)[0] ?? [];
                if (next === undefined || next.at > end) {
                    now = end;
                    return;
                }
                now = next.at;
                if (next.every > 0) next.at += next.every;
                else waiting.delete(id);
                next.call();
            }
        },
        end() {
            const { now: real, ...timers } = plain;
            Object.assign(globalThis, timers);
            Date.now = real;
        },
    };
}
/** A client whose news a test tells. */
class ToldClient {
    connected = true;
    heardAt = 1_000_000;
    ageMs = 60_000;
    there = [];
    tell = { entity: () => {}, connection: () => {} };
    onEntity(call) {
        this.tell.entity = call;
        return () => {};
    }
    onConnection(call) {
        this.tell.connection = call;
        return () => {};
    }
    connection() {
        return { kind: this.connected ? "connected" : "lost", heardAt: this.heardAt, ageMs: this.ageMs };
    }
    entities() {
        return this.there;
    }
    label(id) {
        return id;
    }
}
test("WhileTheServerIsSilentWhatIsShownIsOfWhenItWasLastHeard", async () => {
    const { entities, follow } = await load("state/entities.ts");
    const time = heldTime(1_000_000);
    try {
        const client = new ToldClient();
        const end = follow(client);
        const told = (name, state = "IDLE") => client.tell.entity({ presence: "joined", entity: { id: name, name, state, latched: false, reason: "", xMm: 0, yMm: 0, zMm: 0 }, connectionLost: false });
        const shown = (name) => [entities.value.get(name)?.fresh, entities.value.get(name)?.seenAt];
        told("a");
        time.advance(50);
        assert.deepEqual(shown("a"), [true, 1_000_000]);
        time.advance(5000);
        client.heardAt = 1_004_350;
        client.tell.connection({ silent: true });
        time.advance(50);
        assert.deepEqual(shown("a"), [false, 1_004_350]);
        // However long: it is not forgotten as one that has not come back.
        time.advance(20_000);
        assert.deepEqual(shown("a"), [false, 1_004_350]);
        client.tell.connection({ silent: false });
        time.advance(50);
        assert.deepEqual(shown("a"), [true, 1_000_000]);
        // The computer sleeps for a night before the silence is told.
        client.heardAt = 1_025_000;
        time.advance(9 * 3_600_000);
        client.tell.connection({ silent: true });
        time.advance(50);
        assert.deepEqual(shown("a"), [false, 1_025_000]);
        client.tell.connection({ silent: false });
        // A connection that is lost after a silence: of when the server was last heard, too.
        client.heardAt = 1_024_150;
        client.connected = false;
        client.tell.entity({ presence: "left", entity: { id: "a", name: "a", xMm: 0, yMm: 0, zMm: 0 }, connectionLost: true });
        time.advance(50);
        assert.deepEqual(shown("a"), [false, 1_024_150]);
        end();
    } finally {
        time.end();
    }
});
test("AListThatChangesBeginsAndEndsOnlyTheDifference", () => {
    const heard = [];
    let closed = true;
    const all = new Subscriptions((id) => {
        if (id === "c" && closed) return undefined;
        heard.push(`+${id}`);
        return () => heard.push(`-${id}`);
    });
    all.set(["a", "b", "c"]);
    all.set(["b", "a", "c"]);
    assert.deepEqual(heard.splice(0), ["+a", "+b"]);
    closed = false;
    all.set(["b", "c", "d"]);
    assert.deepEqual(heard.splice(0), ["-a", "+c", "+d"]);
    all.set([]);
    assert.deepEqual(heard.splice(0).sort(), ["-b", "-c", "-d"]);
});
test("AnEntityIsAskedAgainForItsServices", () => {
    assert.equal(isDue(false, undefined, 0), true);
    assert.deepEqual([isDue(false, 1000, 10_999), isDue(false, 1000, 11_000)], [false, true]);
    assert.deepEqual([isDue(true, 1000, 120_999), isDue(true, 1000, 121_000)], [false, true]);
});
