// SPDX-License-Identifier: GPL-2.0-or-later
// What many entities send at once, as the page Laboratory shows it: batteries on the cards, positions and distances on the map.
import type { Pose, Sample, Scan } from "@axon/client";
import { useEffect, useState } from "preact/hooks";
import { formatNumber } from "../words/format";
import { client } from "./session";

/** Streams of these names are asked for; what they are is said by their content. */
export const BATTERY = ["battery"] as const;
export const MAPPED = ["pose", "laser", "sonar", "scan"] as const;

const TRAIL_MAX = 1500;
const TRAIL_STEP_M = 0.03;

/** It changes in place, and is looked at when it is drawn. */
export class Live {
    pose: Pose | undefined;
    poseAt = 0;
    battery = "";
    readonly trail: { readonly x: number; readonly y: number }[] = [];
    readonly scans = new Map<string, { readonly scan: Scan; readonly at: number }>();

    take({ stream, content }: Sample): void {
        const at = performance.now();
        switch (content.kind) {
            case "scalar":
                if (stream === "battery") this.battery = `${formatNumber(Math.round(content.value * 10) / 10)}${content.units === "" ? "" : ` ${content.units}`}`;
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
}

const lives = new Map<string, Live>();
export const liveOf = (id: string): Live | undefined => lives.get(id);

/** Listens to streams of these entities for as long as a part is shown, and draws it again so often if something has come. */
export function useLive(ids: readonly string[], streams: readonly string[], everyMs: number): void {
    const [, redraw] = useState(0);
    const its = client.value;
    const key = ids.join(" ");
    useEffect(() => {
        if (its === undefined) return undefined;
        let changed = false;
        const ends = key
            .split(" ")
            .filter((id) => id !== "")
            .map((id) => {
                try {
                    return its.watch(id, streams, (sample) => {
                        let live = lives.get(id);
                        if (live === undefined) lives.set(id, (live = new Live()));
                        live.take(sample);
                        changed = true;
                    });
                } catch {
                    return undefined; // it has just left
                }
            });
        const timer = setInterval(() => {
            if (changed) redraw((count) => count + 1);
            changed = false;
        }, everyMs);
        return () => {
            clearInterval(timer);
            for (const end of ends) end?.();
        };
    }, [its, key]);
}
