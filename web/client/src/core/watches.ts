// SPDX-License-Identifier: GPL-2.0-or-later
import { Refusal } from "../refusal.js";
import { NO_LEASE } from "../transport.js";
import { Context, type Parts } from "./context.js";

/** Streams that a client watches by name, for each entity (docs/reference/sessions.md, "Limits"). */
const STREAMS_MAX = 64;

/** Which streams are watched, and by how many in this program. The name "" stands for all streams. */
export class Watches {
    private readonly watches = new Map<string, Map<string, number>>();

    constructor(private readonly parts: Parts) {}

    watch(entity: string, streams: readonly string[]): void {
        if (!this.parts.context.connected) throw Context.notConnected();
        this.parts.entities.there(entity);
        const counts = this.watches.get(entity) ?? new Map<string, number>();
        const names = streams.length === 0 ? [""] : streams;
        if (new Set([...counts.keys(), ...names]).size > STREAMS_MAX) {
            throw new Refusal("OVERLOADED", `At most ${STREAMS_MAX} streams of an entity are watched by name; watch all of them instead.`);
        }
        for (const name of names) counts.set(name, (counts.get(name) ?? 0) + 1);
        this.watches.set(entity, counts);
        this.send(entity);
    }
    unwatch(entity: string, streams: readonly string[]): void {
        const counts = this.watches.get(entity);
        if (counts === undefined) return;
        const off: string[] = [];
        for (const name of streams.length === 0 ? [""] : streams) {
            const count = counts.get(name);
            if (count === undefined) continue;
            if (count > 1) counts.set(name, count - 1);
            else if (counts.delete(name)) off.push(name);
        }
        if (counts.size === 0) this.watches.delete(entity);
        if (off.length === 0 || !this.parts.context.connected || !this.parts.entities.isThere(entity)) return;
        this.parts.context.send(entity, "WATCH", NO_LEASE, { watch: { on: false, streams: off.filter((name) => name !== "") } });
        // Switching "all" off takes the single ones with it.
        if (off.includes("")) this.send(entity);
    }
    watching(entity: string): boolean {
        return this.watches.has(entity);
    }
    /** Again, to an entity that has come. */
    send(entity: string): void {
        const counts = this.watches.get(entity);
        if (counts === undefined) return;
        this.parts.context.send(entity, "WATCH", NO_LEASE, { watch: { on: true, streams: counts.has("") ? [] : [...counts.keys()] } });
    }
    sendAll(): void {
        for (const entity of this.watches.keys()) if (this.parts.entities.isThere(entity)) this.send(entity);
    }
}
