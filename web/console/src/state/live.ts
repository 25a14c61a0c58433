// SPDX-License-Identifier: GPL-2.0-or-later
// What many entities send at once, as the page Laboratory shows it: batteries on the cards, positions and distances on the map.
import { effect } from "@preact/signals";
import { useEffect, useRef, useState } from "preact/hooks";
import { entities } from "./entities";
import { keepOnly, liveOf, Subscriptions, take } from "./live_store";
import { client } from "./session";

/** Streams of these names are asked for; what they are is said by their content. */
export const BATTERY = ["battery"] as const;
export const MAPPED = ["pose", "laser", "sonar", "scan"] as const;
/** The list may change with every letter of a search. */
const SETTLED_MS = 300;

effect(() => keepOnly(entities.value));

/** Listens to streams of these entities for as long as a part is shown, and draws it again so often if something has come or grown old. */
export function useLive(ids: readonly string[], streams: readonly string[], everyMs: number): void {
    const [, redraw] = useState(0);
    const its = client.value;
    const key = ids.join(" ");
    const latest = useRef(ids);
    latest.current = ids;
    const open = useRef<Subscriptions | undefined>(undefined);
    useEffect(() => {
        if (its === undefined) return undefined;
        let changed = false;
        const all = new Subscriptions((id) => {
            try {
                return its.watch(id, streams, (sample) => {
                    take(id, sample);
                    changed = true;
                });
            } catch {
                return undefined; // it has just left
            }
        });
        open.current = all;
        all.set(latest.current);
        const timer = setInterval(() => {
            const at = performance.now();
            if (changed || latest.current.some((id) => liveOf(id)?.hasOld(at) === true)) redraw((count) => count + 1);
            changed = false;
        }, everyMs);
        return () => {
            clearInterval(timer);
            open.current = undefined;
            all.set([]);
        };
    }, [its]);
    useEffect(() => {
        const settled = setTimeout(() => open.current?.set(latest.current), SETTLED_MS);
        return () => clearTimeout(settled);
    }, [key]);
}
