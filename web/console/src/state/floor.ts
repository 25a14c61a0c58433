// SPDX-License-Identifier: GPL-2.0-or-later
// The floor plan under the map: a map of Mapper3 that this browser has uploaded to a robot or opened. It stays in this browser.
import { signal } from "@preact/signals";

const KEY = "axon-floor";
const LINES_MAX = 20_000;
const GOALS_MAX = 500;
const FILE_MAX = 8_000_000;
const KEPT_MAX = 400_000;
/** A laboratory is smaller. */
const METRES_MAX = 1e6;

export interface Floor {
    readonly name: string;
    /** Metres: x1, y1, x2, y2. */
    readonly lines: readonly (readonly [number, number, number, number])[];
    readonly goals: readonly { readonly name: string; readonly x: number; readonly y: number }[];
}

const metres = (text: string | undefined): number => Number(text) / 1000;
const isPlace = (value: unknown): value is number => typeof value === "number" && Math.abs(value) <= METRES_MAX;

/** Undefined if the text is no map of Mapper3, or has no line. */
export function parseFloor(text: string, name: string): Floor | undefined {
    if (!/^2D-Map\s/.test(text)) return undefined;
    const lines: [number, number, number, number][] = [];
    const goals: { name: string; x: number; y: number }[] = [];
    let inLines = false;
    for (const row of text.split(/\r?\n/)) {
        if (row === "LINES") inLines = true;
        else if (row === "DATA") break;
        else if (inLines && lines.length < LINES_MAX) {
            const [x1, y1, x2, y2] = row.trim().split(/\s+/).map(metres);
            if (x1 !== undefined && y1 !== undefined && x2 !== undefined && y2 !== undefined && [x1, y1, x2, y2].every(isPlace)) lines.push([x1, y1, x2, y2]);
        } else if (row.startsWith("Cairn: Goal") && goals.length < GOALS_MAX) {
            const found = /^Cairn: Goal\w* (\S+) (\S+) \S+ "[^"]*" ICON "([^"]*)"/.exec(row);
            const goal = { name: (found?.[3] ?? "").slice(0, 60), x: metres(found?.[1]), y: metres(found?.[2]) };
            if (goal.name !== "" && isPlace(goal.x) && isPlace(goal.y)) goals.push(goal);
        }
    }
    return lines.length === 0 ? undefined : { name: name.slice(0, 100), lines, goals };
}

const isLine = (line: unknown): boolean => Array.isArray(line) && line.length === 4 && line.every(isPlace);
const isGoal = (goal: Partial<Floor["goals"][number]> | null): boolean => typeof goal === "object" && goal !== null && typeof goal.name === "string" && isPlace(goal.x) && isPlace(goal.y);

/** Undefined unless it is what openFloor() keeps: other pages of this address, and older ones, may have written there. */
function kept(): Floor | undefined {
    try {
        const found = JSON.parse(localStorage.getItem(KEY) ?? "null") as Partial<Floor> | null;
        const fits = found !== null && typeof found.name === "string" && Array.isArray(found.lines) && found.lines.every(isLine) && Array.isArray(found.goals) && found.goals.every(isGoal);
        return fits ? (found as Floor) : undefined;
    } catch {
        return undefined;
    }
}
export const floor = signal<Floor | undefined>(kept());

/** Never the floor before, which would come back when the page is loaded again. */
function keep(text: string): void {
    try {
        localStorage.removeItem(KEY);
        if (text !== "" && text.length < KEPT_MAX) localStorage.setItem(KEY, text);
    } catch {
        // the browser keeps no more; the map is there until the page is loaded again
    }
}
/** Why the file is not shown, for the person. */
export async function openFloor(file: File): Promise<string | undefined> {
    if (file.size > FILE_MAX) return `It has more than ${FILE_MAX / 1e6} MB. Choose a smaller map.`;
    let text: string;
    try {
        text = await file.text();
    } catch (error) {
        return `It cannot be read: ${error instanceof Error ? error.message : String(error)} It may have been moved or deleted since it was chosen; choose it again.`;
    }
    const found = parseFloor(text, file.name);
    if (found === undefined) return "It is no map of Mapper3 with lines. Choose a file that begins with the line 2D-Map.";
    floor.value = found;
    keep(JSON.stringify(found));
    return undefined;
}
export function closeFloor(): void {
    floor.value = undefined;
    keep("");
}
