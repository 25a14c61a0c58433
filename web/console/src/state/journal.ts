// SPDX-License-Identifier: GPL-2.0-or-later
// What this page has seen since it was loaded, newest first, and what it has to tell a person now.
import { Refusal } from "@axon/client";
import { signal } from "@preact/signals";
import { remedyOf, sentence } from "../words/words";

const KEPT = 2000;
const SHOWN = 3;
const SHOWN_MS = { good: 5000, wait: 12_000 } as const;

export const kinds = ["state", "who", "task", "stop", "fault", "refusal", "message", "connection"] as const;
export type Kind = (typeof kinds)[number];

export interface Entry {
    readonly number: number;
    readonly at: number;
    readonly kind: Kind;
    /** UUID; empty = of no entity. */
    readonly entity: string;
    readonly name: string;
    readonly text: string;
    readonly code: string;
    readonly remedy: string;
}
export const journal = signal<readonly Entry[]>([]);

let count = 0;
let waiting: Entry[] = [];

export function note(kind: Kind, about: { readonly id: string; readonly name: string } | undefined, text: string, refusal?: Refusal): Entry {
    const entry: Entry = {
        number: ++count,
        at: Date.now(),
        kind,
        entity: about?.id ?? "",
        name: about?.name ?? "",
        text,
        code: refusal?.code ?? "",
        remedy: refusal === undefined ? "" : remedyOf(refusal),
    };
    // A laboratory that joins is hundreds of entries at once.
    if (waiting.length === 0) {
        setTimeout(() => {
            journal.value = [...waiting.reverse(), ...journal.value].slice(0, KEPT);
            waiting = [];
        }, 20);
    }
    waiting.push(entry);
    return entry;
}

export interface Notice {
    readonly number: number;
    readonly tone: "good" | "bad" | "wait";
    readonly text: string;
    readonly more: string;
    /** UUID of the entity that it is about; empty = none. */
    readonly entity: string;
}
export const notices = signal<readonly Notice[]>([]);

export function dismiss(number: number): void {
    notices.value = notices.value.filter((one) => one.number !== number);
}
/** Says something to the person, until it is dismissed or, if it is no bad news, for a while. */
export function say(tone: Notice["tone"], text: string, more = "", entity = ""): void {
    const notice: Notice = { number: ++count, tone, text, more, entity };
    notices.value = [...notices.value.filter((one) => one.text !== text), notice].slice(-SHOWN);
    if (tone !== "bad") setTimeout(() => dismiss(notice.number), SHOWN_MS[tone]);
}

export const asRefusal = (error: unknown): Refusal => (error instanceof Refusal ? error : new Refusal("INTERNAL", error instanceof Error ? error.message : String(error)));

/** What a person asked for was refused. */
export function refused(what: string, error: unknown, about?: { readonly id: string; readonly name: string }): Refusal {
    const refusal = asRefusal(error);
    if (refusal.code === "CANCELLED") return refusal;
    note("refusal", about, `${what}: ${sentence(refusal.message)}`, refusal);
    say("bad", what, [sentence(refusal.message), remedyOf(refusal)].filter((one) => one !== "").join(" "), about?.id ?? "");
    return refusal;
}
