// SPDX-License-Identifier: GPL-2.0-or-later
import type * as proto from "../../gen/messages.js";
import { Refusal } from "../refusal.js";
import { type Connection, type Header, type Lane, NO_LEASE, type StopCause } from "../transport.js";
import type { Receipt } from "../types.js";
import { decode } from "../wire/codec.js";
import { safeNumber, stateOf, toRefusal } from "../wire/content.js";
import type { Context } from "./context.js";
import { NameIndex } from "./name_index.js";

/** When a stop that is not confirmed is sent again, on both lanes. */
const FIRST_RESEND_MS = 100;
const RESEND_PERIOD_MS = 250;
/** While receipts of it come it waits for FIRST_RESEND_MS without one, and no longer than this. */
const PATIENCE_MS = 1000;
const LISTED_AT_ONCE = 4096; // half of what a server takes
/** Progress of more entities than these is told at most once in a while, because each time all of them are told. */
const TOLD_AT_ONCE = 16;
const TOLD_EVERY_MS = 20;

// Of axon.proto.StopReceipt.Stage and Absence.
const SERVER = 1;
const MANAGER = 2;
const CALLBACK_RETURNED = 3;
const STANDSTILL = 4;
const NO_APPLICATION = 5;
const ABSENCE_NONE = 1;
const ABSENCE_SILENT = 2;

type Open = { -readonly [Key in keyof Omit<Receipt, "confirmed" | "atRest">]: Receipt[Key] };
const confirmed = (one: Open): boolean => one.managerMs !== undefined && (one.callbackReturnedMs !== undefined || one.noApplication);
const atRest = (one: Open): boolean => confirmed(one) && (one.standstillMs !== undefined || !one.standstillFollows);
const shown = (one: Open): Receipt => ({ ...one, confirmed: confirmed(one), atRest: atRest(one) });

export type StopDone = (result: readonly Receipt[] | Refusal) => void;
interface Order {
    readonly sequence: number;
    readonly cause: StopCause;
    readonly everything: boolean;
    /** Sent again while it is not confirmed. */
    readonly repeats: boolean;
    readonly given: number;
    readonly restsBy: number;
    deadline: number;
    resend: number;
    /** The newest receipt. */
    heardAt: number;
    readonly receipts: Map<string, Open>;
    /** How many of these are confirmed, and how many of those at rest: nobody counts them again for each receipt. */
    confirmed: number;
    atRest: number;
    /** News that onProgress has not been told yet: when it will be. */
    tellAt: number;
    toldAt: number;
    /** On the Entity Manager's clock: the newest receipt. */
    readonly saidAt: Map<string, bigint>;
    /** Entities that a stop of everything has reached. */
    reached: number | undefined;
    acceptedMs: number | undefined;
    /** Of a name that was not found. */
    unknown: Refusal | undefined;
    readonly done: StopDone;
    readonly onProgress: ((receipts: readonly Receipt[]) => void) | undefined;
}

/** The UUID in the id of a session, which may be `name:start:uuid`. */
const uuidIn = (id: string): string => id.slice(id.lastIndexOf(":") + 1);

/**
 * Gives stops and collects their receipts. An order is *open* until every receipt is confirmed or its deadline has passed; then
 * `done` is called, once, with what is known. While it is open it is sent again, with the same number (an Entity Manager takes it
 * for the same stop), on both lanes. Losing the connection does not end an order: it is sent again over the next one.
 */
export class StopDesk {
    private readonly orders = new Map<number, Order>();
    private readonly names = new NameIndex();
    private link: Connection | undefined;
    private self = "";

    constructor(private readonly context: Context) {}

    onConnected(link: Connection): void {
        this.link = link;
        this.self = link.facts.me.id;
        for (const order of this.orders.values()) if (order.repeats) order.resend = this.context.now();
    }
    onDisconnected(): void {
        this.link = undefined;
        this.names.clear();
    }
    onEntity(left: boolean, id: string, name: string, ready: boolean): void {
        if (left) return this.names.remove(id);
        this.names.put(id, name, ready);
        for (const order of this.orders.values()) if (order.everything) this.add(order, id);
    }

    /**
     * No names = every entity there is. In doubt it stops: an ambiguous name stops all that it may mean, and a name that is not
     * found does not hold up the others (its refusal is the answer, when they are done). A stop of everything needs no names: it
     * is done when the servers have said how many entities it reached and as many have answered, known here or not.
     */
    stop(names: readonly string[] | undefined, deadlineMs: number, standstillMs: number, done: StopDone, onProgress?: Order["onProgress"]): void {
        if (this.link === undefined) {
            throw new Refusal(
                "NOT_CONNECTED",
                "There is no connection to the server, so no stop can be sent. What this client held is being stopped by the server's own watchdog; for the rest use the robot's own stop.",
            );
        }
        this.give(names, "requested", deadlineMs, standstillMs, done, onProgress);
    }
    /** Acknowledged by the Entity Interfacer, and nothing else; sent once, so that its times are those of one message. */
    drill(names: readonly string[] | undefined, deadlineMs: number, done: StopDone): void {
        if (this.link === undefined) throw new Refusal("NOT_CONNECTED", "There is no connection to the server.");
        this.give(names ?? this.names.ids(), "drill", deadlineMs, 0, done, undefined);
    }
    private give(names: readonly string[] | undefined, cause: StopCause, deadlineMs: number, standstillMs: number, done: StopDone, onProgress: Order["onProgress"]): void {
        const now = this.context.now();
        const ids = new Set<string>();
        let unknown: Refusal | undefined;
        for (const name of names ?? []) {
            try {
                for (const id of this.names.resolveAll(name)) ids.add(id);
            } catch (error) {
                if (!(error instanceof Refusal)) throw error;
                unknown = error;
            }
        }
        if (unknown !== undefined && ids.size > 0) unknown = unknown.saying(`${unknown.message} The others were ${cause === "drill" ? "drilled" : "stopped"}.`);
        const order = this.order(this.context.marks.nextSequence(), cause, names === undefined, cause === "requested", now + deadlineMs, now + standstillMs, done, onProgress);
        order.unknown = unknown;
        if (order.repeats) order.resend = now + FIRST_RESEND_MS;
        this.send(order, "signal", [...ids], false); // first of all
        for (const id of order.everything ? this.names.ids() : ids) this.add(order, id);
        this.finishIfSettled(order);
    }
    /** The receipts of a reset or clear that somebody else sends under this number, once and after this call. */
    await(entity: string, sequence: number, deadlineMs: number, done: StopDone): void {
        const now = this.context.now();
        this.add(this.order(sequence, "requested", false, false, now + deadlineMs, now, done, undefined), entity);
    }
    /** It is not sent after all; `done` is not called. */
    withdraw(sequence: number): void {
        this.orders.delete(sequence);
    }
    private order(sequence: number, cause: StopCause, everything: boolean, repeats: boolean, deadline: number, restsBy: number, done: StopDone, onProgress: Order["onProgress"]): Order {
        const given = this.context.now();
        const order: Order = {
            sequence,
            cause,
            everything,
            repeats,
            given,
            restsBy,
            deadline,
            resend: Infinity,
            heardAt: given,
            receipts: new Map(),
            confirmed: 0,
            atRest: 0,
            tellAt: Infinity,
            toldAt: -Infinity,
            saidAt: new Map(),
            reached: undefined,
            acceptedMs: undefined,
            unknown: undefined,
            done,
            onProgress,
        };
        this.orders.set(sequence, order);
        return order;
    }
    private add(order: Order, entity: string): Open {
        let receipt = order.receipts.get(entity);
        if (receipt === undefined) {
            receipt = {
                entity,
                name: "",
                stopGeneration: this.context.marks.of(entity),
                state: "UNAV",
                serverMs: order.acceptedMs,
                managerMs: undefined,
                callbackReturnedMs: undefined,
                standstillMs: undefined,
                noApplication: false,
                applicationLost: "",
                applicationLostForMs: undefined,
                fault: "",
                standstillFollows: false,
                tasksEnded: 0,
                tasksRemoved: 0,
            };
            order.receipts.set(entity, receipt);
        }
        const label = this.names.label(entity);
        if (label !== entity || receipt.name === "") receipt.name = label; // of one that has left it is the last name known
        return receipt;
    }
    private send(order: Order, lane: Lane, ids: readonly string[], again: boolean): void {
        const head = (entity: string): Header => ({
            entity,
            msgType: "STOP",
            held: NO_LEASE,
            // Who knows the generation that the stop itself has raised means another one by its number.
            stopGeneration: entity === "" || again ? 0 : this.context.marks.of(entity),
            seq: order.sequence,
            sentAtUs: Math.round(this.context.now() * 1000),
        });
        if (ids.length === 0) {
            // One request, fanned out by the servers.
            if (order.everything) this.link?.stop(lane, head(""), order.cause);
        } else if (ids.length === 1) {
            this.link?.stop(lane, head(ids[0] as string), order.cause);
        } else {
            for (let at = 0; at < ids.length; at += LISTED_AT_ONCE) this.link?.stopSeveral(lane, head(""), ids.slice(at, at + LISTED_AT_ONCE), order.cause);
        }
    }

    onStopAccepted(sequence: number, entity: string, entities: number): void {
        const order = this.orders.get(sequence);
        if (order === undefined) return;
        const after = this.context.now() - order.given;
        const all = (): void => {
            for (const receipt of order.receipts.values()) receipt.serverMs ??= after;
        };
        if (order.everything) {
            order.reached = Math.max(order.reached ?? 0, entities);
            // When it reached fewer than there are receipts, nobody says which: their own answers must show it.
            if (entities > 0 && entities >= order.receipts.size) {
                order.acceptedMs ??= after;
                all();
            }
        } else if (entity === "") {
            // Fewer than were named: which ones are not there is told by their refusals, and the rest by receipts.
            if (entities >= order.receipts.size) all();
        } else {
            const receipt = order.receipts.get(entity);
            if (receipt !== undefined && entities > 0) receipt.serverMs ??= after;
        }
        this.tell(order);
        this.finishIfSettled(order);
    }
    /** Whether the message was a receipt. Those of other people's stops raise the generation and nothing else. */
    onReceipt(entity: string, msgType: string, bytes: Uint8Array): boolean {
        if (msgType !== "RECEIPT") return false;
        let incoming: proto.StopReceipt | undefined;
        try {
            incoming = decode("ToClient", bytes).receipt;
        } catch {
            // counted below
        }
        if (incoming === undefined) {
            ++this.context.malformed;
            return true;
        }
        this.context.marks.raise(entity, incoming.stopGeneration);
        const order = this.orders.get(this.mine(incoming.stopId) ?? -1);
        if (order === undefined || (!order.everything && !order.receipts.has(entity))) return true;
        const now = this.context.now();
        order.heardAt = now;
        const receipt = this.add(order, entity);
        const before = [Number(confirmed(receipt)), Number(atRest(receipt))] as const;
        this.take(order, receipt, incoming, now - order.given);
        order.confirmed += Number(confirmed(receipt)) - before[0];
        order.atRest += Number(atRest(receipt)) - before[1];
        this.tell(order);
        this.finishIfSettled(order);
        return true;
    }
    private take(order: Order, receipt: Open, incoming: proto.StopReceipt, after: number): void {
        receipt.stopGeneration = Math.max(receipt.stopGeneration, incoming.stopGeneration);
        // The other copy of an earlier one may come after a later one (several servers: directly, and by the topic).
        if (incoming.atUs >= (order.saidAt.get(receipt.entity) ?? -1n)) {
            order.saidAt.set(receipt.entity, incoming.atUs);
            const lost = incoming.absence > ABSENCE_NONE;
            receipt.state = stateOf(incoming.state) ?? receipt.state;
            receipt.fault = incoming.fault;
            receipt.applicationLost = !lost
                ? ""
                : incoming.absenceReason !== ""
                  ? incoming.absenceReason
                  : incoming.absence === ABSENCE_SILENT
                    ? "the robot application is silent"
                    : "the robot application has gone without a good-bye";
            receipt.applicationLostForMs = lost ? safeNumber(incoming.absentForMs) : undefined;
            receipt.standstillFollows = incoming.standstillFollows;
            receipt.tasksEnded = incoming.tasksEnded;
            receipt.tasksRemoved = incoming.tasksRemoved;
        }
        switch (incoming.stage) {
            case SERVER:
                receipt.serverMs ??= after;
                break;
            case MANAGER:
                receipt.managerMs ??= after;
                break;
            case NO_APPLICATION:
                receipt.managerMs ??= after;
                if (incoming.absence <= ABSENCE_NONE) receipt.noApplication = true;
                break;
            case STANDSTILL: // an application that stands still has returned from its callback
                receipt.standstillMs ??= after;
                receipt.callbackReturnedMs ??= after;
                receipt.managerMs ??= after;
                break;
            case CALLBACK_RETURNED:
                receipt.callbackReturnedMs ??= after;
                receipt.managerMs ??= after;
                break;
            default:
                break;
        }
    }
    /** The number in a stop_id "ID:SEQ" of this session. */
    private mine(stopId: string): number | undefined {
        const colon = stopId.lastIndexOf(":");
        const digits = stopId.slice(colon + 1);
        return colon > 0 && /^\d{1,16}$/.test(digits) && uuidIn(stopId.slice(0, colon)) === uuidIn(this.self) ? Number(digits) : undefined;
    }
    /** A reply of the entity itself to a reset or clear: refused. */
    onReply(entity: string, bytes: Uint8Array): void {
        let reply: proto.Reply | undefined;
        try {
            reply = decode("ToClient", bytes).reply;
        } catch {
            return; // the core counts it
        }
        const refusal = toRefusal(reply?.refusal);
        const sequence = this.mine(new TextDecoder().decode(reply?.requestId));
        if (refusal !== undefined && sequence !== undefined) this.onRefusal(sequence, entity, refusal);
    }
    /** The servers do not, or no longer, know such an entity, or have no room for the message. */
    onRefusal(sequence: number, entity: string, refusal: Refusal): void {
        const order = this.orders.get(sequence);
        if (order === undefined) return;
        if (order.repeats && refusal.code === "OVERLOADED") return; // the next one may be taken
        // With several entities the others may still answer: the one that is gone stays without times.
        if (order.receipts.size > 1 && entity !== "") return;
        this.orders.delete(sequence);
        order.done(refusal);
    }

    private allKnown(order: Order): boolean {
        return order.reached !== undefined && order.receipts.size >= order.reached;
    }
    private finishIfSettled(order: Order): void {
        if (order.confirmed < order.receipts.size || (order.everything && !this.allKnown(order))) return;
        if (order.atRest < order.receipts.size && this.context.now() < order.restsBy) return;
        this.finish(order);
    }
    private finish(order: Order): void {
        if (Number.isFinite(order.tellAt)) this.tellNow(order);
        if (!this.orders.delete(order.sequence)) return;
        order.done(order.unknown ?? this.receiptsOf(order));
    }
    private receiptsOf(order: Order): Receipt[] {
        const all = [...order.receipts.values()].sort((a, b) => (a.entity < b.entity ? -1 : 1)).map(shown);
        // Reached, and never heard of: not to be taken for stopped.
        const silent = Math.min((order.reached ?? 0) - all.length, 65_536);
        for (let i = 0; i < silent; ++i) {
            const one = this.add({ ...order, receipts: new Map() }, "");
            all.push(shown({ ...one, name: "(an entity that has not answered)" }));
        }
        return all;
    }
    private tell(order: Order): void {
        if (order.onProgress === undefined || !this.orders.has(order.sequence)) return;
        const now = this.context.now();
        if (order.receipts.size <= TOLD_AT_ONCE || now >= order.toldAt + TOLD_EVERY_MS) this.tellNow(order);
        else order.tellAt = Math.min(order.tellAt, order.toldAt + TOLD_EVERY_MS);
    }
    private tellNow(order: Order): void {
        order.tellAt = Infinity;
        order.toldAt = this.context.now();
        order.onProgress?.([...order.receipts.values()].map(shown));
    }

    nextDeadline(): number {
        let next = Infinity;
        for (const { deadline, resend, tellAt } of this.orders.values()) next = Math.min(next, deadline, resend, tellAt);
        return next;
    }
    onTimer(): void {
        const now = this.context.now();
        for (const order of [...this.orders.values()]) if (this.orders.has(order.sequence)) this.onDue(order, now);
    }
    private onDue(order: Order, now: number): void {
        if (now >= order.tellAt) this.tellNow(order);
        if (now >= order.deadline) {
            const { size } = order.receipts;
            const comesToRest = order.confirmed === size && order.atRest < size && now < order.restsBy;
            if (!comesToRest) return this.finish(order);
            order.deadline = order.restsBy;
        }
        if (now < order.resend) return;
        const quiet = Math.min(order.heardAt + FIRST_RESEND_MS, order.given + PATIENCE_MS);
        if (now < quiet) {
            order.resend = quiet;
            return;
        }
        order.resend = now + RESEND_PERIOD_MS;
        if (this.link === undefined) return;
        // Of everything only those that are missing, once all that it has reached are known.
        let ids: string[] = [];
        if (!order.everything || this.allKnown(order)) {
            ids = [...order.receipts.values()].filter((one) => !confirmed(one)).map(({ entity }) => entity);
            if (ids.length === 0) return; // they come to rest
        }
        this.send(order, "signal", ids, true);
        if (this.link.signalLane === "own") this.send(order, "data", ids, true);
    }
    /** Ends every open order with what is known: the client is being closed. */
    endOrders(): void {
        for (const order of [...this.orders.values()]) this.finish(order);
    }
}
