// SPDX-License-Identifier: GPL-2.0-or-later
// What is between the session logic and the wire. The session logic knows nothing of Ice: it is written against these
// interfaces, and the tests use a transport of their own.
import type { Refusal } from "./refusal.js";
import type { EntityState, Presence, Sender } from "./types.js";

export interface LeaseNumber {
    readonly epoch: number;
    readonly number: number;
}
export const NO_LEASE: LeaseNumber = { epoch: 0, number: 0 };
export const sameLease = (a: LeaseNumber, b: LeaseNumber): boolean => a.epoch === b.epoch && a.number === b.number;
/** Whether `a` is at least as new. */
export const notOlder = (a: LeaseNumber, b: LeaseNumber): boolean => a.epoch > b.epoch || (a.epoch === b.epoch && a.number >= b.number);

/** The header of a routed message (docs/reference/sessions.md, "The header"); the server fills in the sender. */
export interface Header {
    readonly entity: string;
    readonly msgType: string;
    readonly held: LeaseNumber;
    readonly stopGeneration: number;
    readonly seq: number;
    readonly sentAtUs: number;
}

export interface Registration {
    readonly entity: string;
    readonly name: string;
    readonly category: string;
    readonly type: string;
}

export interface Status {
    readonly entity: string;
    readonly state: EntityState;
    readonly latched: boolean;
    readonly stopGeneration: number;
    readonly holder: Sender;
    readonly held: LeaseNumber;
    readonly reason: string;
    readonly orphaned: boolean;
    readonly waiting: number;
    readonly stopLatencyUs: number;
}

export type Lane = "data" | "signal";
export type StopCause = "requested" | "drill";

export interface Login {
    readonly server: string;
    /** Where the signal lane is; undefined = where the server says. */
    readonly signal: string | undefined;
    readonly user: string;
    readonly password: string;
    readonly displayName: string;
    readonly timeoutMs: number;
}

/** What the server pushes. Calls come in the order of their lane, one at a time, and may begin before Transport.open has answered. */
export interface ConnectionEvents {
    profile(presence: Presence, registration: Registration, profile: Uint8Array): void;
    status(status: Status): void;
    entityMessage(head: Header, bytes: Uint8Array): void;
    refused(head: Header, refusal: Refusal): void;
    stopAccepted(head: Header, entities: number): void;
    serverText(code: number, text: string): void;
    heartbeat(): void;
    /** At most once; nothing comes after it. */
    closed(reason: string): void;
}

export interface Facts {
    readonly me: Sender;
    /** How many entities the server will tell of at once. */
    readonly entities: number;
    readonly watchdogBusyMs: number;
    readonly watchdogIdleMs: number;
    /** Of one message of the data lane, without its header: a larger one would end the session. */
    readonly messageBytesMax: number;
}

/**
 * A session with the server, with one or two lanes. Nothing here waits or throws: what cannot be sent ends the connection, and
 * closed() is called in a turn of its own.
 */
export interface Connection {
    readonly facts: Facts;
    /** Whether signals have a connection of their own. */
    readonly signalLane: "own" | "shared";
    /** A signal lane is to be had, though it may not be open yet. */
    readonly signalOffered: boolean;
    /**
     * Opens the signal lane that was offered; one try at a time. Rejects with a Refusal if it cannot be reached now. Once it is
     * open its end is that of the session: the server ends both. So it is if the server does not answer that it is open: then
     * closed() is called, too.
     */
    attachSignalLane(): Promise<void>;
    /** Bytes and messages of the data lane that are not on their way yet. */
    backlog(): { readonly messages: number; readonly bytes: number };
    /**
     * Calls once, when nothing of the data lane waits and there is room for another chunk of an upload, in the order in which
     * this was asked. Returns what withdraws it.
     */
    onRoom(call: () => void): () => void;
    toEntity(head: Header, bytes: Uint8Array): void;
    /** May be dropped, oldest first, if the receiver is slow. */
    toEntityDroppable(head: Header, bytes: Uint8Array): void;
    request(head: Header, bytes: Uint8Array): void;
    stop(lane: Lane, head: Header, cause: StopCause): void;
    stopSeveral(lane: Lane, head: Header, entities: readonly string[], cause: StopCause): void;
    reset(head: Header): void;
    clear(head: Header): void;
    keepAlive(count: number): void;
    /** Asks for a sign of life, which comes as heartbeat(), and is none itself. Nothing is sent while several are not answered. */
    ask(): void;
    /** The orderly end. */
    leave(): Promise<void>;
    /** Without a word; closed() is not called. */
    drop(): void;
}

export interface Transport {
    /** Rejects with a Refusal. */
    open(login: Login, events: ConnectionEvents): Promise<Connection>;
}
