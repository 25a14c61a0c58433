// SPDX-License-Identifier: GPL-2.0-or-later
// Parts of the pages that need no browser.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { test } from "node:test";
import { build } from "esbuild";

const sources = new URL("../../src/", import.meta.url).pathname;
async function load(file) {
    const { outputFiles } = await build({ entryPoints: [join(sources, file)], bundle: true, write: false, format: "esm", platform: "node", jsx: "automatic", jsxImportSource: "preact", loader: { ".css": "empty" }, external: ["ice", "ws"] });
    return import(`data:text/javascript;base64,${Buffer.from(outputFiles[0].contents).toString("base64")}`);
}
const { parseFloor } = await load("state/floor.ts");
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
