// SPDX-License-Identifier: GPL-2.0-or-later
// The entities of the laboratory as this page has seen them.
import type { Client, Entity, EntityNews } from "@axon/client";
import { computed, signal } from "@preact/signals";
import { plainState } from "../words/words";
import { note } from "./journal";

/** News are shown together if they come within this time. */
const TOGETHER_MS = 25;
/** After a lost connection, an entity that has not come back for this long is no longer shown. */
const FORGET_MS = 15_000;

export interface Seen {
    readonly entity: Entity;
    /** False: the server is silent or the connection to it was lost, and `entity` is how it was when the server was last heard. */
    readonly fresh: boolean;
    readonly seenAt: number;
    readonly heldSince: number;
    /** This page has seen the check-out; otherwise it is older than `heldSince`. */
    readonly heldFromBegin: boolean;
}

const known = new Map<string, Seen>();
/** When the server was last heard, if it is silent. */
let silentSince: number | undefined;
let publishing = false;
/** By UUID, ready ones only. */
export const entities = signal<ReadonlyMap<string, Seen>>(new Map());
/** Their robot applications have not uploaded valid profiles yet. */
export const unready = signal<readonly Entity[]>([]);
export const label = signal<(id: string) => string>((id) => id);

function publish(): void {
    if (publishing) return;
    publishing = true;
    setTimeout(() => {
        publishing = false;
        const since = silentSince;
        entities.value = new Map(since === undefined ? known : [...known].map(([id, one]) => [id, one.fresh ? { ...one, fresh: false, seenAt: since } : one]));
    }, TOGETHER_MS);
}

const byName = new Intl.Collator(undefined, { numeric: true, sensitivity: "base" });
export const sorted = computed(() => [...entities.value.values()].sort((a, b) => byName.compare(a.entity.name, b.entity.name) || (a.entity.id < b.entity.id ? -1 : 1)));
export const latched = computed(() => sorted.value.filter(({ entity }) => entity.latched));

function changes(before: Entity, after: Entity): void {
    const told = plainState(after);
    if (before.state !== after.state) note(after.state === "ERR" || after.state === "UNAV" ? "fault" : "state", after, `${before.state} → ${after.state}, ${told.short}${after.reason === "" ? "" : `: ${after.reason}`}`);
    if (before.latched !== after.latched) note("stop", after, after.latched ? "was stopped, and does nothing until somebody rearms it" : "was rearmed");
    if (before.holder?.id !== after.holder?.id) note("who", after, after.holder === undefined ? `is free; ${before.holder?.name ?? "somebody"} had it` : `was checked out by ${after.holder.name}`);
    if (before.orphaned !== after.orphaned && after.orphaned) note("who", after, `${after.holder?.name ?? "its holder"} is lost and may come back`);
}

/** A laboratory is smaller: what a profile says beyond it, or what is no number, is no place. */
const PLACE_MAX_MM = 1e9;
const placed = (mm: number): number => (Math.abs(mm) <= PLACE_MAX_MM ? mm : 0);

function onNews({ presence, entity: told, connectionLost }: EntityNews, heardAt: number): void {
    const entity: Entity = { ...told, xMm: placed(told.xMm), yMm: placed(told.yMm), zMm: placed(told.zMm) };
    const before = known.get(entity.id);
    const at = Date.now();
    if (presence === "left") {
        if (before === undefined) return;
        if (connectionLost) known.set(entity.id, { ...before, fresh: false, seenAt: heardAt });
        else {
            known.delete(entity.id);
            note("fault", entity, "left the laboratory");
        }
        return publish();
    }
    if (before === undefined) note("state", entity, `joined: ${entity.state}, ${plainState(entity).short}`);
    else changes(before.entity, entity);
    const sameHolder = before !== undefined && before.entity.holder?.id === entity.holder?.id;
    known.set(entity.id, {
        entity,
        fresh: true,
        seenAt: at,
        heldSince: sameHolder ? before.heldSince : at,
        heldFromBegin: sameHolder ? before.heldFromBegin : before !== undefined,
    });
    publish();
}

/** Follows a client; returns what ends that. */
export function follow(client: Client): () => void {
    known.clear();
    publish();
    label.value = (id) => {
        try {
            return client.label(id);
        } catch {
            return known.get(id)?.entity.name ?? id;
        }
    };
    const heardAt = (): number => client.connection().heardAt;
    silentSince = undefined;
    const ends = [
        client.onEntity((news) => onNews(news, heardAt())),
        client.onConnection(({ silent }) => {
            if (silent === (silentSince !== undefined)) return;
            silentSince = silent ? heardAt() : undefined;
            publish();
        }),
    ];
    const look = setInterval(() => {
        const others = client.entities("all").filter(({ ready }) => !ready);
        const same = others.length === unready.value.length && others.every((one, at) => JSON.stringify(one) === JSON.stringify(unready.value[at]));
        if (!same) unready.value = others;
        const gone = [...known].filter(([, one]) => !one.fresh && client.connected && client.connection().ageMs > FORGET_MS);
        for (const [id, { entity }] of gone) {
            known.delete(id);
            note("fault", entity, "has not come back since the connection was lost");
        }
        if (gone.length > 0) publish();
    }, 1000);
    return () => {
        for (const end of ends) end();
        clearInterval(look);
    };
}
