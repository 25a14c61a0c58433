// SPDX-License-Identifier: GPL-2.0-or-later
import type { Details } from "../types.js";
import type { GlobalServices, RunRecord } from "../global_types.js";
import type { Id } from "../ids.js";
import type { Refusal } from "../refusal.js";
import { type LeaseNumber, NO_LEASE } from "../transport.js";
import type { Done } from "./context.js";

export type Action = "pause" | "resume" | "cancel";

/** What a client asks for and waits for, one kind for each. */
export type What =
    /** The lease is over here already: whatever comes back, it is done. Only silence is told. */
    | { readonly kind: "release"; readonly done: Done }
    /** What the entity answers with a Reply and nothing else: a parameter's new value, a rearming. */
    | { readonly kind: "confirmed"; readonly done: Done }
    /** A task or a run is to pause, to go on or to end. */
    | { readonly kind: "control"; readonly done: Done; readonly action: Action }
    | { readonly kind: "details"; readonly done: Done; readonly answer: (details: Details) => void }
    /** A resource on its way; its credits are no answer, but make it wait longer. */
    | { readonly kind: "upload"; readonly done: Done }
    | { readonly kind: "globalServices"; readonly done: Done; readonly answer: (services: GlobalServices) => void }
    | { readonly kind: "runRecords"; readonly done: Done; readonly answer: (records: readonly RunRecord[]) => void }
    /** The first event of a task or run; of one whose lease was released, the last. */
    | { readonly kind: "startTask" }
    | { readonly kind: "startRun" }
    /** An orphaned lease: until its Entity Manager has said whether it still is one, or its time is up. */
    | { readonly kind: "resumeLease" }
    /** What became of the tasks or runs of a lease that was resumed. */
    | { readonly kind: "askAfterTasks"; readonly tasks: readonly Id[] }
    | { readonly kind: "askAfterRuns"; readonly runs: Set<Id>; readonly until: number };
export type Kind = What["kind"];

// What most requests do when their ground is gone, and which are different.
/** Otherwise OUTCOME_UNKNOWN when the connection is lost. */
export const outlivesConnection = (kind: Kind): boolean => kind === "resumeLease";
/** Otherwise refused when the lease ends under which it was asked. */
export const outlivesLease = (kind: Kind): boolean => kind === "release" || kind === "startTask" || kind === "startRun";
/** Otherwise refused when the entity leaves. */
export const outlivesEntity = (kind: Kind): boolean => kind === "startTask" || kind === "startRun" || kind === "resumeLease";

/** In the order in which they are answered when an entity leaves or the connection is lost. */
const ORDER: readonly Kind[] = ["release", "confirmed", "control", "details", "upload", "startTask", "resumeLease", "askAfterTasks", "startRun", "askAfterRuns", "globalServices", "runRecords"];

export interface Pending<One extends What = What> {
    readonly id: Id;
    readonly entity: string;
    /** Under which it was asked. */
    readonly lease: LeaseNumber;
    /** Of its message; 0 = it is not told apart by that. */
    sequence: number;
    deadline: number;
    readonly what: One;
}
type Of<K extends Kind> = Pending<Extract<What, { kind: K }>>;

/**
 * The requests that wait for an answer: who asked whom for what, and until when. Each is answered exactly once, and is out of
 * here before whoever asked is told.
 */
export class Requests {
    private readonly pending = new Map<string, Pending>();
    private readonly byEntity = new Map<string, Set<Pending>>();

    constructor(
        private readonly now: () => number,
        private readonly timeoutMs: number,
        /** A request under a lease was refused, which may mean that the lease is gone. */
        private readonly refused: (entity: string, under: LeaseNumber, why: Refusal) => void,
    ) {}

    private static key(kind: Kind, id: Id): string {
        return `${kind} ${id}`;
    }
    await(id: Id, what: What, of: { entity?: string; lease?: LeaseNumber; sequence?: number; deadline?: number }): void {
        this.take(what.kind, id); // one of a kind
        const one: Pending = {
            id,
            entity: of.entity ?? "",
            lease: of.lease ?? NO_LEASE,
            sequence: of.sequence ?? 0,
            deadline: of.deadline ?? this.now() + this.timeoutMs,
            what,
        };
        this.pending.set(Requests.key(what.kind, id), one);
        const same = this.byEntity.get(one.entity);
        if (same === undefined) this.byEntity.set(one.entity, new Set([one]));
        else same.add(one);
    }
    find<K extends Kind>(kind: K, id: Id): Of<K> | undefined {
        return this.pending.get(Requests.key(kind, id)) as Of<K> | undefined;
    }
    /** To be answered by whoever takes it. */
    take<K extends Kind>(kind: K, id: Id): Of<K> | undefined {
        const one = this.find(kind, id);
        if (one === undefined) return undefined;
        this.pending.delete(Requests.key(kind, id));
        const same = this.byEntity.get(one.entity);
        same?.delete(one as Pending);
        if (same?.size === 0) this.byEntity.delete(one.entity);
        return one;
    }
    /** Whether it waited. */
    settle(kind: Kind, id: Id, refusal?: Refusal): boolean {
        const one = this.take(kind, id);
        if (one === undefined) return false;
        if (one.what.kind === "release") {
            one.what.done();
            return true;
        }
        if ("done" in one.what) one.what.done(refusal);
        if (refusal !== undefined) this.refused(one.entity, one.lease, refusal);
        return true;
    }
    private static inOrder(some: Iterable<Pending>): Pending[] {
        return [...some].sort((a, b) => ORDER.indexOf(a.what.kind) - ORDER.indexOf(b.what.kind));
    }
    all(): Pending[] {
        return Requests.inOrder(this.pending.values());
    }
    of(entity: string): Pending[] {
        return Requests.inOrder(this.byEntity.get(entity) ?? []);
    }
    bySequence(sequence: number, entity: string): Pending | undefined {
        for (const one of this.byEntity.get(entity) ?? []) if (sequence !== 0 && one.sequence === sequence) return one;
        return undefined;
    }
    due(now: number): Pending | undefined {
        for (const one of this.pending.values()) if (one.deadline <= now) return one;
        return undefined;
    }
    nextDeadline(): number {
        let next = Infinity;
        for (const one of this.pending.values()) next = Math.min(next, one.deadline);
        return next;
    }
    get size(): number {
        return this.pending.size;
    }
}
