// SPDX-License-Identifier: GPL-2.0-or-later
// A clock that stands still until it is told to go on, and a server that does nothing but remember what it was sent.
import type { Messages } from "../../gen/messages.js";
import { Client, type ConnectionEvents, type Connection, type Clock, connect, type Header, type Lane, type Login, type Options, Refusal, type Sender, type Status, type StopCause, type Transport } from "../../dist/index.js";
import { decode, encode, type Init } from "../../dist/wire/codec.js";

/** Lets everything run that waits for nothing but its turn. */
export const settle = async (): Promise<void> => {
    for (let i = 0; i < 20; ++i) await Promise.resolve();
    await new Promise((wake) => setImmediate(wake));
};

export class FakeClock implements Clock {
    private time = 1000;
    private asleep = 1_700_000_000_000;
    private readonly alarms = new Set<{ at: number; ring: () => void }>();
    now(): number {
        return this.time;
    }
    date(): number {
        return this.asleep + this.time;
    }
    /** As when the computer sleeps: only the date goes on. */
    sleep(ms: number): void {
        this.asleep += ms;
    }
    alarm(ring: () => void): { set(at: number): void; end(): void } {
        const one = { at: Infinity, ring };
        this.alarms.add(one);
        return {
            set: (at) => void (one.at = at),
            end: () => void this.alarms.delete(one),
        };
    }
    /** Rings what is due on the way, in order. */
    async advance(ms: number): Promise<void> {
        const end = this.time + ms;
        for (;;) {
            await settle();
            const next = [...this.alarms].sort((a, b) => a.at - b.at)[0];
            if (next === undefined || next.at > end) break;
            this.time = Math.max(this.time, next.at);
            next.at = Infinity;
            next.ring();
        }
        this.time = end;
        await settle();
    }
    /** As when a browser slows timers down: whatever is due rings together, each `every` ms. */
    async advanceThrottled(ms: number, every: number): Promise<void> {
        for (let gone = 0; gone < ms; gone += every) await this.freeze(every);
    }
    /** As when a tab was frozen: time passes, and nothing rings until the end. */
    async freeze(ms: number): Promise<void> {
        this.time += ms;
        await this.advance(0);
    }
}

export type Sent =
    | { readonly what: "message"; readonly droppable: boolean; readonly head: Header; readonly body: Messages["ToEntity"] }
    | { readonly what: "request"; readonly head: Header; readonly body: Messages["ToEntity"] }
    | { readonly what: "stop"; readonly lane: Lane; readonly head: Header; readonly entities: readonly string[]; readonly cause: StopCause }
    | { readonly what: "reset" | "clear"; readonly head: Header }
    | { readonly what: "keepAlive" | "ask" };

export const ME: Sender = { id: "00000000-0000-8000-8000-0000000000aa", name: "me@here", role: "operator" };
export const OTHER: Sender = { id: "00000000-0000-8000-8000-0000000000bb", name: "other@there", role: "operator" };
export const NOBODY: Sender = { id: "", name: "", role: "observer" };
export const ROBOT = "11111111-0000-4000-8000-000000000001";
export const ARM = "22222222-0000-4000-8000-000000000002";
export const KEY = new Uint8Array(16).fill(7);

export class FakeServer implements Transport {
    readonly sent: Sent[] = [];
    readonly logins: Login[] = [];
    events!: ConnectionEvents;
    /** What the next log-ins are answered with. */
    refuse: Refusal | undefined;
    me = ME;
    entities = 0;
    signalLane: "own" | "shared" = "own";
    /**
     * Of a server that names a signal lane: how the tries to open it end, the first one first; then they succeed. "late": the
     * server has attached it, and its answer does not come.
     */
    attachFails: (Refusal | "late")[] | undefined;
    messageBytesMax = 100_000;
    attached = 0;
    backlog = { messages: 0, bytes: 0 };
    /** Who waits for room on the data lane; undefined = there is room. */
    noRoom: (() => void)[] | undefined;
    left = false;
    dropped = 0;

    async open(login: Login, events: ConnectionEvents): Promise<Connection> {
        this.logins.push(login);
        await Promise.resolve();
        if (this.refuse !== undefined) throw this.refuse;
        this.events = events;
        const note = (one: Sent): void => void this.sent.push(one);
        let signalLane = this.signalLane;
        return {
            facts: { me: this.me, entities: this.entities, watchdogBusyMs: 250, watchdogIdleMs: 10_000, messageBytesMax: this.messageBytesMax },
            get signalLane() {
                return signalLane;
            },
            signalOffered: this.attachFails !== undefined,
            attachSignalLane: async () => {
                ++this.attached;
                await Promise.resolve();
                const why = this.attachFails?.shift();
                if (why === "late") {
                    events.closed("the signal lane was lost while it was opened");
                    throw new Refusal("TIMED_OUT", "it does not answer in time");
                }
                if (why !== undefined) throw why;
                signalLane = "own";
            },
            backlog: () => this.backlog,
            onRoom: (call) => {
                if (this.noRoom === undefined) call();
                else this.noRoom.push(call);
                return () => void (this.noRoom = this.noRoom?.filter((one) => one !== call));
            },
            toEntity: (head, bytes) => note({ what: "message", droppable: false, head, body: decode("ToEntity", bytes) }),
            toEntityDroppable: (head, bytes) => note({ what: "message", droppable: true, head, body: decode("ToEntity", bytes) }),
            request: (head, bytes) => note({ what: "request", head, body: decode("ToEntity", bytes) }),
            stop: (lane, head, cause) => note({ what: "stop", lane, head, entities: head.entity === "" ? [] : [head.entity], cause }),
            stopSeveral: (lane, head, entities, cause) => note({ what: "stop", lane, head, entities, cause }),
            reset: (head) => note({ what: "reset", head }),
            clear: (head) => note({ what: "clear", head }),
            keepAlive: () => note({ what: "keepAlive" }),
            ask: () => note({ what: "ask" }),
            leave: async () => void (this.left = true),
            drop: () => void ++this.dropped,
        };
    }
    take(): Sent[] {
        return this.sent.splice(0);
    }
    beats(): number {
        return this.take().filter(({ what }) => what === "keepAlive").length;
    }
    /** The newest message whose body has this field; it is taken. */
    message<Key extends keyof Messages["ToEntity"]>(key: Key): { head: Header; body: NonNullable<Messages["ToEntity"][Key]> } {
        for (let i = this.sent.length - 1; i >= 0; --i) {
            const one = this.sent[i];
            if (one === undefined || !("body" in one) || one.body[key] === undefined) continue;
            this.sent.splice(i, 1);
            return { head: one.head, body: one.body[key] as NonNullable<Messages["ToEntity"][Key]> };
        }
        throw new Error(`no message with ${key} was sent, but ${JSON.stringify(this.sent.map(({ what }) => what))}`);
    }
    stops(): Extract<Sent, { what: "stop" }>[] {
        return this.take().filter((one) => one.what === "stop");
    }

    status(entity: string, more: Partial<Status> = {}): void {
        this.events.status({ entity, state: "IDLE", latched: false, stopGeneration: 3, holder: NOBODY, held: { epoch: 1, number: 0 }, reason: "", orphaned: false, waiting: 0, stopLatencyUs: 0, ...more });
    }
    join(entity: string, name: string, more: Partial<Status> = {}): void {
        this.events.profile("joined", { entity, name, category: "ROBOT", type: "MOBILE" }, encode("BasicProfile", { name, descr: "a robot", xpos: 5 }));
        this.status(entity, more);
    }
    say(entity: string, body: Init<Messages["ToClient"]>, msgType = "", held = { epoch: 1, number: 1 }): void {
        this.events.entityMessage({ entity, msgType, held, stopGeneration: 0, seq: 0, sentAtUs: 0 }, encode("ToClient", body));
    }
    receipt(entity: string, seq: number, body: Init<Messages["StopReceipt"]>, by = this.me.id): void {
        const bytes = encode("ToClient", { receipt: { stopId: `${by}:${seq}`, stopGeneration: 4, state: 5, ...body } });
        this.events.entityMessage({ entity, msgType: "RECEIPT", held: { epoch: 0, number: 0 }, stopGeneration: 0, seq: 0, sentAtUs: 0 }, bytes);
    }
    /** Answers the check-out that was sent last. */
    grant(entity: string, number = 1, more: Init<Messages["CheckOutReply"]> = {}): void {
        const { body } = this.message("checkOut");
        this.say(entity, { checkOut: { requestId: body.requestId, phase: body.phase, lease: { epoch: 1, number, key: KEY, root: body.root }, stopGeneration: 3, graceMs: 5000, services: SERVICES, ...more } });
    }
}

export const SERVICES: Init<Messages["ServicesProfile"]> = {
    services: [
        {
            name: "Drive",
            globalId: "drive",
            isActive: true,
            isPausable: true,
            params: [
                { name: "Distance", dataType: 2, units: "mm", required: true, minimum: 0, maximum: 5000 },
                { name: "Laps", dataType: 1, minimum: 1, maximum: 9 },
                { name: "Mode", dataType: 3, choices: [{ str: "slow" }, { str: "fast" }] },
                { name: "Covered", type: 1, dataType: 2 },
            ],
            resources: [{ name: "Map" }],
        },
    ],
};

export interface World {
    readonly clock: FakeClock;
    readonly server: FakeServer;
    readonly client: Client;
    readonly errors: unknown[];
}
/** A client that has joined a server where ROBOT is free. */
export async function world(options: Options = {}, prepare: (server: FakeServer) => void = () => undefined): Promise<World> {
    const clock = new FakeClock();
    const server = new FakeServer();
    prepare(server);
    const errors: unknown[] = [];
    let random = 0;
    const client = await connect({
        transport: server,
        clock,
        random: (count) => new Uint8Array(count).map(() => ++random % 251),
        onError: (error) => errors.push(error),
        ...options,
    });
    server.join(ROBOT, "PeopleBot");
    await clock.advance(0); // the first heartbeat
    server.take();
    return { clock, server, client, errors };
}
/** The refusal with which a promise is rejected. */
export async function refusal(of: Promise<unknown> | (() => unknown)): Promise<Refusal> {
    try {
        await (typeof of === "function" ? of() : of);
    } catch (error) {
        if (error instanceof Refusal) return error;
        throw error;
    }
    throw new Error("it was not refused");
}
