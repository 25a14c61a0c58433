// SPDX-License-Identifier: GPL-2.0-or-later
// What many entities have sent, with its time: how old it is must be seen wherever it is shown.
import type { Pose, Sample, Scan } from "@axon/client";
import { formatNumber, formatSpan } from "../words/format";

const TRAIL_MAX = 1500;
const TRAIL_STEP_M = 0.03;
/** What is older is shown as old, with its age, and a scan is not shown any more. */
const OLD_MS = 2000;

export const isOld = (since: number, at: number): boolean => at - since > OLD_MS;
/** In words; empty = it is not old. */
export const agoOf = (since: number, at: number): string => (isOld(since, at) ? `${formatSpan(at - since)} ago` : "");

/** It changes in place, and is looked at when it is drawn. Times are those of performance.now(). */
export class Live {
    pose: Pose | undefined;
    poseAt = 0;
    /** With its units; empty = it has sent none. */
    battery = "";
    batteryAt = 0;
    readonly trail: { readonly x: number; readonly y: number }[] = [];
    readonly scans = new Map<string, { readonly scan: Scan; readonly at: number }>();

    take({ stream, content, arrivedAtMs: at }: Sample): void {
        switch (content.kind) {
            case "scalar":
                if (stream !== "battery") return;
                this.battery = `${formatNumber(Math.round(content.value * 10) / 10)}${content.units === "" ? "" : ` ${content.units}`}`;
                this.batteryAt = at;
                return;
            case "scan":
                this.scans.set(stream, { scan: content, at });
                return;
            case "pose": {
                this.pose = content;
                this.poseAt = at;
                const last = this.trail.at(-1);
                if (last === undefined || Math.hypot(last.x - content.x, last.y - content.y) > TRAIL_STEP_M) this.trail.push({ x: content.x, y: content.y });
                if (this.trail.length > TRAIL_MAX) this.trail.splice(0, TRAIL_MAX / 4);
                return;
            }
            default:
        }
    }
    /** Something of it is shown with its age, which changes by itself. */
    hasOld(at: number): boolean {
        return (this.pose !== undefined && isOld(this.poseAt, at)) || (this.battery !== "" && isOld(this.batteryAt, at));
    }
}

const lives = new Map<string, Live>();
export const liveOf = (id: string): Live | undefined => lives.get(id);
export function take(id: string, sample: Sample): void {
    let live = lives.get(id);
    if (live === undefined) lives.set(id, (live = new Live()));
    live.take(sample);
}
/** Forgets those that are not there any more. */
export function keepOnly(there: { has(id: string): boolean }): void {
    for (const id of lives.keys()) if (!there.has(id)) lives.delete(id);
}

/** Of a list that changes: begins what is new in it, ends what is no longer there, and leaves the others as they are. */
export class Subscriptions {
    private readonly ends = new Map<string, () => void>();

    /** `begin` returns what ends it; undefined = it cannot be begun now, and is tried again at the next change. */
    constructor(private readonly begin: (id: string) => (() => void) | undefined) {}

    set(ids: readonly string[]): void {
        const wanted = new Set(ids);
        for (const [id, end] of this.ends) {
            if (wanted.has(id)) continue;
            this.ends.delete(id);
            end();
        }
        for (const id of wanted) {
            const end = this.ends.has(id) ? undefined : this.begin(id);
            if (end !== undefined) this.ends.set(id, end);
        }
    }
}
