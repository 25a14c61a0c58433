// SPDX-License-Identifier: GPL-2.0-or-later
import type * as proto from "../../gen/messages.js";
import { fromHex, hex, type Id, idOf } from "../ids.js";
import { Refusal } from "../refusal.js";
import { NO_LEASE } from "../transport.js";
import type { Argument } from "../types.js";
import { safeNumber } from "../wire/content.js";
import { findResource, toParam } from "../wire/values.js";
import { Context, type Done, type Held, type Parts } from "./context.js";
import { isFull, overloaded } from "./tasks.js";

export const CHUNK_MAX = 64 * 1024;

/** Parameters, texts, raw data, resources, reset, clear, rearm. All of them throw what can be said at once. */
export class Commands {
    constructor(private readonly parts: Parts) {}

    set(held: Held, service: string, argument: Argument, done: Done): void {
        this.parts.leases.ready(held);
        const chosen = this.parts.leases.service(held, service);
        const param = toParam(chosen, argument);
        const request = this.parts.context.random(16);
        const sequence = this.parts.context.send(held.entity, "PARAM", held.lease, { setParam: { service: chosen.name, param, requestId: request } });
        this.parts.requests.await(hex(request), { kind: "confirmed", done }, { ...held, sequence });
    }
    private admit(held: Held): void {
        this.parts.leases.ready(held);
        if (isFull(this.parts.context.link?.backlog() ?? { messages: 0, bytes: 0 })) throw overloaded();
    }
    sendText(held: Held, text: string): void {
        this.admit(held);
        this.parts.context.send(held.entity, "TEXT", held.lease, { text: { text } });
    }
    sendRaw(held: Held, bytes: Uint8Array): void {
        this.admit(held);
        const message = this.parts.context.encoded({ raw: { data: [bytes] } });
        this.parts.context.link?.toEntityDroppable(this.parts.context.header(held.entity, "RAW", held.lease), message);
    }
    /** The receipts of both are for StopDesk. */
    reset(held: Held, sequence: number): void {
        this.parts.leases.ready(held);
        if (this.parts.entities.facts(held.entity)?.latched === true) throw new Refusal("LATCHED", `${this.parts.entities.label(held.entity)} was stopped. Rearm it first.`);
        this.parts.context.link?.reset(this.parts.context.header(held.entity, "RESET", held.lease, sequence));
    }
    clear(held: Held, sequence: number): void {
        this.parts.leases.ready(held);
        this.parts.context.link?.clear(this.parts.context.header(held.entity, "CLEAR", held.lease, sequence));
    }
    rearm(entity: string, done: Done): void {
        if (!this.parts.context.connected) throw Context.notConnected();
        this.parts.entities.there(entity);
        const lease = this.parts.leases.of(entity)?.number ?? NO_LEASE;
        const request = this.parts.context.random(16);
        const sequence = this.parts.context.send(entity, "REARM", lease, { rearm: { requestId: request } });
        this.parts.requests.await(hex(request), { kind: "confirmed", done }, { entity, lease, sequence });
    }

    offer(held: Held, service: string, resource: string, file: { name: string; size: number; sha256: Uint8Array }, done: Done): Id {
        this.parts.leases.ready(held);
        const chosen = this.parts.leases.service(held, service);
        const transfer = this.parts.context.random(16);
        const sequence = this.parts.context.send(held.entity, "RESOURCE", held.lease, {
            resourceOffer: {
                transferId: transfer,
                service: chosen.name,
                resource: findResource(chosen, resource).name,
                fileName: file.name,
                size: BigInt(file.size),
                sha256: file.sha256,
            },
        });
        this.parts.requests.await(hex(transfer), { kind: "upload", done }, { ...held, sequence });
        return hex(transfer);
    }
    /** False if the transfer has ended. */
    sendChunk(transfer: Id, offset: number, content: Uint8Array): boolean {
        const upload = this.parts.requests.find("upload", transfer);
        if (upload === undefined) return false;
        // Not among the data that servers may drop: the window keeps it small enough to be kept.
        this.parts.context.send(upload.entity, "RESOURCE", upload.lease, { resourceChunk: { transferId: fromHex(transfer), offset: BigInt(offset), content } });
        return true;
    }
    endUpload(transfer: Id, why: Refusal): void {
        this.parts.requests.settle("upload", transfer, why);
    }
    onCredit(credit: proto.ResourceCredit): void {
        const transfer = idOf(credit.transferId);
        const upload = transfer === undefined ? undefined : this.parts.requests.find("upload", transfer);
        if (transfer === undefined || upload === undefined) return;
        upload.deadline = this.parts.context.now() + this.parts.context.settings.timeoutMs; // it is not forgotten
        const from = safeNumber(credit.offset);
        if (credit.window > 0n) this.parts.context.observer.credit(transfer, from, from + safeNumber(credit.window));
    }
}
