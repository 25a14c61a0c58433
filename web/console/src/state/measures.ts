// SPDX-License-Identifier: GPL-2.0-or-later
// What is measured while somebody looks at the page Activity: ways there and back, watchdogs. Stops are measured always.
import type { Receipt, WatchdogMargin } from "@axon/client";
import { signal } from "@preact/signals";
import { useEffect } from "preact/hooks";
import { asRefusal } from "./journal";
import { sorted } from "./entities";
import { client, reachable } from "./session";

const KEPT = 500;
const EVERY_MS = 2000;
/** So that hundreds of entities and many pages do not ask at once: so many entities each time, in turn. */
const AT_ONCE = 8;

export interface Latencies {
    /** There and back without a stop, as a stop travels. */
    readonly manager: readonly number[];
    readonly robot: readonly number[];
    /** Of stops that this page has asked for, from the press. */
    readonly told: readonly number[];
    readonly confirmed: readonly number[];
}
export const latencies = signal<Latencies>({ manager: [], robot: [], told: [], confirmed: [] });

function add(more: Partial<Latencies>): void {
    const all = latencies.peek();
    const join = (name: keyof Latencies): readonly number[] => [...all[name], ...(more[name] ?? [])].slice(-KEPT);
    latencies.value = { manager: join("manager"), robot: join("robot"), told: join("told"), confirmed: join("confirmed") };
}

/** `beforeMs`: from the press until the stop was called. */
export function measureStop(receipts: readonly Receipt[], beforeMs: number): void {
    const known = (times: readonly (number | undefined)[]): number[] => times.filter((one) => one !== undefined).map((one) => one + beforeMs);
    add({ told: known(receipts.map(({ serverMs }) => serverMs)), confirmed: known(receipts.map((one) => (one.confirmed ? (one.callbackReturnedMs ?? one.managerMs) : undefined))) });
}

export interface Margins {
    readonly at: number;
    readonly watchdogs: readonly WatchdogMargin[];
    /** Why it has not answered; empty = it has. */
    readonly trouble: string;
}
/** By UUID. */
export const margins = signal<ReadonlyMap<string, Margins>>(new Map());

let turn = 0;
async function measure(): Promise<void> {
    const its = client.peek();
    const all = sorted.peek().map(({ entity }) => entity.id);
    if (its === undefined || !reachable.peek() || all.length === 0) return;
    const some = all.length <= AT_ONCE ? all : Array.from({ length: AT_ONCE }, (_, i) => all[(turn + i) % all.length] ?? "");
    turn = (turn + AT_ONCE) % all.length;
    const asked = some.map(async (id): Promise<readonly [string, Margins]> => {
        try {
            return [id, { at: Date.now(), watchdogs: (await its.details(id)).watchdogs, trouble: "" }];
        } catch (error) {
            return [id, { at: Date.now(), watchdogs: margins.peek().get(id)?.watchdogs ?? [], trouble: asRefusal(error).message }];
        }
    });
    const drilled = its.drill(some).catch(() => []);
    const found = new Map(margins.peek());
    for (const [id, one] of await Promise.all(asked)) found.set(id, one);
    for (const id of found.keys()) if (!all.includes(id)) found.delete(id);
    margins.value = found;
    const reports = await drilled;
    const known = (times: readonly (number | undefined)[]): number[] => times.filter((one) => one !== undefined);
    add({ manager: reports.flatMap(({ managerMs }) => known(managerMs)), robot: reports.flatMap(({ callbackMs, noApplication }) => (noApplication ? [] : known(callbackMs))) });
}

/** Measures for as long as a part is shown. */
export function useMeasures(): void {
    useEffect(() => {
        let busy = false;
        const step = (): void => {
            if (busy || document.visibilityState !== "visible") return;
            busy = true;
            void measure().finally(() => (busy = false));
        };
        step();
        const timer = setInterval(step, EVERY_MS);
        return () => clearInterval(timer);
    }, []);
}
