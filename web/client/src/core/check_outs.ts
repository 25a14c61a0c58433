// SPDX-License-Identifier: GPL-2.0-or-later
import type * as proto from "../../gen/messages.js";
import { fromHex, hex, type Id, idOf } from "../ids.js";
import { Refusal, type RefusalCode } from "../refusal.js";
import { type LeaseNumber, NO_LEASE } from "../transport.js";
import type { CheckOutOptions } from "../types.js";
import { fromPolicy, toRefusal } from "../wire/content.js";
import { Context, type Held, type Parts, RETRY_MS, WAIT_REFRESH_MS } from "./context.js";
import { leaseOf, type Ticket } from "./leases.js";

// Of axon.proto.CheckOutPhase.
const TAKE = 1;
const RESERVE = 2;
const COMMIT = 3;
const ABORT = 4;
const RESUME_LEASE = 5;

/** The Entity Manager ends a question to the holder; this is for one that does not answer any more. */
const ASKED_LONGEST_MS = 630_000;
/** What is waited for is looked at this often, should a status have been missed. */
const PARKED_LOOK_MS = 5000;
const LONGEST_WAIT_MS = 86_400_000;

/** Refusals that the same entities, a little later, may not give. */
const isRace = (code: RefusalCode): boolean => code === "ALREADY_HELD" || code === "RESERVED" || code === "EXPIRED" || code === "WRONG_STATE";

interface Party {
    readonly entity: string;
    sequence: number;
    answered: boolean;
    refused: boolean;
    granted: LeaseNumber | undefined;
}
type Stage = "asked" | "committing" | "queued" | "parked";
interface Order {
    readonly wanted: readonly string[];
    readonly options: CheckOutOptions;
    readonly resume: Ticket | undefined;
    readonly done: (granted: readonly Held[] | Refusal) => void;
    readonly until: number;
    /** Of the present attempt. */
    request: Id;
    parties: Party[];
    stage: Stage;
    due: number;
    kept: string;
    place: number;
    told: string;
    last: Refusal | undefined;
}

/**
 * Check-outs on their way. One entity is taken (TAKE); several are reserved and then committed, all or none. With `waitMs` one
 * entity is waited for in the list of its Entity Manager, and several are *parked* until all of them look free.
 */
export class CheckOuts {
    private readonly orders = new Map<Id, Order>();
    private readonly attempts = new Map<Id, Id>(); // request -> order

    constructor(private readonly parts: Parts) {}

    /** Throws what can be said at once. Returns what giveUp() needs. */
    checkOut(names: readonly string[], options: CheckOutOptions, done: Order["done"]): Id {
        const { context, entities, leases } = this.parts;
        if (!context.connected) throw Context.notConnected();
        const wanted: string[] = [];
        for (const name of names) {
            const id = entities.resolve(name);
            if (leases.of(id) !== undefined) throw new Refusal("ALREADY_HELD", `This client holds ${entities.label(id)} already.`, context.self.name);
            if (wanted.includes(id)) throw new Refusal("DUPLICATE", `${entities.label(id)} is named twice. Name each entity once.`);
            wanted.push(id);
        }
        if (wanted.length === 0) throw new Refusal("UNKNOWN_ENTITY", "No entity is named. Name at least one to check out.");
        if (options.ask === true && options.force === true) throw new Refusal("MALFORMED", "Either ask the holder or take it by force, not both.");
        if (options.ask === true && wanted.length > 1) throw new Refusal("NOT_SUPPORTED", "A holder is asked for one entity at a time. Ask for each by itself.");
        return this.begin(wanted, options, undefined, done);
    }
    resume(ticket: Ticket, done: Order["done"]): void {
        const { context, entities, leases } = this.parts;
        if (!context.connected) throw Context.notConnected();
        entities.there(ticket.entity);
        if (leases.of(ticket.entity) !== undefined) throw new Refusal("ALREADY_HELD", `This client holds ${entities.label(ticket.entity)} already.`, context.self.name);
        this.begin([ticket.entity], {}, ticket, done);
    }
    giveUp(id: Id): void {
        this.fail(id, new Refusal("CANCELLED", "The check-out was given up."));
    }

    private begin(wanted: readonly string[], options: CheckOutOptions, resume: Ticket | undefined, done: Order["done"]): Id {
        const id = hex(this.parts.context.random(16));
        const now = this.parts.context.now();
        const wait = options.waitMs ?? (options.ask === true ? ASKED_LONGEST_MS : undefined);
        const until = wait === undefined ? now : now + Math.min(Math.max(wait, 0), LONGEST_WAIT_MS);
        this.orders.set(id, { wanted, options, resume, done, until, request: "", parties: [], stage: "asked", due: Infinity, kept: "", place: 0, told: "", last: undefined });
        this.attempt(id);
        return id;
    }
    private attempt(id: Id): void {
        const order = this.orders.get(id) as Order;
        this.forgetAttempt(order);
        order.request = hex(this.parts.context.random(16));
        this.attempts.set(order.request, id);
        order.stage = "asked";
        order.parties = order.wanted.map((entity) => ({ entity, sequence: 0, answered: false, refused: false, granted: undefined }));
        order.due = this.parts.context.now() + this.parts.context.settings.timeoutMs;
        for (const party of order.parties) this.send(order, party, this.phaseOf(order));
    }
    private phaseOf(order: Order): number {
        if (order.resume !== undefined) return RESUME_LEASE;
        return order.wanted.length === 1 ? TAKE : order.stage === "committing" ? COMMIT : RESERVE;
    }
    private send(order: Order, party: Party, phase: number): void {
        const { context, entities, leases } = this.parts;
        const { options, resume } = order;
        party.answered = false;
        entities.onAskedFor(party.entity);
        const body: Parameters<Context["send"]>[3] = {
            checkOut: {
                requestId: fromHex(order.request),
                phase,
                // As long as this client may wait for the last of the others.
                ...(phase === RESERVE ? { reserveS: context.settings.timeoutMs / 1000 } : {}),
                ...(phase === ABORT
                    ? {}
                    : {
                          wait: phase === TAKE && options.waitMs !== undefined && options.force !== true,
                          ask: phase === TAKE && options.ask === true,
                          force: options.force === true,
                          reason: options.ask === true || options.force === true ? (options.reason ?? "") : "",
                          ...(phase === RESUME_LEASE && resume !== undefined
                              ? { resume: { ...resume.lease, key: resume.key } }
                              : { handOver: fromPolicy(options.handOver ?? {}), root: leases.root() }),
                      }),
            },
        };
        const sequence = context.send(party.entity, "CHECKOUT", NO_LEASE, body);
        party.sequence = phase === ABORT ? 0 : sequence;
    }
    private forgetAttempt(order: Order): void {
        this.attempts.delete(order.request);
        order.parties = [];
    }

    onReply(entity: string, reply: proto.CheckOutReply): void {
        const { leases, entities } = this.parts;
        const request = idOf(reply.requestId);
        const refusal = toRefusal(reply.refusal);
        const lease = leaseOf(reply.lease);
        const grants = refusal === undefined && reply.lease !== undefined && (reply.phase === TAKE || reply.phase === COMMIT || reply.phase === RESUME_LEASE);
        const id = request === undefined ? undefined : this.attempts.get(request);
        const order = id === undefined ? undefined : this.orders.get(id);
        const party = order?.parties.find((one) => one.entity === entity);
        if (id === undefined || order === undefined || party === undefined) {
            // Granted too late: nobody waits for it any more, and nobody else could have it.
            if (grants && leases.find({ entity, lease }) === undefined) leases.sendRelease({ entity, lease });
            return;
        }
        const expected = this.phaseOf(order);
        if (party.answered || (reply.phase !== expected && reply.phase !== 0)) return;
        if (refusal !== undefined) {
            party.answered = true;
            this.onPartyRefused(id, entity, refusal);
            return;
        }
        if (expected === TAKE && !grants && (order.options.waitMs !== undefined || order.options.ask === true)) {
            if (reply.kept !== "") order.kept = reply.kept;
            this.onWaiting(order, reply.place);
            return;
        }
        party.answered = true;
        if (expected !== RESERVE) {
            if (!grants) return this.fail(id, new Refusal("INTERNAL", `${entities.label(entity)} granted a check-out without a lease.`));
            party.granted = lease;
            leases.grant(entity, reply, order.options.handOver ?? {});
        }
        this.advance(id, order);
    }
    private advance(id: Id, order: Order): void {
        if (!order.parties.every((party) => party.answered)) return;
        if (order.wanted.length > 1 && order.stage !== "committing") {
            order.stage = "committing";
            order.due = this.parts.context.now() + this.parts.context.settings.timeoutMs;
            for (const party of order.parties) this.send(order, party, COMMIT);
            return;
        }
        // All or none: what was granted first may be gone by the time that the last is granted.
        const granted: Held[] = [];
        for (const { entity, granted: lease } of order.parties) {
            const held = { entity, lease: lease ?? NO_LEASE };
            if (this.parts.leases.find(held) === undefined) {
                return this.fail(id, new Refusal("REVOKED_LEASE", `${this.parts.entities.label(entity)} was lost before the others were granted.`));
            }
            granted.push(held);
        }
        this.forgetAttempt(order);
        this.orders.delete(id);
        order.done(granted);
    }
    private onPartyRefused(id: Id, entity: string, why: Refusal): void {
        const order = this.orders.get(id) as Order;
        for (const party of order.parties) if (party.entity === entity) party.refused = true;
        const several = order.wanted.length > 1;
        const named = several ? why.saying(`${this.parts.entities.label(entity)}: ${why.message}`) : why;
        if (several && order.options.waitMs !== undefined && isRace(why.code)) {
            this.endAttempt(order, why);
            this.park(order, named);
            return;
        }
        this.fail(id, named);
    }
    private endAttempt(order: Order, why: Refusal): void {
        const { context, leases } = this.parts;
        const parties = order.parties;
        for (const party of parties) {
            if (party.granted !== undefined) {
                const held = { entity: party.entity, lease: party.granted };
                // It may have been lost or released meanwhile, and checked out again.
                if (leases.find(held) === undefined) continue;
                leases.end(party.entity, why, false);
                if (context.connected) leases.sendRelease(held);
            } else if (order.resume === undefined && !party.refused && context.connected) {
                this.send(order, party, ABORT);
            }
        }
        this.forgetAttempt(order);
    }
    private fail(id: Id, why: Refusal): void {
        const order = this.orders.get(id);
        if (order === undefined) return;
        this.endAttempt(order, why);
        this.orders.delete(id);
        order.done(why);
    }

    /** Whether the message that the servers could not deliver was of a check-out. */
    onRefused(sequence: number, entity: string, why: Refusal): boolean {
        for (const [id, order] of this.orders) {
            if (order.parties.some((party) => sequence !== 0 && party.sequence === sequence)) {
                this.onPartyRefused(id, entity, why);
                return true;
            }
        }
        return false;
    }
    onLeft(entity: string, why: Refusal): void {
        for (const id of [...this.orders.keys()]) {
            const order = this.orders.get(id);
            if (order?.parties.some((party) => party.entity === entity) === true) this.onPartyRefused(id, entity, why);
            else if (order?.stage === "parked" && order.wanted.includes(entity)) this.fail(id, why); // it waits in vain
        }
    }
    disconnected(lost: Refusal): void {
        for (const id of [...this.orders.keys()]) this.fail(id, lost);
    }

    private onWaiting(order: Order, place: number): void {
        const { context, entities } = this.parts;
        const entity = order.wanted[0] as string;
        if (order.stage !== "queued") {
            order.stage = "queued";
            order.due = Math.min(order.until, context.now() + WAIT_REFRESH_MS);
        }
        order.place = place;
        const holder = entities.holderOf(entity);
        const label = entities.label(entity);
        const asks = order.options.ask === true;
        let message = order.kept !== "" ? order.kept.replace(/\.+$/, "") : asks ? `${holder === "" ? `The holder of ${label}` : holder} has been asked` : "";
        if (order.options.waitMs !== undefined) {
            message += `${message === "" ? "Place" : "; place"} ${place} in the wait list of ${label}`;
            if (holder !== "" && (!asks || order.kept !== "")) message += `, which is held by ${holder}`;
        }
        this.tell(order, entity, place, `${message}.`);
    }
    private tell(order: Order, entity: string, place: number, message: string): void {
        if (order.told === message) return;
        order.told = message;
        order.options.onWaiting?.({ entity, place, message });
    }
    private wantedAreFree(order: Order): boolean {
        return order.wanted.every((id) => {
            const facts = this.parts.entities.facts(id);
            return facts?.state === "IDLE" && facts.holder === undefined;
        });
    }
    private park(order: Order, why: Refusal): void {
        order.stage = "parked";
        order.last = why;
        const now = this.parts.context.now();
        // Two who want the same things must not step on each other's toes for ever.
        const dice = (this.parts.context.random(1)[0] ?? 0) / 256;
        order.due = Math.min(order.until, now + (this.wantedAreFree(order) ? RETRY_MS * (1 + dice) : PARKED_LOOK_MS));
        this.tell(order, "", 0, `Waiting. ${why.message}`);
    }
    /** After each status: what was waited for may be free. */
    wakeParked(): void {
        const soon = this.parts.context.now() + 2 * RETRY_MS;
        for (const [id, order] of [...this.orders]) {
            // One that is about to be looked at anyway had lost a race.
            if (order.stage === "parked" && order.due > soon && this.wantedAreFree(order)) this.attempt(id);
        }
    }

    nextDeadline(): number {
        let next = Infinity;
        for (const { due } of this.orders.values()) next = Math.min(next, due);
        return next;
    }
    onTimer(): void {
        const now = this.parts.context.now();
        for (const [id, order] of [...this.orders]) if (order.due <= now && this.orders.get(id) === order) this.onDue(id, order, now);
    }
    private onDue(id: Id, order: Order, now: number): void {
        const { entities } = this.parts;
        if (order.stage === "queued") {
            const entity = order.wanted[0] as string;
            if (now >= order.until) {
                const message =
                    order.options.waitMs === undefined
                        ? `Nobody has answered the request for ${entities.label(entity)} in time.`
                        : `${entities.label(entity)} has not become free in time; the place in its wait list was ${order.place}.`;
                return this.fail(id, new Refusal("TIMED_OUT", message, entities.holderOf(entity)));
            }
            order.due = Math.min(order.until, now + WAIT_REFRESH_MS);
            // A question need not be repeated: its Entity Manager remembers it, or has answered.
            if (order.options.waitMs !== undefined) this.send(order, order.parties[0] as Party, TAKE);
        } else if (order.stage === "parked") {
            if (now >= order.until) return this.fail(id, new Refusal("TIMED_OUT", `The time to wait is up. ${order.last?.message ?? ""}`, order.last?.holder));
            if (this.wantedAreFree(order)) return this.attempt(id);
            order.due = Math.min(order.until, now + PARKED_LOOK_MS);
        } else {
            const silent = order.parties.filter((party) => !party.answered).map(({ entity }) => entities.label(entity));
            this.fail(id, new Refusal("TIMED_OUT", `No answer from ${silent.join(", ")} to the check-out in time; nothing was checked out.`));
        }
    }
}
