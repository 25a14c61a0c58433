// SPDX-License-Identifier: GPL-2.0-or-later
// Which part of the world the map shows, and how large.

export interface View {
    readonly scale: number;
    readonly x: (metres: number) => number;
    readonly y: (metres: number) => number;
    readonly wide: number;
    readonly high: number;
    readonly step: number;
}
export interface Point {
    readonly x: number;
    readonly y: number;
}
/** From the lower left to the upper right corner. */
export interface Box {
    readonly low: Point;
    readonly high: Point;
}
type Line = readonly [number, number, number, number];

/** More lines than this are none that somebody could tell from each other. */
const LINES_MAX = 400;

/** 1, 2 or 5 times a power of ten, so that some lines are seen. */
function stepOf(span: number): number {
    const rough = span / 8;
    const power = 10 ** Math.floor(Math.log10(rough));
    return ([1, 2, 5].find((factor) => factor * power >= rough) ?? 10) * power;
}
const BOX_STEP_M = 1;
/** What is further from its robot is not worth a smaller picture, and is cut off at the edge. */
const SEEN_MAX_M = 10;
/**
 * `before`, and what is seen from `from` as well. It grows by whole steps and does not shrink, so that the picture stands still
 * while the distances tremble. It begins anew at a place that no robot drives to between two looks, as when one that was told a
 * wrong place is told the right one.
 */
export function boxAround(before: Box | undefined, from: Point, seen: readonly Point[]): Box {
    const near = before !== undefined && from.x > before.low.x - SEEN_MAX_M && from.x < before.high.x + SEEN_MAX_M && from.y > before.low.y - SEEN_MAX_M && from.y < before.high.y + SEEN_MAX_M;
    let { low, high } = near ? before : { low: from, high: from };
    for (const { x, y } of [from, ...seen]) {
        const end = { x: Math.min(Math.max(x, from.x - SEEN_MAX_M), from.x + SEEN_MAX_M), y: Math.min(Math.max(y, from.y - SEEN_MAX_M), from.y + SEEN_MAX_M) };
        if (end.x < low.x || end.y < low.y) low = { x: Math.min(low.x, Math.floor(end.x / BOX_STEP_M) * BOX_STEP_M), y: Math.min(low.y, Math.floor(end.y / BOX_STEP_M) * BOX_STEP_M) };
        if (end.x > high.x || end.y > high.y) high = { x: Math.max(high.x, Math.ceil(end.x / BOX_STEP_M) * BOX_STEP_M), y: Math.max(high.y, Math.ceil(end.y / BOX_STEP_M) * BOX_STEP_M) };
    }
    return { low, high };
}
/** What is around all of them; they are finite. */
export function viewOf(places: readonly Point[], walls: readonly Line[] | undefined, wide: number, high: number): View {
    const xs = [...places.map(({ x }) => x), ...(walls?.flatMap(([x1, , x2]) => [x1, x2]) ?? [])];
    const ys = [...places.map(({ y }) => y), ...(walls?.flatMap(([, y1, , y2]) => [y1, y2]) ?? [])];
    const least = (all: readonly number[]): number => all.reduce((a, b) => Math.min(a, b), Infinity);
    const most = (all: readonly number[]): number => all.reduce((a, b) => Math.max(a, b), -Infinity);
    const around = walls === undefined ? 1.2 : 0.4;
    const low = { x: least(xs) - around, y: least(ys) - around };
    const span = { x: Math.max(most(xs) + around - low.x, 2), y: Math.max(most(ys) + around - low.y, 2) };
    const scale = Math.min(wide / span.x, high / span.y);
    const left = (wide - span.x * scale) / 2;
    const foot = (high + span.y * scale) / 2;
    return { scale, wide, high, x: (metres) => left + (metres - low.x) * scale, y: (metres) => foot - (metres - low.y) * scale, step: stepOf(Math.min(wide, high) / scale) };
}
/** The multiples of `step` between two places, at most LINES_MAX of them. */
export function linesBetween(from: number, to: number, step: number): readonly number[] {
    const first = Math.ceil(from / step);
    const count = Math.floor(to / step) - first + 1;
    return count > 0 ? Array.from({ length: Math.min(count, LINES_MAX) }, (_, i) => (first + i) * step) : [];
}
