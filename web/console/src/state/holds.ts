// SPDX-License-Identifier: GPL-2.0-or-later
// What this page holds, and what it does with it.
import { type Argument, type CheckOut, type CheckOutOptions, type Client, type Entity, type HandOverRequest, isFinalTask, type Refusal, type Resource, type Service, type Task, type TaskReport } from "@axon/client";
import { type Signal, signal } from "@preact/signals";
import { formatValues } from "../words/format";
import { canMove, plainTask, sentence } from "../words/words";
import { entities } from "./entities";
import { asRefusal, note, refused, say } from "./journal";

const TICKETS = "axon-tickets";
const TASKS_KEPT = 30;
const TEXTS_KEPT = 200;
/** Progress may come a hundred times in a second; nobody reads that fast, and drawing it takes time from the heartbeats. */
const SHOW_MS = 100;
function seldom(ms: number, act: () => void): () => void {
    let waits = false;
    return () => {
        if (waits) return;
        waits = true;
        setTimeout(() => {
            waits = false;
            act();
        }, ms);
    };
}

export interface Job {
    readonly task: Task;
    readonly service: string;
    readonly asked: string;
    readonly at: number;
    readonly report: Signal<TaskReport>;
    readonly endedAt: Signal<number | undefined>;
}
export interface Text {
    readonly at: number;
    readonly mine: boolean;
    readonly text: string;
}
export interface Upload {
    readonly service: string;
    readonly resource: string;
    readonly file: string;
    readonly sent: number;
    readonly total: number;
    /** In hexadecimal digits; empty = not known yet. */
    readonly sha256: string;
    readonly state: "sending" | "done" | "failed";
    readonly why: string;
    readonly abort: AbortController;
}

/** An entity that this page holds. It stays here, with its tasks, until another check-out of the same entity. */
export class Hold {
    readonly id: string;
    readonly services: Signal<readonly Service[]>;
    readonly orphaned = signal(false);
    readonly question = signal<HandOverRequest | undefined>(undefined);
    readonly askedAt = signal(0);
    readonly jobs = signal<readonly Job[]>([]);
    readonly texts = signal<readonly Text[]>([]);
    readonly uploads = signal<ReadonlyMap<string, Upload>>(new Map());
    readonly lost = signal<Refusal | undefined>(undefined);

    constructor(readonly checkOut: CheckOut) {
        this.id = this.entity.id;
        this.services = signal(checkOut.services());
        checkOut.onLost((why) => {
            this.lost.value = why;
            leave(this);
            note("who", this.entity, `was taken from this page: ${sentence(why.message)}`, why);
            say("bad", `You no longer have ${this.entity.name}.`, sentence(why.message), this.id);
        });
        checkOut.onOrphaned((reason) => {
            this.orphaned.value = true;
            note("who", this.entity, `this page has lost it for the moment: ${reason}`);
        });
        checkOut.onResumed(() => {
            this.orphaned.value = false;
            this.services.value = checkOut.services();
            note("who", this.entity, "is this page's again");
            say("wait", `You have ${this.entity.name} again.`, this.entity.latched ? "It was stopped meanwhile. Rearm it when it is safe to move." : "", this.id);
        });
        checkOut.onServiceChanged(() => (this.services.value = checkOut.services()));
        checkOut.onText((text) => {
            this.texts.value = [...this.texts.value, { at: Date.now(), mine: false, text }].slice(-TEXTS_KEPT);
            note("message", this.entity, text);
        });
        checkOut.onHandOverRequest((request) => {
            this.question.value = request.withdrawn ? undefined : request;
            this.askedAt.value = Date.now();
            if (!request.withdrawn) note("who", this.entity, `${request.by} asks for it${request.reason === "" ? "" : `: ${request.reason}`}`);
        });
    }
    get entity(): Entity {
        return this.checkOut.entity();
    }
    get busy(): boolean {
        return this.jobs.value.some(({ report }) => !isFinalTask(report.value.state));
    }

    run(service: Service, args: readonly Argument[]): void {
        try {
            const task = this.checkOut.run(service.name, args);
            const report = signal(task.report());
            const endedAt = signal<number | undefined>(undefined);
            const asked = args.map(({ name, values }) => `${name} ${formatValues(values)}`).join(", ");
            this.jobs.value = [{ task, service: service.name, asked, at: Date.now(), report, endedAt }, ...this.jobs.value].slice(0, TASKS_KEPT);
            note("task", this.entity, `${service.name} was asked for${asked === "" ? "" : `: ${asked}`}`);
            let state = "";
            const show = seldom(SHOW_MS, () => (report.value = task.report()));
            task.onUpdate((its) => {
                if (its.state === state) return show();
                state = its.state;
                report.value = its;
                if (!isFinalTask(its.state)) return;
                endedAt.value = Date.now();
                const results = [...its.results].map(([name, values]) => `${name} ${formatValues(values)}`).join(", ");
                note(its.state === "REFUSED" ? "refusal" : "task", this.entity, `${service.name} ${plainTask(its.state).short}${its.reason === undefined ? "" : `: ${sentence(its.reason.message)}`}${results === "" ? "" : ` (${results})`}`, its.reason);
            });
        } catch (error) {
            refused(`${service.name} was not begun`, error, this.entity);
        }
    }
    async set(service: string, argument: Argument): Promise<boolean> {
        try {
            await this.checkOut.set(service, argument);
            this.services.value = this.checkOut.services();
            note("task", this.entity, `${service}: ${argument.name} is now ${formatValues(argument.values)}`);
            return true;
        } catch (error) {
            refused(`${argument.name} was not changed`, error, this.entity);
            return false;
        }
    }
    async upload(service: string, resource: Resource, file: File): Promise<void> {
        const key = `${service}\n${resource.name}`;
        const abort = new AbortController();
        const put = (more: Partial<Upload>): void => {
            const before = this.uploads.value.get(key);
            const all = new Map(this.uploads.value);
            all.set(key, { service, resource: resource.name, file: file.name, sent: 0, total: file.size, sha256: "", state: "sending", why: "", abort, ...(before?.abort === abort ? before : {}), ...more });
            this.uploads.value = all;
        };
        put({});
        try {
            await this.checkOut.upload(service, resource.name, file, { signal: abort.signal, onHash: (sum) => put({ sha256: [...sum].map((byte) => byte.toString(16).padStart(2, "0")).join("") }), onProgress: (sent, total) => put({ sent, total }) });
            put({ state: "done", sent: file.size });
            this.services.value = this.checkOut.services();
            note("task", this.entity, `${file.name} was uploaded as ${resource.name}`);
        } catch (error) {
            const why = refused(`${file.name} was not uploaded`, error, this.entity);
            put({ state: "failed", why: sentence(why.message) });
        }
    }
    sendText(text: string): void {
        try {
            this.checkOut.sendText(text);
            this.texts.value = [...this.texts.value, { at: Date.now(), mine: true, text }].slice(-TEXTS_KEPT);
        } catch (error) {
            refused("The message was not sent", error, this.entity);
        }
    }
    answer(accept: boolean): void {
        try {
            this.checkOut.answerHandOver(accept, accept ? "" : "still needed");
        } catch (error) {
            refused("The answer was not sent", error, this.entity);
        }
        this.question.value = undefined;
    }
    async release(): Promise<void> {
        try {
            await this.checkOut.release();
            note("who", this.entity, "was released by this page");
        } catch (error) {
            refused(`${this.entity.name} was not released properly`, error, this.entity);
        }
        leave(this);
    }
}

/** By UUID. */
export const holds = signal<ReadonlyMap<string, Hold>>(new Map());
/** Also those that are gone: their tasks are still worth reading. */
export const lastHolds = signal<ReadonlyMap<string, Hold>>(new Map());

function adopt(checkOut: CheckOut): Hold {
    const hold = new Hold(checkOut);
    const old = lastHolds.value.get(hold.id);
    if (old !== undefined) {
        hold.jobs.value = old.jobs.value;
        hold.texts.value = old.texts.value;
    }
    holds.value = new Map(holds.value).set(hold.id, hold);
    lastHolds.value = new Map(lastHolds.value).set(hold.id, hold);
    return hold;
}
function leave(hold: Hold): void {
    if (holds.value.get(hold.id) !== hold) return;
    const all = new Map(holds.value);
    all.delete(hold.id);
    holds.value = all;
}
export function abandon(): void {
    holds.value = new Map();
    lastHolds.value = new Map();
    for (const { abort } of pending.value.values()) abort.abort();
}

/** A check-out that waits for an answer. */
export interface Pending {
    readonly how: "take" | "wait" | "ask";
    /** The holder has been asked and has not answered. */
    readonly asking: boolean;
    readonly place: number;
    readonly message: string;
    readonly abort: AbortController;
}
export const pending = signal<ReadonlyMap<string, Pending>>(new Map());

export async function checkOut(client: Client, entity: Entity, how: Pending["how"] | "force", reason = ""): Promise<Hold | undefined> {
    const abort = new AbortController();
    const put = (one: Pending | undefined): void => {
        const all = new Map(pending.value);
        if (one === undefined) all.delete(entity.id);
        else all.set(entity.id, one);
        pending.value = all;
    };
    const kind = how === "force" ? "take" : how;
    // The first news of a question is that it was asked, the next one its answer.
    let news = 0;
    put({ how: kind, asking: how === "ask", place: 0, message: "", abort });
    const options: CheckOutOptions = {
        signal: abort.signal,
        reason,
        ask: how === "ask",
        force: how === "force",
        ...(how === "wait" || how === "ask" ? { waitMs: 3_600_000 } : {}),
        onWaiting: ({ place, message }) => put({ how: kind, asking: how === "ask" && ++news === 1, place, message, abort }),
    };
    try {
        const hold = adopt(await client.checkOut(entity.id, options));
        say("good", `${entity.name} is yours.`, hold.entity.latched ? "It was stopped earlier: rearm it before its first task." : "", entity.id);
        return hold;
    } catch (error) {
        refused(`${entity.name} is not yours`, error, entity);
        return undefined;
    } finally {
        put(undefined);
    }
}

export async function rearm(client: Client, entity: Entity): Promise<void> {
    try {
        await client.rearm(entity.id);
        say("good", `${entity.name} is rearmed.`, "It does nothing by itself; the next task may move it.", entity.id);
    } catch (error) {
        refused(`${entity.name} was not rearmed`, error, entity);
    }
}

/**
 * A page that is loaded again is another client for the server. It gets what it held by the tickets that it left behind when it
 * went; a second tab, which may be a copy of this one, finds none.
 */
addEventListener("pagehide", () => {
    const tickets = [...holds.value.values()].flatMap((hold) => {
        try {
            return [hold.checkOut.ticket()];
        } catch {
            return []; // of an entity that gives no key
        }
    });
    if (tickets.length > 0) sessionStorage.setItem(TICKETS, JSON.stringify({ user: owner, tickets }));
});
let owner = "";
/** No tickets, if it is not what the listener above has left: other pages of this address may write there, too. */
function readTickets(text: string): { readonly user: string; readonly tickets: readonly string[] } {
    const nothing = { user: owner, tickets: [] };
    try {
        const left = JSON.parse(text) as { user?: unknown; tickets?: unknown } | null;
        const fits = typeof left?.user === "string" && Array.isArray(left.tickets) && left.tickets.every((one) => typeof one === "string");
        return fits ? (left as { user: string; tickets: string[] }) : nothing;
    } catch {
        return nothing;
    }
}
export async function resumeHolds(client: Client, user: string): Promise<void> {
    owner = user;
    const text = sessionStorage.getItem(TICKETS);
    sessionStorage.removeItem(TICKETS);
    if (text === null) return;
    const left = readTickets(text);
    if (left.user !== user) {
        note("who", undefined, "what this page held before it was loaded again was another user's, and is not resumed");
        return;
    }
    for (const ticket of left.tickets) {
        try {
            const hold = adopt(await client.resume(ticket));
            note("who", hold.entity, "is this page's again");
            say("wait", `You still have ${hold.entity.name}.`, "It was stopped when the page was loaded again. Rearm it when it is safe to move.", hold.id);
        } catch (error) {
            const why = asRefusal(error);
            note("refusal", undefined, `what this page held before it was loaded again is gone: ${sentence(why.message)}`, why);
        }
    }
}

/** Held entities that move, or are about to, unless their task is allowed to go on without its client. */
export function moving(): { readonly id: string; readonly name: string }[] {
    return [...holds.value.values()].flatMap((hold) => {
        const { id, name } = hold.entity;
        if (!hold.busy && !canMove(entities.peek().get(id)?.entity ?? hold.entity)) return [];
        const open = hold.jobs.peek().filter(({ report }) => !isFinalTask(report.peek().state));
        const spared = open.length > 0 && open.every(({ service }) => hold.services.peek().find((one) => one.name === service)?.onClientLoss === "finish");
        return spared ? [] : [{ id, name }];
    });
}
let stopper: (ids: readonly string[]) => void = () => undefined;
/** Who stops, when nobody watches; see stops.ts. */
export function onUnseen(stop: (ids: readonly string[]) => void): void {
    stopper = stop;
}
export function stopUnseen(): void {
    stopper(moving().map(({ id }) => id));
}
