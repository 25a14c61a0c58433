// SPDX-License-Identifier: GPL-2.0-or-later
import { type RefusalCode, refusals } from "../gen/refusals.js";

export type { RefusalCode };

const byName = new Map(refusals.map((one) => [one.name, one]));
const byNumber = new Map(refusals.map((one) => [one.number, one]));

/** Every code with its number, meaning and remedy (docs/reference/refusals.md). */
export function refusalCodes(): { code: RefusalCode; number: number; meaning: string; remedy: string }[] {
    return refusals.flatMap(({ name, number, meaning, remedy }) => (name === "OK" ? [] : [{ code: name, number, meaning, remedy }]));
}

/**
 * Why something was not done. Everything in this library that can be refused rejects its promise with a Refusal.
 *
 * `message` is a sentence for people: what was expected, and how to fix it. It may come from another machine: show it as text,
 * never as HTML.
 */
export class Refusal extends Error {
    override readonly name = "Refusal";
    readonly number: number;

    constructor(
        /** A code that this version does not know is INTERNAL; `number` is then the one that came. */
        readonly code: RefusalCode,
        message: string,
        /** The name of the present holder, where that is the reason. */
        readonly holder = "",
        number?: number,
    ) {
        super(message);
        this.number = number ?? byName.get(code)?.number ?? 72;
    }

    /** What the code means, a phrase. */
    get meaning(): string {
        return byName.get(this.code)?.meaning ?? "";
    }
    /** What a person can do, a phrase in which verbs are those of the command `axon`; empty if only the message says it. */
    get remedy(): string {
        return (byName.get(this.code)?.remedy ?? "").replaceAll("{entity}", "ENTITY").replaceAll("{holder}", this.holder || "the holder");
    }
    /** The same with a longer or another message. */
    saying(message: string): Refusal {
        return new Refusal(this.code, message, this.holder, this.number);
    }
}

/** Of the number on the wire; undefined for 0, which is no refusal. */
export function refusalOf(number: number, message: string, holder = ""): Refusal | undefined {
    if (number === 0) return undefined;
    const known = byNumber.get(number)?.name;
    return new Refusal(known === undefined || known === "OK" ? "INTERNAL" : known, message, holder, number);
}
