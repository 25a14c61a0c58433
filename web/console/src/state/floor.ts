// SPDX-License-Identifier: GPL-2.0-or-later
// The floor plan under the map: a map of Mapper3 that this browser has uploaded to a robot or opened. It stays in this browser.
import { signal } from "@preact/signals";

const KEY = "axon-floor";
const LINES_MAX = 20_000;
const GOALS_MAX = 500;
const FILE_MAX = 8_000_000;
const KEPT_MAX = 400_000;

export interface Floor {
    readonly name: string;
    /** Metres: x1, y1, x2, y2. */
    readonly lines: readonly (readonly [number, number, number, number])[];
    readonly goals: readonly { readonly name: string; readonly x: number; readonly y: number }[];
}

const metres = (text: string | undefined): number => Number(text) / 1000;

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
            if (x1 !== undefined && y1 !== undefined && x2 !== undefined && y2 !== undefined && [x1, y1, x2, y2].every(Number.isFinite)) lines.push([x1, y1, x2, y2]);
        } else if (row.startsWith("Cairn: Goal") && goals.length < GOALS_MAX) {
            const found = /^Cairn: Goal\w* (\S+) (\S+) \S+ "[^"]*" ICON "([^"]*)"/.exec(row);
            const goal = { name: (found?.[3] ?? "").slice(0, 60), x: metres(found?.[1]), y: metres(found?.[2]) };
            if (goal.name !== "" && Number.isFinite(goal.x) && Number.isFinite(goal.y)) goals.push(goal);
        }
    }
    return lines.length === 0 ? undefined : { name: name.slice(0, 100), lines, goals };
}

function kept(): Floor | undefined {
    try {
        const found: unknown = JSON.parse(localStorage.getItem(KEY) ?? "null");
        const floor = found as Floor | null;
        const fits = floor !== null && typeof floor.name === "string" && Array.isArray(floor.lines) && floor.lines.every((line) => Array.isArray(line) && line.length === 4 && line.every(Number.isFinite)) && Array.isArray(floor.goals);
        return fits ? floor : undefined;
    } catch {
        return undefined;
    }
}
export const floor = signal<Floor | undefined>(kept());

/** False if the file is no map. */
export async function openFloor(file: File): Promise<boolean> {
    if (file.size > FILE_MAX) return false;
    const found = parseFloor(await file.text(), file.name);
    if (found === undefined) return false;
    floor.value = found;
    const text = JSON.stringify(found);
    if (text.length < KEPT_MAX) {
        try {
            localStorage.setItem(KEY, text);
        } catch {
            // the browser keeps no more; the map is there until the page is loaded again
        }
    }
    return true;
}
export function closeFloor(): void {
    floor.value = undefined;
    localStorage.removeItem(KEY);
}
