// SPDX-License-Identifier: GPL-2.0-or-later
import type * as proto from "../../gen/messages.js";
import { fromHex, hex, type Id, idOf, parseUuid, uuidText } from "../ids.js";
import { Refusal, type RefusalCode } from "../refusal.js";
import { type LeaseNumber, NO_LEASE, notOlder, sameLease, type Status } from "../transport.js";
import type { HandOverPolicy, HandOverRequest, Service } from "../types.js";
import { fromPolicy, safeNumber, toRefusal, toService } from "../wire/content.js";
import { findService } from "../wire/values.js";
import { Context, type Done, type Held, LOSS_NOTICE_MS, type Parts } from "./context.js";
import { availabilityOf } from "./entities.js";
import { outlivesLease } from "./requests.js";

/** Services of one entity; the Entity Manager admits fewer. */
const SERVICES_MAX = 4096;
/** The news of a loss come before the robot has waited so long. */
const LOSS_TOLD_MS = 1000;
const RESUME_AGAIN_MS = 500;

const goneBy = (code: RefusalCode): boolean => code === "NOT_HOLDER" || code === "OLDER_LEASE" || code === "REVOKED_LEASE" || code === "WRONG_EPOCH";

export const leaseOf = (lease: proto.Lease | undefined): LeaseNumber => (lease === undefined ? NO_LEASE : { epoch: lease.epoch | 0, number: lease.number | 0 });

/** What CheckOut.ticket() gives: enough to take the lease over. */
export interface Ticket extends Held {
    readonly key: Uint8Array;
}
export function ticketText({ entity, lease, key }: Ticket): string {
    return `axon-lease:${entity}:${lease.epoch}:${lease.number}:${uuidText(hex(key))}`;
}
export function parseTicket(text: string): Ticket {
    const [word, entity, epoch, number, key, ...more] = text.split(":");
    const digits = /^\d{1,9}$/;
    const id = parseUuid(key ?? "");
    if (word !== "axon-lease" || more.length > 0 || parseUuid(entity ?? "") === undefined || id === undefined || !digits.test(epoch ?? "") || !digits.test(number ?? "")) {
        throw new Refusal("MALFORMED", "Expected a ticket as CheckOut.ticket() gives it (axon-lease:…).");
    }
    return { entity: entity as string, lease: { epoch: Number(epoch), number: Number(number) }, key: fromHex(id) };
}

export interface Lease {
    number: LeaseNumber;
    /** 16 bytes: proves that a lease is resumed by its holder. */
    key: Uint8Array;
    /** 16 bytes: entities may collaborate under leases of one root. */
    root: Uint8Array;
    readonly name: string;
    services: Service[];
    readonly graceMs: number;
    readonly resourceBytesMax: number;
    policy: HandOverPolicy;
    orphaned: boolean;
    /** Orphaned because the entity has left or waits for us, while this client has its connection. */
    left: boolean;
    expires: number;
    /** When a loss that nobody has told of counts. */
    lossDue: number;
    /** Of the request that resumes it. */
    resume: Id;
    question: HandOverRequest | undefined;
    answerUntil: number;
    askedBy: Uint8Array;
}

/** What is held, handed over, orphaned and resumed. */
export class Leases {
    private readonly leases = new Map<string, Lease>();
    private ownRoot: Uint8Array | undefined;

    constructor(private readonly parts: Parts) {}

    held(): Held[] {
        return [...this.leases].map(([entity, { number }]) => ({ entity, lease: number }));
    }
    of(entity: string): Lease | undefined {
        return this.leases.get(entity);
    }
    find(held: Held): Lease | undefined {
        const mine = this.leases.get(held.entity);
        return mine !== undefined && sameLease(mine.number, held.lease) ? mine : undefined;
    }
    private notHolder(held: Held): Refusal {
        return new Refusal("NOT_HOLDER", `This client does not hold ${this.parts.entities.label(held.entity)}, or no longer does. Check it out first.`);
    }
    /** Throws if nothing can be asked of it now. */
    ready(held: Held): Lease {
        if (!this.parts.context.connected) throw Context.notConnected();
        const mine = this.mine(held);
        if (mine.orphaned) throw new Refusal("NOT_CONNECTED", `The connection was lost, and the check-out of ${mine.name} is not resumed yet. Try again in a moment.`);
        return mine;
    }
    isReady(held: Held): boolean {
        return this.parts.context.connected && this.find(held)?.orphaned === false;
    }
    /** Throws NOT_HOLDER. */
    mine(held: Held): Lease {
        const mine = this.find(held);
        if (mine === undefined) throw this.notHolder(held);
        return mine;
    }
    service(held: Held, nameOrGlobalId: string): Service {
        return findService(this.mine(held).services, nameOrGlobalId);
    }
    question(held: Held): HandOverRequest | undefined {
        const mine = this.find(held);
        if (mine?.question === undefined) return undefined;
        return { ...mine.question, answerWithinMs: Math.max(mine.answerUntil - this.parts.context.now(), 0) };
    }
    ticket(held: Held): string {
        const mine = this.mine(held);
        if (mine.key.length !== 16) throw new Refusal("NOT_SUPPORTED", `${mine.name} has given no key for its lease.`);
        return ticketText({ ...held, key: mine.key });
    }
    /** One for all that this session holds. */
    root(): Uint8Array {
        this.ownRoot ??= this.parts.context.random(16);
        return this.ownRoot;
    }

    grant(entity: string, reply: proto.CheckOutReply, policy: HandOverPolicy): void {
        const given = reply.lease;
        const before = this.leases.get(entity);
        const key = given?.key ?? new Uint8Array(0);
        const root = given?.root ?? new Uint8Array(0);
        // Of another process, whose other leases may follow: what is checked out from now on belongs to them.
        if (this.leases.size === 0 && root.length === 16) this.ownRoot = root;
        this.leases.set(entity, {
            number: leaseOf(given),
            key: key.length === 0 && before !== undefined ? before.key : key, // of a lease that is resumed
            root,
            name: this.parts.entities.label(entity),
            services: (reply.services?.services ?? []).slice(0, SERVICES_MAX).map(toService),
            graceMs: reply.graceMs,
            resourceBytesMax: safeNumber(reply.resourceBytesMax),
            policy,
            orphaned: false,
            lossDue: Infinity,
            left: false,
            expires: Infinity,
            resume: "",
            question: undefined,
            answerUntil: 0,
            askedBy: new Uint8Array(0),
        });
        this.parts.context.marks.take(entity, reply.stopGeneration);
        this.parts.entities.onGranted(entity, reply.stopGeneration, reply.latched);
        this.parts.server.pace();
    }
    end(entity: string, why: Refusal, tell: boolean): void {
        const mine = this.leases.get(entity);
        if (mine === undefined) return;
        const held: Held = { entity, lease: mine.number };
        this.leases.delete(entity);
        this.parts.entities.countMoving(entity);
        for (const one of this.parts.requests.of(entity)) {
            if (sameLease(one.lease, held.lease) && !outlivesLease(one.what.kind)) this.parts.requests.settle(one.what.kind, one.id, why);
        }
        if (tell) {
            const unknown = new Refusal("OUTCOME_UNKNOWN", `The lease ended while it was under way: ${why.message}`, why.holder);
            this.parts.tasks.finishAll(held, unknown);
            this.parts.runs.finishAll(held, unknown);
            this.parts.context.observer.lost(held, why);
        }
        this.parts.server.pace();
    }
    onLeaseEnded(entity: string, ended: proto.LeaseEnded): void {
        const number = leaseOf(ended.lease);
        this.endReleases(entity, (over) => sameLease(over, number));
        if (this.find({ entity, lease: number }) === undefined) return;
        this.end(entity, toRefusal(ended.reason) ?? new Refusal("REVOKED_LEASE", `The lease of ${this.parts.entities.label(entity)} has ended.`), true);
    }
    onStatus(status: Status): void {
        const { entity, holder, held, state, reason } = status;
        const label = this.parts.entities.label(entity);
        const mine = holder.id === this.parts.context.self.id;
        const lease = this.leases.get(entity);
        if (lease !== undefined) {
            if (!mine && notOlder(held, lease.number) && !sameLease(held, lease.number)) {
                this.end(entity, new Refusal("REVOKED_LEASE", `${label} was given to ${holder.name}.`, holder.name), true);
            } else if (!lease.orphaned && holder.id === "" && availabilityOf(state) === "away") {
                this.end(entity, new Refusal("UNAVAILABLE", `${label} is ${state}${reason === "" ? "." : `: ${reason}`}`), true);
            } else {
                this.expectLoss(lease, !lease.orphaned && mine && status.orphaned && sameLease(held, lease.number));
            }
        }
        if (!mine) this.endReleases(entity, (number) => notOlder(held, number));
    }
    /**
     * Its Entity Manager waits for us, and we know of no loss. Usually the news of it follow, or that it is over (another has taken it, it is
     * ours again); of news that are lost, only the last state is made up for (ADR 0016).
     */
    private expectLoss(lease: Lease, waits: boolean): void {
        if (!waits) lease.lossDue = Infinity;
        else if (lease.lossDue === Infinity) lease.lossDue = this.parts.context.now() + LOSS_TOLD_MS;
    }
    nextDeadline(): number {
        let next = Infinity;
        for (const { lossDue } of this.leases.values()) next = Math.min(next, lossDue);
        return next;
    }
    /** A lease whose Entity Manager has waited for us for a second is lost, and resumed. */
    onTimer(): void {
        const now = this.parts.context.now();
        for (const [entity, lease] of [...this.leases]) {
            if (lease.lossDue > now) continue;
            lease.lossDue = Infinity;
            if (lease.orphaned) continue;
            this.onLeft(entity, new Refusal("CLIENT_LOST", `The servers or the Entity Manager of ${lease.name} had lost this client for a moment, and the robot was stopped.`));
            if (this.parts.entities.isThere(entity)) this.sendResume(entity);
        }
    }
    /** Something was refused that was asked under a lease: the lease may be gone. */
    onRefusal(entity: string, under: LeaseNumber, refusal: Refusal): void {
        if (!goneBy(refusal.code) || sameLease(under, NO_LEASE) || this.find({ entity, lease: under }) === undefined) return;
        this.end(entity, refusal, true);
    }
    onService(entity: string, incoming: proto.Service): void {
        const mine = this.leases.get(entity);
        if (mine === undefined) return;
        const service = toService(incoming);
        const at = mine.services.findIndex(({ name }) => name === service.name);
        if (at < 0 && mine.services.length >= SERVICES_MAX) return;
        mine.services = at < 0 ? [...mine.services, service] : mine.services.map((one, i) => (i === at ? service : one));
        this.parts.context.observer.service({ entity, lease: mine.number }, service);
    }

    sendRelease(held: Held): void {
        this.parts.context.send(held.entity, "RELEASE", held.lease, { release: {} });
    }
    release(held: Held, done: Done): void {
        if (this.find(held)?.orphaned === true) {
            // Nobody can be told; the Entity Manager ends it when its time is up.
            this.end(held.entity, new Refusal("NOT_HOLDER", "It was released."), false);
            this.parts.tasks.finishAll(held, new Refusal("OUTCOME_UNKNOWN", "Its check-out was released while the connection was lost."));
            this.parts.runs.finishAll(held, new Refusal("OUTCOME_UNKNOWN", "The check-out of its master was released while the connection was lost."));
            return done();
        }
        this.ready(held);
        const sequence = this.parts.context.send(held.entity, "RELEASE", held.lease, { release: {} });
        this.end(held.entity, new Refusal("NOT_HOLDER", `${this.parts.entities.label(held.entity)} was released.`), false);
        // The entity stops what runs and says so in events of the tasks; without them they become Unknown.
        this.parts.tasks.awaitEnds(held);
        this.parts.runs.awaitEnds(held);
        this.parts.requests.await(hex(this.parts.context.random(16)), { kind: "release", done }, { ...held, sequence });
    }
    private endReleases(entity: string, which: (number: LeaseNumber) => boolean): void {
        for (const one of this.parts.requests.of(entity)) {
            if (one.what.kind === "release" && which(one.lease)) this.parts.requests.settle("release", one.id);
        }
    }

    onHandOver(entity: string, request: proto.HandOverRequest): void {
        const mine = this.leases.get(entity);
        if (mine === undefined || request.requestId.length === 0) return;
        const held: Held = { entity, lease: mine.number };
        const within = Number.isFinite(request.answerWithinS) ? Math.min(Math.max(request.answerWithinS, 0), 600) * 1000 : 0;
        const question: HandOverRequest = { by: request.by, reason: request.reason, answerWithinMs: within, yield: request.yield, withdrawn: request.withdrawn };
        const same = hex(mine.askedBy) === hex(request.requestId);
        if (question.withdrawn) {
            if (!same || mine.question === undefined) return;
            mine.question = undefined;
            mine.askedBy = new Uint8Array(0);
            this.parts.context.observer.handOver(held, question);
            return;
        }
        const known = mine.question !== undefined && same;
        mine.question = question;
        mine.answerUntil = this.parts.context.now() + within;
        mine.askedBy = request.requestId;
        if (mine.policy.refuse === true) {
            if (this.isReady(held)) this.answerHandOver(held, false, "Its holder does not hand it over.");
        } else if (!known) {
            this.parts.context.observer.handOver(held, question);
        }
    }
    answerHandOver(held: Held, accept: boolean, reason: string): void {
        const mine = this.ready(held);
        if (mine.question === undefined) throw new Refusal("WRONG_STATE", `No client asks for ${this.parts.entities.label(held.entity)} at the moment.`);
        this.parts.context.send(held.entity, "HAND_OVER", held.lease, { handOverAnswer: { requestId: mine.askedBy, accept, reason } });
        mine.question = undefined;
        mine.askedBy = new Uint8Array(0);
    }
    setHandOverPolicy(held: Held, policy: HandOverPolicy): void {
        this.ready(held).policy = policy;
        this.parts.context.send(held.entity, "HAND_OVER", held.lease, { handOverPolicy: fromPolicy(policy) });
    }

    disconnected(lost: Refusal, wasConnected: boolean, forGood: boolean): void {
        for (const { entity } of this.held()) {
            const mine = this.leases.get(entity);
            if (forGood || mine === undefined || !this.mayOutlive(mine)) this.end(entity, lost, true);
            else if (wasConnected) this.orphan(entity, false, lost.message);
        }
    }
    /** The connection, or the entity's. */
    private mayOutlive(lease: Lease): boolean {
        return this.parts.context.settings.resume && lease.graceMs > 0;
    }
    onLeft(entity: string, why: Refusal): void {
        // Its Entity Manager may only have lost the server for a moment, or the server may be about to end.
        const mine = this.leases.get(entity);
        if (mine !== undefined && this.mayOutlive(mine)) this.orphan(entity, true, why.message);
        else this.end(entity, why, true);
    }
    private orphan(entity: string, left: boolean, reason: string): void {
        const mine = this.leases.get(entity) as Lease;
        const pending = mine.resume === "" ? undefined : this.parts.requests.find("resumeLease", mine.resume);
        if (mine.orphaned && !mine.left) {
            if (pending !== undefined) pending.deadline = mine.expires; // its time runs from the first loss
            return;
        }
        const isNew = !mine.orphaned;
        mine.orphaned = true;
        mine.left = left;
        // An entity that has left its server may come back by another one: its own time has begun before.
        mine.expires = this.parts.context.now() + mine.graceMs;
        if (!left) mine.expires += Math.max(LOSS_NOTICE_MS, this.parts.server.watchdogIdleMs);
        mine.question = undefined;
        mine.askedBy = new Uint8Array(0);
        if (isNew) {
            mine.resume = hex(this.parts.context.random(16));
            this.parts.requests.await(mine.resume, { kind: "resumeLease" }, { entity, lease: mine.number, deadline: mine.expires });
            this.parts.context.observer.orphaned({ entity, lease: mine.number }, reason);
        } else if (pending !== undefined) {
            pending.deadline = mine.expires;
        }
    }
    sendResumes(): void {
        for (const entity of [...this.leases.keys()]) if (this.parts.entities.isThere(entity)) this.sendResume(entity);
    }
    sendResume(entity: string): void {
        const mine = this.leases.get(entity);
        const pending = mine?.orphaned === true ? this.parts.requests.find("resumeLease", mine.resume) : undefined;
        if (mine === undefined || pending === undefined) return;
        this.parts.entities.onAskedFor(entity);
        pending.sequence = this.parts.context.send(entity, "CHECKOUT", NO_LEASE, {
            checkOut: { requestId: fromHex(mine.resume), phase: 5, resume: { ...mine.number, key: mine.key } },
        });
        pending.deadline = Math.min(mine.expires, this.parts.context.now() + this.parts.context.settings.timeoutMs);
    }
    onResumeDue(request: Id): void {
        const pending = this.parts.requests.find("resumeLease", request);
        const mine = pending === undefined ? undefined : this.leases.get(pending.entity);
        if (pending === undefined || mine === undefined) return void this.parts.requests.take("resumeLease", request);
        const { connected } = this.parts.context;
        if (this.parts.context.now() < mine.expires) {
            pending.deadline = mine.expires;
            if (connected && this.parts.entities.isThere(pending.entity)) this.sendResume(pending.entity);
            return;
        }
        const why =
            mine.left && connected && !this.parts.entities.isThere(pending.entity)
                ? new Refusal("UNAVAILABLE", `${mine.name} has left: its Entity Manager is no longer connected to the server.`)
                : connected
                  ? new Refusal("EXPIRED", `${mine.name} could not be resumed within its grace.`)
                  : new Refusal("NOT_CONNECTED", `The connection to the server was not back in time to resume ${mine.name}.`);
        this.end(pending.entity, why, true);
        this.parts.requests.take("resumeLease", request);
    }
    /** The servers could not deliver the request to resume. */
    onResumeRefused(request: Id): void {
        const pending = this.parts.requests.find("resumeLease", request);
        const mine = pending === undefined ? undefined : this.leases.get(pending.entity);
        // It is asked when it joins; where it is there already, also without.
        if (pending !== undefined && mine !== undefined) pending.deadline = Math.min(mine.expires, this.parts.context.now() + RESUME_AGAIN_MS);
    }
    /** Whether the reply was to a request to resume. */
    onResumeReply(entity: string, reply: proto.CheckOutReply): boolean {
        const request = idOf(reply.requestId);
        const pending = request === undefined ? undefined : this.parts.requests.find("resumeLease", request);
        const mine = this.leases.get(entity);
        if (request === undefined || pending === undefined || pending.entity !== entity || mine === undefined) return false;
        let refusal = toRefusal(reply.refusal);
        const given = leaseOf(reply.lease);
        if (refusal === undefined && reply.lease !== undefined && !sameLease(given, mine.number)) {
            refusal = new Refusal("INTERNAL", `${mine.name} resumed another lease than the one asked for.`);
            this.sendRelease({ entity, lease: given });
        }
        if (refusal !== undefined) {
            this.end(entity, refusal, true);
            return true;
        }
        const held: Held = { entity, lease: mine.number };
        this.parts.requests.take("resumeLease", request);
        this.grant(entity, reply, mine.policy);
        (this.leases.get(entity) as Lease).number = held.lease;
        this.parts.context.observer.resumed(held);
        this.parts.tasks.askAfter(held);
        this.parts.runs.askAfter(held);
        return true;
    }
}
