// SPDX-License-Identifier: GPL-2.0-or-later
import { Refusal } from "../refusal.js";
import { alternatives, folded, inQuotes, nearNames } from "../wire/values.js";

const SHORTEST_PREFIX = 4;
const SHOWN = 8;

/** Where it is among these, which are in order, or would be. */
function placeOf(ids: readonly string[], id: string): number {
    let [from, to] = [0, ids.length];
    while (from < to) {
        const middle = (from + to) >> 1;
        if ((ids[middle] as string) < id) from = middle + 1;
        else to = middle;
    }
    return from;
}

/**
 * What people call the entities that are there: a name, "Name#2" (the second of that name, in order of UUID), a UUID, or a
 * beginning of it. Those that are not ready are meant only if no ready one is.
 */
export class NameIndex {
    private readonly names = new Map<string, { readonly name: string; readonly ready: boolean }>();
    private readonly ready = new Map<string, string[]>(); // name -> UUIDs, in order
    private readonly unready = new Map<string, string[]>();

    put(id: string, name: string, ready: boolean): void {
        const before = this.names.get(id);
        if (before !== undefined && before.name === name && before.ready === ready) return;
        this.remove(id);
        this.names.set(id, { name, ready });
        const names = ready ? this.ready : this.unready;
        const same = names.get(name);
        if (same === undefined) names.set(name, [id]);
        else same.splice(placeOf(same, id), 0, id);
    }
    remove(id: string): void {
        const one = this.names.get(id);
        if (one === undefined) return;
        this.names.delete(id);
        const names = one.ready ? this.ready : this.unready;
        const same = names.get(one.name) ?? [];
        if (same.length <= 1) names.delete(one.name);
        else same.splice(placeOf(same, id), 1);
    }
    clear(): void {
        this.names.clear();
        this.ready.clear();
        this.unready.clear();
    }
    ids(): string[] {
        return [...this.names.keys()].sort();
    }
    private called(name: string, ready: boolean): readonly string[] {
        return (ready ? this.ready : this.unready).get(name) ?? [];
    }

    /** The shortest name that means only this entity. */
    label(id: string): string {
        const one = this.names.get(id);
        if (one === undefined) return id;
        const same = this.called(one.name, one.ready);
        if (!one.ready) return same.length > 1 || this.called(one.name, true).length > 0 ? id.slice(0, SHOWN) : one.name;
        return same.length === 1 ? one.name : `${one.name}#${placeOf(same, id) + 1}`;
    }

    /** The one entity that is meant. Throws UNKNOWN_ENTITY with near names, AMBIGUOUS_ENTITY with the candidates. */
    resolve(text: string): string {
        const candidates = this.meant(text, true);
        if (candidates.length === 1) return candidates[0] as string;
        const list = candidates.slice(0, SHOWN).map((id) => `${this.label(id)} (${id})`).join(", ");
        const more = candidates.length > SHOWN ? ` and ${candidates.length - SHOWN} more` : "";
        throw new Refusal("AMBIGUOUS_ENTITY", `${inQuotes(text)} means ${candidates.length} entities: ${list}${more}. Name one of them by its #number or by the beginning of its UUID.`);
    }
    /** Every entity that may be meant: for a stop. */
    resolveAll(text: string): string[] {
        return this.meant(text, false);
    }

    private meant(text: string, readyFirst: boolean): string[] {
        if (text === "") throw new Refusal("UNKNOWN_ENTITY", "An empty name means no entity. Give a name or a UUID.");
        const low = folded(text);
        if (this.names.has(low)) return [low];
        if (this.names.has(text)) return [text];

        const ready = this.called(text, true);
        if (ready.length > 0 && readyFirst) return [...ready];
        const same = [...ready, ...this.called(text, false)];
        if (same.length > 0) return same;

        const place = /^(.*)#(\d{1,9})$/s.exec(text);
        if (place !== null) {
            const numbered = this.called(place[1] as string, true);
            const number = Number(place[2]);
            if (numbered.length > 0) {
                const one = numbered[number - 1];
                if (one !== undefined) return [one];
                throw new Refusal("UNKNOWN_ENTITY", `There are only ${numbered.length} entities named ${inQuotes(place[1] as string)}, counted from #1.`);
            }
        }
        if (text.length >= SHORTEST_PREFIX) {
            const begun = [...this.names.keys()].filter((id) => id.startsWith(low)).sort();
            if (begun.length > 0) return begun;
        }
        const alike = [...this.names].filter(([, one]) => folded(one.name) === low);
        const alikeReady = alike.filter(([, one]) => one.ready);
        const chosen = readyFirst && alikeReady.length > 0 ? alikeReady : alike;
        if (chosen.length > 0) return chosen.map(([id]) => id).sort();

        const near = nearNames(text, [...this.names.values()].map(({ name }) => name));
        const fix =
            near.length > 0
                ? `Did you mean ${alternatives(near)}?`
                : this.names.size === 0
                  ? "No entity is connected to the server: start an Entity Manager and its robot application."
                  : "List the entities to see what is there.";
        throw new Refusal("UNKNOWN_ENTITY", `No entity is called ${inQuotes(text)}. ${fix}`);
    }
}
