// SPDX-License-Identifier: GPL-2.0-or-later
// The stop button: what it stops now, and the receipts.
import type { Receipt } from "@axon/client";
import { computed, signal } from "@preact/signals";
import { entities } from "./entities";
import { holds, onUnseen } from "./holds";
import { asRefusal, note } from "./journal";
import { measureStop } from "./measures";
import { route } from "./route";
import { client, reachable } from "./session";

/** A stop is sent again until it is confirmed, for this long. */
const CONFIRM_MS = 3000;
const STANDSTILL_MS = 15_000;

export type Scope = "these" | "held" | "all";
export interface Order {
    readonly number: number;
    readonly at: number;
    readonly what: string;
    readonly receipts: readonly Receipt[];
    readonly done: boolean;
    readonly trouble: string;
}
/** The newest order; dismissed = undefined. */
export const order = signal<Order | undefined>(undefined);
/** By UUID, the newest receipt of an order of this page. */
export const lastReceipts = signal<ReadonlyMap<string, { readonly at: number; readonly receipt: Receipt }>>(new Map());

/** Ticked on the page Laboratory. */
export const ticked = signal<ReadonlySet<string>>(new Set());
/** What the person has chosen instead of the usual. */
export const chosen = signal<Scope | undefined>(undefined);

/** Of "these": UUIDs. */
export const these = computed<readonly string[]>(() => {
    const { page, subject } = route.value;
    if (page === "entity" && entities.value.has(subject)) return [subject];
    if (page === "laboratory") return [...ticked.value].filter((id) => entities.value.has(id));
    return [];
});
/** The person's choice, if that still means anything; otherwise the page's entity, what is ticked, what is held, everything. */
export const scope = computed<Scope>(() => {
    const held = holds.value.size > 0;
    const wanted = chosen.value;
    if (wanted === "all" || (wanted === "these" && these.value.length > 0) || (wanted === "held" && held)) return wanted;
    if (route.value.page === "stop") return "all";
    return these.value.length > 0 ? "these" : held ? "held" : "all";
});

const nameOf = (id: string): string => entities.peek().get(id)?.entity.name ?? "it";
export function describe(which: Scope, short = false): string {
    if (which === "all") return "everything";
    const ids = which === "these" ? these.value : [...holds.value.keys()];
    const only = ids[0];
    if (ids.length === 1 && only !== undefined) return entities.value.get(only)?.entity.name ?? nameOf(only);
    return which === "held" ? (short ? `My ${ids.length}` : `the ${ids.length} that I hold`) : `the ${ids.length} selected`;
}

/** Of a receipt that says nothing new, when the person turns to something else. */
export function putAway(): void {
    if (order.value?.done === true && order.value.trouble === "" && order.value.receipts.every(({ confirmed }) => confirmed)) order.value = undefined;
}

let count = 0;
/** Stops at once; no question, no lease. */
export async function stop(ids: readonly string[] | "all", what: string, pressedAt = performance.now()): Promise<void> {
    const number = ++count;
    const update = (more: Partial<Order>): void => {
        if (order.value?.number === number) order.value = { ...order.value, ...more };
    };
    const heard = (receipts: readonly Receipt[]): void => {
        update({ receipts });
        const all = new Map(lastReceipts.value);
        for (const receipt of receipts) all.set(receipt.entity, { at: Date.now(), receipt });
        lastReceipts.value = all;
    };
    order.value = { number, at: Date.now(), what, receipts: [], done: false, trouble: "" };
    note("stop", undefined, `this page stops ${what}`);
    const its = client.value;
    const cut = reachable.peek() ? "" : `${its?.connected === true ? "The server does not answer" : "There is no connection to the server"}, so this stop may reach nobody. Use the emergency stop of the robot itself.`;
    update({ trouble: cut });
    if (its === undefined) return update({ done: true });
    try {
        const before = performance.now() - pressedAt;
        const receipts = await its.stop(ids === "all" ? "all" : [...ids], { deadlineMs: CONFIRM_MS, standstillMs: STANDSTILL_MS, onProgress: heard });
        heard(receipts);
        measureStop(receipts, before);
        for (const one of receipts) note("stop", { id: one.entity, name: one.name }, summary(one).text);
        update({ done: true, trouble: receipts.length === 0 && ids !== "all" ? "No entity has answered." : (order.value?.trouble ?? "") });
        if (receipts.length > 0 && receipts.every(({ confirmed }) => confirmed)) update({ trouble: "" });
    } catch (error) {
        const why = asRefusal(error);
        note("refusal", undefined, `the stop of ${what} was not carried out: ${why.message}`, why);
        update({ done: true, trouble: cut !== "" ? cut : `${why.message} If a robot moves, use its own emergency stop.` });
    }
}
/** `at`: when the finger or the key went down, on the clock of performance.now(). */
export function press(which: Scope = scope.peek(), at = performance.now()): void {
    void stop(which === "all" ? "all" : which === "these" ? these.peek() : [...holds.peek().keys()], describe(which), at);
}
onUnseen((ids) => void stop(ids, ids.map(nameOf).join(", ")));

export function summary(receipt: Receipt): { readonly tone: "good" | "wait" | "bad"; readonly text: string } {
    if (receipt.applicationLost !== "") return { tone: "bad", text: `nobody could tell the robot: ${receipt.applicationLost}. Go and look at it` };
    if (receipt.fault !== "") return { tone: "bad", text: `its stop routine failed and is tried again: ${receipt.fault}` };
    if (receipt.noApplication) return { tone: "good", text: "no robot application is running, so there was nothing to stop" };
    if (receipt.standstillMs !== undefined) return { tone: "good", text: "stands still" };
    if (receipt.confirmed) return receipt.standstillFollows ? { tone: "wait", text: "was told to stop, and is coming to rest" } : { tone: "good", text: "was told to stop" };
    if (receipt.managerMs !== undefined) return { tone: "wait", text: "its Entity Manager has the stop" };
    return { tone: "wait", text: "not heard of yet" };
}

// Escape twice is the button.
const TWICE_MS = 700;
let escapedAt = -Infinity;
addEventListener(
    "keydown",
    (event) => {
        if (event.key !== "Escape" || event.repeat) return;
        const at = performance.now();
        if (at - escapedAt < TWICE_MS && client.peek() !== undefined) {
            escapedAt = -Infinity;
            press(scope.peek(), event.timeStamp);
        } else {
            escapedAt = at;
        }
    },
    true,
);
