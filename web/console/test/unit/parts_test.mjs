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
const { viewOf, linesBetween } = await load("parts/view.ts");
const { agoOf, isOld, keepOnly, liveOf, Subscriptions, take } = await load("state/live_store.ts");
const { isDue } = await load("state/due.ts");
const { quantile } = await load("parts/histogram.tsx");
const { formatMs, formatSpan, plainNumber } = await load("words/format.ts");

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
