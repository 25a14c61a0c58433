// SPDX-License-Identifier: GPL-2.0-or-later
import type * as proto from "../../gen/messages.js";
import type { Clock } from "../clock.js";
import type { RunReport } from "../global_types.js";
import type { Id, Random } from "../ids.js";
import { Refusal } from "../refusal.js";
import { type Connection, type Header, type LeaseNumber, NO_LEASE } from "../transport.js";
import type { EntityNews, HandOverRequest, Sample, Sender, Service, TaskReport } from "../types.js";
import { encode, type Init } from "../wire/codec.js";
import type { CheckOuts } from "./check_outs.js";
import type { Entities } from "./entities.js";
import type { Leases } from "./leases.js";
import type { Requests } from "./requests.js";
import type { Runs } from "./runs.js";
import type { ServerWatch } from "./server_watch.js";
import type { Tasks } from "./tasks.js";
import type { Watches } from "./watches.js";

export interface Settings {
    /** Of every request that waits for an answer. */
    readonly timeoutMs: number;
    /** Leases outlive the connection for their grace. */
    readonly resume: boolean;
    /** The silence of the server is told after this; Infinity = it is not. */
    readonly noticeMs: number;
}
/** The server has been silent for so long that it is given up. */
export const SERVER_SILENCE_BUSY_MS = 1000;
export const SERVER_SILENCE_IDLE_MS = 10_000;
/** Finished tasks and runs whose reports can still be asked for. */
export const TASKS_KEPT = 1024;
export const RUNS_KEPT = 64;
/** After a lost connection: how often a master that has not ended a run yet is asked what became of it. */
export const OUTCOME_AGAIN_MS = 1000;
/** How long after this client a server may notice that the connection is gone; the grace begins then. */
export const LOSS_NOTICE_MS = 10_000;
/** A place in a wait list is asked for again this often; it is given up after three times as long. */
export const WAIT_REFRESH_MS = 5000;
/** Several that were free and then were not: when to try again, at least; at most twice as long. */
export const RETRY_MS = 200;

/** An entity under one lease: a newer lease of the same entity is another one. */
export interface Held {
    readonly entity: string;
    readonly lease: LeaseNumber;
}
export const keyOf = ({ entity, lease }: Held): string => `${lease.epoch}.${lease.number}.${entity}`;

/** Answers a request, once; without a refusal it is done. */
export type Done = (refusal?: Refusal) => void;

/** News for the program. It never runs inside the core: Session tells it after the core's turn. */
export interface Observer {
    entity(news: EntityNews): void;
    orphaned(held: Held, reason: string): void;
    resumed(held: Held): void;
    lost(held: Held, why: Refusal): void;
    handOver(held: Held, request: HandOverRequest): void;
    service(held: Held, service: Service): void;
    text(held: Held, text: string): void;
    raw(held: Held, bytes: Uint8Array): void;
    sample(sample: Sample): void;
    task(report: TaskReport): void;
    run(report: RunReport): void;
    serverText(code: string, text: string): void;
    credit(transfer: Id, from: number, to: number): void;
}

/** The newest stop generation that this client has seen of each entity, and the count of signals. */
export class SignalMarks {
    private readonly newest = new Map<string, number>();
    private last = 0;

    /** An older one that arrives late changes nothing. */
    raise(entity: string, generation: number): void {
        this.newest.set(entity, Math.max(this.of(entity), generation));
    }
    /** What the entity itself has answered: one that was restarted counts from its own beginning. */
    take(entity: string, generation: number): void {
        this.newest.set(entity, generation);
    }
    forget(entity: string): void {
        this.newest.delete(entity);
    }
    /** All of a connection that is lost, also of entities that it never told of. The count goes on. */
    forgetAll(): void {
        this.newest.clear();
    }
    of(entity: string): number {
        return this.newest.get(entity) ?? 0;
    }
    nextSequence(): number {
        return ++this.last;
    }
}

/** What the parts of the core share: the world as it was injected, and who this session is. */
export class Context {
    /** Set while there is a session. */
    link: Connection | undefined;
    self: Sender = { id: "", name: "", role: "observer" };
    /** Messages that were dropped. */
    malformed = 0;
    private sequence = 0;
    readonly marks = new SignalMarks();

    constructor(
        readonly settings: Settings,
        readonly clock: Clock,
        readonly random: Random,
        readonly observer: Observer,
    ) {}

    get connected(): boolean {
        return this.link !== undefined;
    }
    now(): number {
        return this.clock.now();
    }
    header(entity: string, msgType: string, held: LeaseNumber = NO_LEASE, seq?: number): Header {
        return { entity, msgType, held, stopGeneration: this.marks.of(entity), seq: seq ?? ++this.sequence, sentAtUs: Math.round(this.clock.now() * 1000) };
    }
    /** Returns the number of the message. Throws what encoded() throws, before anything is sent or counted. */
    send(entity: string, msgType: string, held: LeaseNumber, body: Init<proto.ToEntity>): number {
        const bytes = this.encoded(body);
        const head = this.header(entity, msgType, held);
        this.link?.toEntity(head, bytes);
        return head.seq;
    }
    /** Throws TOO_LARGE for what the server does not take: it would end the session. */
    encoded(body: Init<proto.ToEntity>): Uint8Array {
        const bytes = encode("ToEntity", body);
        const most = this.link?.facts.messageBytesMax ?? Infinity;
        if (bytes.length > most) throw new Refusal("TOO_LARGE", `The message has ${bytes.length} bytes, and at most ${most} go over this connection. Send it in parts, or upload a file as a resource.`);
        return bytes;
    }
    static notConnected(): Refusal {
        return new Refusal("NOT_CONNECTED", "There is no connection to the server at the moment. Try again when it is back.");
    }
}

/** The parts of the core, each with its own state, and what each may ask of the others. */
export interface Parts {
    readonly context: Context;
    readonly requests: Requests;
    readonly entities: Entities;
    readonly leases: Leases;
    readonly checkOuts: CheckOuts;
    readonly tasks: Tasks;
    readonly runs: Runs;
    readonly watches: Watches;
    readonly server: ServerWatch;
}
