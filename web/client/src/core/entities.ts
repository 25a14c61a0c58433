// SPDX-License-Identifier: GPL-2.0-or-later
import type * as proto from "../../gen/messages.js";
import { hex, idOf } from "../ids.js";
import { Refusal } from "../refusal.js";
import { NO_LEASE, type Registration, type Status } from "../transport.js";
import type { Availability, Details, Entity, EntityState, Presence, Sender } from "../types.js";
import { decode } from "../wire/codec.js";
import { stateOf, toDetails } from "../wire/content.js";
import { Context, type Done, type Parts } from "./context.js";
import { NameIndex } from "./name_index.js";

/** More than a server admits; what it tells beyond it is left out. */
const ENTITIES_MAX = 65_536;

export function availabilityOf(state: EntityState): Availability {
    switch (state) {
        case "IDLE":
        case "REG":
            return "ready";
        case "COLLAB":
        case "SLAVE":
        case "BUSY":
            return "working";
        default:
            return "away";
    }
}

type Facts = { -readonly [Key in keyof Entity]: Entity[Key] };
interface Known {
    readonly facts: Facts;
    announced: boolean;
    /** Its status has come. */
    heard: boolean;
    /** By the server; `facts` may be newer, by the entity itself. */
    told: EntityState;
}
const there = (known: Known): boolean => known.announced && known.heard;

/**
 * The entities that the server has reported, and which of those that this client holds are moving. An entity is *there* once its
 * profile and its status have come, whichever was first. All are forgotten when the connection is lost.
 */
export class Entities {
    private readonly names = new NameIndex();
    private known = new Map<string, Known>();
    private promised = 0;
    private present = 0;
    /** For a check-out, in this session. */
    private readonly asked = new Set<string>();
    /** Held, and BUSY or driven otherwise. */
    private readonly moving = new Set<string>();
    /** Of those the BUSY ones that the server takes for this client's. */
    private readonly busy = new Set<string>();

    constructor(private readonly parts: Parts) {}

    connected(promised: number): void {
        this.asked.clear();
        this.promised = promised;
    }
    disconnected(): void {
        const gone = this.known;
        this.known = new Map();
        this.names.clear();
        this.present = 0;
        this.promised = 0;
        this.moving.clear();
        this.busy.clear();
        this.parts.context.marks.forgetAll();
        for (const one of gone.values()) if (there(one) && one.facts.ready) this.tell("left", one, true);
    }
    onProfile(registration: Registration, profile: Uint8Array): void {
        let basic: proto.BasicProfile | undefined;
        try {
            basic = decode("BasicProfile", profile);
        } catch {
            ++this.parts.context.malformed; // the registration alone is enough to show it
        }
        const one = this.knownOf(registration.entity);
        if (one === undefined) return;
        const { facts } = one;
        const wasThere = there(one);
        const wasTold = wasThere && facts.ready;
        one.announced = true;
        facts.name = registration.name;
        facts.category = registration.category;
        facts.type = registration.type;
        facts.descr = basic?.descr ?? "";
        facts.xMm = basic?.xpos ?? 0;
        facts.yMm = basic?.ypos ?? 0;
        facts.zMm = basic?.zpos ?? 0;
        facts.ready = profile.length > 0;
        if (!there(one)) return;
        if (!wasThere) return this.join(one);
        this.names.put(facts.id, facts.name, facts.ready);
        if (facts.ready) this.tell(wasTold ? "changed" : "joined", one);
        else if (wasTold) this.tell("left", one);
    }
    /** Whether it is there now and was not before; then the program has been told. */
    onStatus(status: Status): boolean {
        const one = this.knownOf(status.entity);
        if (one === undefined) return false;
        const joins = one.announced && !one.heard;
        one.heard = true;
        const { facts } = one;
        one.told = facts.state = status.state;
        facts.latched = status.latched;
        facts.stopGeneration = Math.max(facts.stopGeneration, status.stopGeneration);
        const nobody = status.holder.id === "" && status.holder.name === "";
        facts.holder = nobody ? undefined : status.holder;
        facts.reason = status.reason;
        facts.orphaned = status.orphaned;
        facts.waiting = status.waiting;
        facts.stopLatencyMs = status.stopLatencyUs > 0 ? status.stopLatencyUs / 1000 : undefined;
        this.countMoving(status.entity);
        if (joins) this.join(one);
        return joins;
    }
    /** What the entity itself says. */
    onOwnStatus(id: string, status: proto.EntityStatus): void {
        const one = this.known.get(id);
        if (one === undefined) return;
        const { facts } = one;
        facts.state = stateOf(status.state) ?? facts.state;
        facts.latched = status.latched;
        facts.stopGeneration = Math.max(facts.stopGeneration, status.stopGeneration);
        facts.reason = status.reason;
        facts.orphaned = status.orphaned;
        facts.waiting = status.waiting;
        this.countMoving(id);
        this.tellChanged(id);
    }
    onLeft(id: string): void {
        const one = this.known.get(id);
        if (one === undefined) return;
        if (there(one)) --this.present;
        this.known.delete(id);
        this.names.remove(id);
        this.parts.context.marks.forget(id);
        this.countMoving(id);
        this.parts.server.pace(); // the server beats slowly again
        if (there(one) && one.facts.ready) this.tell("left", one);
    }
    onGranted(id: string, stopGeneration: number, latched: boolean): void {
        const one = this.knownOf(id);
        if (one === undefined) return;
        one.facts.stopGeneration = stopGeneration;
        one.facts.latched = latched;
        this.countMoving(id);
    }
    /** This session asks for a check-out of it. */
    onAskedFor(id: string): void {
        if (this.parts.context.self.role === "observer" || this.asked.has(id)) return;
        this.asked.add(id);
        this.countMoving(id);
        this.parts.server.pace();
    }
    /** After each change of its state or its lease. */
    countMoving(id: string): void {
        const one = this.known.get(id);
        // The server goes by what the entity says, of one that this session has asked for: until that has let go of a client
        // that released it, its watchdog is short.
        const named = one !== undefined && this.asked.has(id) && one.facts.holder?.id === this.parts.context.self.id;
        const counts = named || (one !== undefined && this.parts.leases.of(id) !== undefined);
        const keep = (set: Set<string>, member: boolean): void => void (member ? set.add(id) : set.delete(id));
        keep(this.moving, counts && one !== undefined && (availabilityOf(one.facts.state) === "working" || availabilityOf(one.told) === "working"));
        keep(this.busy, named && one.told === "BUSY");
    }
    tellChanged(id: string): void {
        const one = this.known.get(id);
        if (one !== undefined && there(one) && one.facts.ready) this.tell("changed", one);
    }
    private tell(presence: Presence, one: Known, connectionLost = false): void {
        this.parts.context.observer.entity({ presence, entity: { ...one.facts }, connectionLost });
    }
    private knownOf(id: string): Known | undefined {
        const found = this.known.get(id);
        if (found !== undefined || id === "" || this.known.size >= ENTITIES_MAX) return found;
        const one: Known = {
            facts: {
                id,
                ready: false,
                name: "",
                category: "",
                type: "",
                descr: "",
                xMm: 0,
                yMm: 0,
                zMm: 0,
                state: "UNAV",
                latched: false,
                stopGeneration: 0,
                holder: undefined,
                reason: "",
                orphaned: false,
                waiting: 0,
                stopLatencyMs: undefined,
            },
            announced: false,
            heard: false,
            told: "UNAV",
        };
        this.known.set(id, one);
        return one;
    }
    private join(one: Known): void {
        const { id, name, ready } = one.facts;
        ++this.present;
        this.names.put(id, name, ready);
        if (ready) this.tell("joined", one);
        if (!this.parts.context.connected) return;
        this.parts.leases.sendResume(id);
        this.parts.watches.send(id);
    }

    /** Every entity that was promised has been told of. */
    get complete(): boolean {
        return this.present >= this.promised;
    }
    get anyMoving(): boolean {
        return this.moving.size > 0;
    }
    get anyBusyForServer(): boolean {
        return this.busy.size > 0;
    }
    list(all: boolean): Entity[] {
        return this.names.ids().flatMap((id) => {
            const facts = this.known.get(id)?.facts;
            return facts !== undefined && (facts.ready || all) ? [{ ...facts }] : [];
        });
    }
    facts(id: string): Entity | undefined {
        return this.known.get(id)?.facts;
    }
    holderOf(id: string): string {
        return this.facts(id)?.holder?.name ?? "";
    }
    isThere(id: string): boolean {
        const one = this.known.get(id);
        return one !== undefined && there(one);
    }
    /** Throws UNKNOWN_ENTITY. */
    there(id: string): Entity {
        const one = this.known.get(id);
        if (one === undefined || !there(one)) throw new Refusal("UNKNOWN_ENTITY", `The entity ${id} is not connected to the server.`);
        return { ...one.facts };
    }
    resolve(name: string): string {
        return this.names.resolve(name);
    }
    resolveAll(name: string): string[] {
        return this.names.resolveAll(name);
    }
    ids(): string[] {
        return this.names.ids();
    }
    find(name: string): Entity {
        if (!this.parts.context.connected) throw Context.notConnected();
        return this.there(this.names.resolve(name));
    }
    label(id: string): string {
        return this.names.label(id);
    }

    /** Asks the entity itself; no lease is needed. */
    fetchDetails(id: string, answer: (details: Details) => void, done: Done): void {
        if (!this.parts.context.connected) return done(Context.notConnected());
        this.there(id);
        const request = this.parts.context.random(16);
        const sequence = this.parts.context.send(id, "STATUS", NO_LEASE, { statusRequest: { requestId: request, withServices: true } });
        this.parts.requests.await(hex(request), { kind: "details", answer, done }, { entity: id, sequence });
    }
    onDetails(status: proto.EntityStatus): void {
        const request = idOf(status.requestId);
        if (request === undefined) return;
        this.parts.requests.take("details", request)?.what.answer(toDetails(status));
    }
}

export const NOBODY: Sender = { id: "", name: "", role: "observer" };
