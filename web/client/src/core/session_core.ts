// SPDX-License-Identifier: GPL-2.0-or-later
import { idOf } from "../ids.js";
import { Refusal } from "../refusal.js";
import type { Connection, Header, Registration, Status } from "../transport.js";
import { sameLease } from "../transport.js";
import type { Presence } from "../types.js";
import type * as proto from "../../gen/messages.js";
import { decode } from "../wire/codec.js";
import { toRefusal, toSample } from "../wire/content.js";
import { CheckOuts } from "./check_outs.js";
import { Commands } from "./commands.js";
import type { Context, Parts } from "./context.js";
import { Entities } from "./entities.js";
import { Leases } from "./leases.js";
import { outlivesConnection, outlivesEntity, type Pending, Requests } from "./requests.js";
import { Runs } from "./runs.js";
import { ServerWatch } from "./server_watch.js";
import { Tasks } from "./tasks.js";
import { Watches } from "./watches.js";

/** Dispatches events of the server, wishes of the program and time to its parts. It does no I/O of its own. */
export class SessionCore implements Parts {
    readonly requests: Requests;
    readonly entities: Entities = new Entities(this);
    readonly leases: Leases = new Leases(this);
    readonly checkOuts: CheckOuts = new CheckOuts(this);
    readonly tasks: Tasks = new Tasks(this);
    readonly runs: Runs = new Runs(this);
    readonly watches: Watches = new Watches(this);
    readonly commands: Commands = new Commands(this);
    readonly server: ServerWatch;

    constructor(readonly context: Context) {
        this.requests = new Requests(
            () => context.now(),
            context.settings.timeoutMs,
            (entity, under, why) => this.leases.onRefusal(entity, under, why),
        );
        this.server = new ServerWatch(this);
    }

    onConnected(link: Connection): void {
        const { facts } = link;
        this.context.link = link;
        this.context.self = facts.me;
        this.entities.connected(facts.entities);
        this.server.connected(facts.watchdogBusyMs, facts.watchdogIdleMs);
        this.leases.sendResumes();
        this.watches.sendAll();
    }
    onDisconnected(reason: string, forGood = false): void {
        const wasConnected = this.context.connected;
        this.context.link = undefined;
        this.server.disconnected();
        const lost = new Refusal("NOT_CONNECTED", `The connection to the server was lost: ${reason}`);
        const unknown = new Refusal("OUTCOME_UNKNOWN", `The connection to the server was lost while it was under way: ${reason}`);
        this.checkOuts.disconnected(lost);
        this.leases.disconnected(lost, wasConnected, forGood);
        for (const one of this.requests.all()) {
            if (outlivesConnection(one.what.kind)) continue;
            // A task or run that nobody has answered for is asked after when its lease is resumed, or is unknown below.
            this.requests.settle(one.what.kind, one.id, unknown);
        }
        this.tasks.finishUnheld(unknown);
        this.runs.finishUnheld(unknown);
        this.entities.disconnected();
    }

    onProfile(presence: Presence, registration: Registration, profile: Uint8Array): void {
        if (presence !== "left") return this.entities.onProfile(registration, profile);
        const id = registration.entity;
        if (this.entities.facts(id) === undefined) return;
        const why = new Refusal("UNAVAILABLE", `${this.entities.label(id)} has left: its Entity Manager is no longer connected to the server.`);
        this.leases.onLeft(id, why);
        this.checkOuts.onLeft(id, why);
        for (const one of this.requests.of(id)) if (!outlivesEntity(one.what.kind)) this.requests.settle(one.what.kind, one.id, why);
        this.entities.onLeft(id);
    }
    onStatus(status: Status): void {
        this.context.marks.raise(status.entity, status.stopGeneration);
        const joins = this.entities.onStatus(status);
        this.leases.onStatus(status);
        this.checkOuts.wakeParked();
        this.server.pace();
        if (!joins) this.entities.tellChanged(status.entity);
    }

    onEntityMessage(head: Header, bytes: Uint8Array): void {
        let message: proto.ToClient;
        try {
            message = decode("ToClient", bytes);
        } catch {
            ++this.context.malformed;
            return;
        }
        const { entity } = head;
        const { observer } = this.context;
        const lease = this.leases.of(entity)?.number;
        if (message.checkOut !== undefined) {
            this.context.marks.raise(entity, message.checkOut.stopGeneration);
            if (!this.leases.onResumeReply(entity, message.checkOut)) this.checkOuts.onReply(entity, message.checkOut);
        } else if (message.leaseEnded !== undefined) {
            this.leases.onLeaseEnded(entity, message.leaseEnded);
        } else if (message.reply !== undefined) {
            this.onReply(head, message.reply);
        } else if (message.task !== undefined) {
            this.tasks.onEvent(entity, message.task);
        } else if (message.status !== undefined) {
            this.onStatusMessage(entity, message.status);
        } else if (message.resourceCredit !== undefined) {
            this.commands.onCredit(message.resourceCredit);
        } else if (message.resourceDone !== undefined) {
            const id = idOf(message.resourceDone.transferId);
            if (id !== undefined) this.requests.settle("upload", id, toRefusal(message.resourceDone.refusal));
        } else if (message.text !== undefined) {
            if (lease !== undefined) observer.text({ entity, lease }, message.text.text);
        } else if (message.raw !== undefined) {
            if (lease !== undefined) for (const piece of message.raw.data) observer.raw({ entity, lease }, piece);
        } else if (message.sample !== undefined) {
            const sample = this.watches.watching(entity) ? toSample(entity, message.sample, this.context.now()) : undefined;
            if (sample !== undefined) observer.sample(sample);
        } else if (message.service !== undefined) {
            this.leases.onService(entity, message.service);
        } else if (message.handOver !== undefined) {
            this.leases.onHandOver(entity, message.handOver);
        } else if (message.run !== undefined) {
            this.runs.onEvent(entity, message.run);
        } else if (message.runHistory !== undefined) {
            this.runs.onHistory(entity, message.runHistory);
        } else if (message.globalServices !== undefined) {
            if (entity === "") this.runs.onServices(message.globalServices); // of the server, which is no entity
        } else if (message.receipt === undefined && message.way === undefined) {
            ++this.context.malformed; // or a message of a newer version: nothing this one could do with it
        }
    }
    private onReply(head: Header, reply: proto.Reply): void {
        const id = idOf(reply.requestId);
        const refusal = toRefusal(reply.refusal);
        if (id === undefined) {
            // Text, raw data and the like have no request of their own: a refusal is all that comes back. The entity's header
            // says which lease it obeys now; while that is ours, the refusal is about an earlier one.
            if (refusal === undefined) {
                ++this.context.malformed;
                return;
            }
            const label = this.entities.label(head.entity);
            const mine = this.leases.of(head.entity);
            if (mine !== undefined && !sameLease(head.held, mine.number)) this.leases.onRefusal(head.entity, mine.number, refusal);
            this.context.observer.serverText(refusal.code, `${label}: ${refusal.message}`);
            return;
        }
        if (this.requests.settle("confirmed", id, refusal) || this.requests.settle("release", id, refusal) || refusal === undefined) return;
        for (const kind of ["details", "control", "upload", "globalServices", "runRecords"] as const) if (this.requests.settle(kind, id, refusal)) return;
        // Of the request itself: once an event has come, a refusal is of something else, and the robots may move.
        if (!this.tasks.has(id)) this.runs.onRefused(id, head.entity, refusal);
        else if (this.requests.find("startTask", id) !== undefined) this.tasks.finish(id, "REFUSED", refusal);
    }
    private onStatusMessage(entity: string, status: proto.EntityStatus): void {
        this.context.marks.raise(entity, status.stopGeneration);
        this.entities.onOwnStatus(entity, status);
        for (const event of [...status.tasks, ...status.ended]) this.tasks.onEvent(entity, event);
        this.server.pace();
        if (!this.tasks.onAnswer(status)) this.entities.onDetails(status);
    }
    /** The servers could not deliver a message of this client. */
    onRefusal(head: Header, refusal: Refusal): void {
        if (this.checkOuts.onRefused(head.seq, head.entity, refusal)) return;
        const one = this.requests.bySequence(head.seq, head.entity);
        if (one !== undefined) return this.onRequestRefused(one, refusal);
        if (this.leases.of(head.entity) !== undefined) this.leases.onRefusal(head.entity, head.held, refusal);
        this.context.observer.serverText(refusal.code, refusal.message);
    }
    private onRequestRefused({ what, id }: Pending, refusal: Refusal): void {
        if (what.kind === "startTask") this.tasks.finish(id, "REFUSED", refusal);
        else if (what.kind === "startRun") this.runs.finish(id, "REFUSED", refusal);
        else if (what.kind === "resumeLease") this.leases.onResumeRefused(id);
        else if (what.kind === "askAfterTasks") this.tasks.onAskAfterDue(id);
        else this.requests.settle(what.kind, id, refusal);
    }

    nextDeadline(): number {
        return Math.min(this.requests.nextDeadline(), this.checkOuts.nextDeadline(), this.leases.nextDeadline());
    }
    onTimer(): void {
        const now = this.context.now();
        for (let one = this.requests.due(now); one !== undefined; one = this.requests.due(now)) this.onDue(one);
        this.checkOuts.onTimer();
        this.leases.onTimer();
    }
    private onDue({ what, id }: Pending): void {
        const late = new Refusal("TIMED_OUT", `No answer within ${this.context.settings.timeoutMs / 1000} s.`);
        switch (what.kind) {
            case "startTask":
                return this.tasks.onDue(id);
            case "startRun":
                return this.runs.onDue(id);
            case "resumeLease":
                return this.leases.onResumeDue(id);
            case "askAfterRuns":
                return this.runs.onAskAfterDue(id);
            case "askAfterTasks":
                return this.tasks.onAskAfterDue(id);
            case "release":
                this.requests.take("release", id);
                return what.done(late);
            default:
                this.requests.settle(what.kind, id, late);
        }
    }
    /** The server has been silent for too long. */
    get serverSilent(): boolean {
        return this.context.now() >= this.server.deadline;
    }
}
