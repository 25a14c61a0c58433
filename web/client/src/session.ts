// SPDX-License-Identifier: GPL-2.0-or-later
import type { Alarm, Clock } from "./clock.js";
import { Context, type Held, keyOf, type Observer } from "./core/context.js";
import { SessionCore } from "./core/session_core.js";
import { StopDesk } from "./core/stop_desk.js";
import type { RunReport } from "./global_types.js";
import type { Id, Random } from "./ids.js";
import { parseUuid } from "./ids.js";
import { Refusal, refusalOf } from "./refusal.js";
import type { Connection, ConnectionEvents, Header, Login, Transport } from "./transport.js";
import type { ConnectionReport, Entity, EntityNews, HandOverRequest, Sample, ServerText, Service, TaskReport } from "./types.js";
import { isFinalRun, isFinalTask } from "./wire/content.js";
import { inQuotes } from "./wire/values.js";

/** A client that has lost its server logs in again after this, then each time after twice as long. */
const RECONNECT_FIRST_MS = 100;
const RECONNECT_LAST_MS = 2000;
const RELEASE_MS = 1000;
/** A signal lane that could not be opened is tried again after this, each time after twice as long, and not while robots of this client move. */
const ATTACH_FIRST_MS = 1000;
const ATTACH_LAST_MS = 60_000;

export type Credentials = Pick<Login, "user" | "password"> & Partial<Pick<Login, "server" | "signal">>;
export interface SessionOptions {
    readonly login: Omit<Login, "user" | "password">;
    /** Asked before every log-in. */
    readonly credentials: () => Promise<Credentials>;
    readonly reconnect: boolean;
    readonly resume: boolean;
    readonly keepRunning: (() => boolean) | undefined;
    /** Infinity = the silence of the server is not told. */
    readonly noticeMs: number;
    readonly onError: (error: unknown) => void;
    readonly transport: Transport;
    readonly clock: Clock;
    readonly random: Random;
}

/** Who wants to hear of something. */
export class Listeners<Args extends unknown[]> {
    private readonly all = new Set<(...args: Args) => void>();

    add(call: (...args: Args) => void): () => void {
        const own = (...args: Args): void => call(...args); // the same function may listen twice
        this.all.add(own);
        return () => void this.all.delete(own);
    }
    calls(): ((...args: Args) => void)[] {
        return [...this.all];
    }
}

/** What the handles of one lease share. */
export class Holding {
    lost: Refusal | undefined;
    last: Entity;
    readonly onLost = new Listeners<[Refusal]>();
    readonly onOrphaned = new Listeners<[string]>();
    readonly onResumed = new Listeners<[]>();
    readonly onHandOver = new Listeners<[HandOverRequest]>();
    readonly onService = new Listeners<[Service]>();
    readonly onText = new Listeners<[string]>();
    readonly onRaw = new Listeners<[Uint8Array]>();
    constructor(
        readonly held: Held,
        entity: Entity,
    ) {
        this.last = entity;
    }
}
/** What the handles of one task or run share. */
export class Followed<Report> {
    readonly onUpdate = new Listeners<[Report]>();
    constructor(
        readonly id: Id,
        public report: Report,
    ) {}
}
export interface WatchEntry {
    readonly entity: string;
    readonly streams: readonly string[];
    readonly callback: (sample: Sample) => void;
}

/**
 * Gives the core its connection, its time and its turns. Everything enters by turn(); news for the program leave after the
 * outermost turn, in order, so that a callback may call everything.
 */
export class Session implements Observer {
    readonly context: Context;
    readonly core: SessionCore;
    readonly desk: StopDesk;

    readonly onConnection = new Listeners<[ConnectionReport]>();
    readonly onEntity = new Listeners<[EntityNews]>();
    readonly onServerText = new Listeners<[ServerText]>();
    readonly holdings = new Map<string, Holding>();
    readonly tasks = new Map<Id, Followed<TaskReport>>();
    readonly runs = new Map<Id, Followed<RunReport>>();
    readonly watches = new Set<WatchEntry>();
    readonly credits = new Map<Id, (from: number, to: number) => void>();
    /** Called after each change of entities or connection. */
    readonly changes = new Set<() => void>();

    private kind: ConnectionReport["kind"] = "lost";
    private since: number;
    private reason = "not connected yet";
    private tries = 0;
    private signalLane: ConnectionReport["signalLane"] = "shared";
    private ended: Refusal | undefined;
    /** The user of the first session: what is held is that user's. */
    private user: string | undefined;
    private attempt = 0;
    /** The attempt whose events count; 0 = none. */
    private listening = 0;
    private connection: Connection | undefined;
    private reconnectAt = Infinity;
    private wait = RECONNECT_FIRST_MS;
    private attachAt = Infinity;
    private attachWait = ATTACH_FIRST_MS;
    private attachTries = 0;
    private attaching = false;
    /** The last connections ended with a try to open the signal lane: the next one waits for this before its first. */
    private attachAfter = 0;

    private depth = 0;
    private departing = false;
    private toldSilent = false;
    private readonly news: (() => void)[] = [];
    private readonly alarm: Alarm;
    private alarmAt = Infinity;

    constructor(readonly options: SessionOptions) {
        this.context = new Context({ timeoutMs: options.login.timeoutMs, resume: options.resume && options.reconnect, noticeMs: options.noticeMs }, options.clock, options.random, this);
        this.core = new SessionCore(this.context);
        this.desk = new StopDesk(this.context);
        this.since = options.clock.now();
        this.alarm = options.clock.alarm(() => this.onAlarm());
    }

    // Turns.
    turn<Result>(use: () => Result): Result {
        ++this.depth;
        try {
            return use();
        } finally {
            if (--this.depth === 0) this.depart();
        }
    }
    private depart(): void {
        if (this.toldSilent !== this.silent) this.sayConnection();
        if (!this.departing) {
            this.departing = true;
            for (let tell = this.news.shift(); tell !== undefined; tell = this.news.shift()) this.guarded(tell);
            this.departing = false;
            for (const changed of [...this.changes]) this.guarded(changed);
        }
        this.setAlarm();
    }
    /** What it throws is reported, and disturbs nothing else. */
    private guarded(call: () => void): boolean {
        try {
            call();
            return true;
        } catch (error) {
            this.failed(error);
            return false;
        }
    }
    /** The one place where errors of callbacks, and defects, are reported. */
    private failed(error: unknown): void {
        try {
            this.options.onError(error);
        } catch {
            // the program's own business
        }
    }
    private say<Args extends unknown[]>(listeners: Listeners<Args>, ...args: Args): void {
        for (const call of listeners.calls()) this.news.push(() => call(...args));
    }
    /** Of a callback that is to be called for the first time, in its turn. */
    later(call: () => void): void {
        this.turn(() => this.news.push(call));
    }
    /** A request of the program: resolves when it is done. */
    ask(begin: (done: (refusal?: Refusal) => void) => void): Promise<void> {
        return new Promise((resolve, reject) => {
            this.turn(() => begin((refusal) => (refusal === undefined ? resolve() : reject(refusal))));
        });
    }

    // Time.
    private setAlarm(): void {
        if (this.kind === "closed") return;
        const { server } = this.core;
        const at = Math.min(this.core.nextDeadline(), this.desk.nextDeadline(), server.nextDeadline(), this.reconnectAt, this.attachAt);
        this.alarmAt = at;
        this.alarm.set(at);
    }
    private onAlarm(): void {
        this.turn(() => {
            const now = this.options.clock.now();
            this.core.server.awayFor(now - this.alarmAt);
            // A defect in one of them must not keep the others from their work.
            this.guarded(() => this.core.server.onTimer(() => this.mayBeat()));
            this.guarded(() => this.desk.onTimer());
            this.guarded(() => this.core.onTimer());
            if (this.core.serverSilent) this.connectionLost(this.listening, "the server has been silent for too long");
            if (now >= this.reconnectAt) void this.reconnect();
            if (now >= this.attachAt) {
                // Should the server not answer in time, the session ends, and the robots with it.
                if (this.attachTries > 0 && this.core.server.busy) this.attachAt = now + ATTACH_FIRST_MS;
                else void this.attachSignalLane();
            }
        });
    }
    private mayBeat(): boolean {
        try {
            return this.options.keepRunning?.() ?? true;
        } catch (error) {
            this.failed(error);
            return false; // counts as no
        }
    }

    // The connection.
    report(): ConnectionReport {
        const now = this.options.clock.now();
        return {
            kind: this.kind,
            ageMs: now - this.since,
            silentMs: this.core.server.silentMs,
            heardAt: this.core.server.heardDate,
            silent: this.silent,
            reason: this.reason,
            tries: this.tries,
            nextTryMs: Number.isFinite(this.reconnectAt) ? Math.max(this.reconnectAt - now, 0) : undefined,
            signalLane: this.signalLane,
            ended: this.ended,
        };
    }
    private become(kind: ConnectionReport["kind"], reason: string): void {
        // Lost and reconnecting are one time.
        const same = (this.kind === "lost" && kind === "reconnecting") || (this.kind === "reconnecting" && kind === "lost");
        if (!same) this.since = this.options.clock.now();
        this.kind = kind;
        this.reason = reason;
        this.sayConnection();
    }
    private sayConnection(): void {
        this.toldSilent = this.silent;
        this.say(this.onConnection, this.report());
    }
    private get silent(): boolean {
        return this.connected && this.core.server.silent;
    }
    get connected(): boolean {
        return this.kind === "connected";
    }
    get closed(): boolean {
        return this.kind === "closed";
    }

    /** Rejects with a Refusal. */
    async establish(): Promise<void> {
        const attempt = ++this.attempt;
        this.listening = attempt;
        try {
            const credentials = await this.options.credentials();
            if (this.closed) throw new Refusal("CANCELLED", "This client was closed.");
            this.checkUser(credentials.user);
            const opened = await this.options.transport.open({ ...this.options.login, ...credentials }, this.events(attempt));
            this.turn(() => {
                if (this.listening !== attempt) {
                    opened.drop();
                    throw new Refusal("NOT_CONNECTED", "the connection ended during the login");
                }
                this.connection = opened;
                this.user ??= credentials.user;
                this.signalLane = opened.signalLane;
                this.attachTries = this.attachAfter > 0 ? 1 : 0;
                this.attachWait = ATTACH_FIRST_MS;
                this.attachAt = opened.signalLane === "shared" && opened.signalOffered ? this.options.clock.now() + this.attachAfter : Infinity;
                this.desk.onConnected(opened);
                this.core.onConnected(opened);
                this.tries = 0;
                this.wait = RECONNECT_FIRST_MS;
                this.reconnectAt = Infinity;
                this.become("connected", "");
            });
        } catch (error) {
            const refusal = error instanceof Refusal ? error : new Refusal("NOT_CONNECTED", error instanceof Error ? error.message : String(error));
            this.turn(() => {
                if (this.listening === attempt) this.listening = 0;
                if (this.connected || this.closed) return;
                this.core.onDisconnected(refusal.message); // forgets the profiles that came before the failure
                this.desk.onDisconnected();
            });
            throw refusal;
        }
    }
    /** Throws, and ends the session for good, if somebody else would go on with it. */
    private checkUser(user: string): void {
        if (this.user === undefined || this.user === user) return;
        const name = (one: string): string => (one === "" ? "nobody by name" : inQuotes(one));
        const message = `The session was opened by ${name(this.user)}, and ${name(user)} is logged in now. What was held is not resumed under another name: open a new session.`;
        this.ended = new Refusal("PERMISSION_DENIED", message);
        this.turn(() => this.end(message));
        throw this.ended;
    }
    private async attachSignalLane(): Promise<void> {
        this.attachAt = Infinity;
        const { connection } = this;
        if (connection === undefined) return;
        let opened = true;
        this.attaching = true;
        ++this.attachTries;
        try {
            await connection.attachSignalLane();
        } catch {
            opened = false; // stops share the lane of data meanwhile
        }
        this.turn(() => {
            if (this.connection !== connection) return;
            this.attaching = false;
            this.attachAfter = 0;
            if (opened) {
                this.signalLane = connection.signalLane;
                this.sayConnection();
            } else {
                this.attachAt = this.options.clock.now() + this.attachWait;
                this.attachWait = Math.min(2 * this.attachWait, ATTACH_LAST_MS);
            }
        });
    }
    private async reconnect(): Promise<void> {
        this.reconnectAt = Infinity;
        ++this.tries;
        this.become("reconnecting", this.reason);
        try {
            await this.establish();
        } catch (error) {
            this.turn(() => {
                if (this.kind !== "reconnecting") return;
                this.reconnectAt = this.options.clock.now() + this.nextWait();
                this.become("lost", error instanceof Error ? error.message : String(error));
            });
        }
    }
    private nextWait(): number {
        const wait = this.wait;
        this.wait = Math.min(2 * wait, RECONNECT_LAST_MS);
        return wait;
    }
    private connectionLost(attempt: number, reason: string): void {
        if (attempt === 0 || attempt !== this.listening) return;
        this.listening = 0; // nothing of this connection counts any more
        const connection = this.connection;
        if (connection === undefined) return; // it is being opened, and open() fails
        this.connection = undefined;
        if (this.attaching) this.attachAfter = Math.min(Math.max(2 * this.attachAfter, ATTACH_FIRST_MS), ATTACH_LAST_MS);
        this.attaching = false;
        this.attachAt = Infinity;
        this.signalLane = "shared";
        connection.drop();
        this.wait = RECONNECT_FIRST_MS;
        if (this.options.reconnect) this.reconnectAt = this.options.clock.now() + this.nextWait();
        this.become("lost", reason);
        this.core.onDisconnected(reason);
        this.desk.onDisconnected();
    }
    private events(attempt: number): ConnectionEvents {
        const on = (use: () => void, heard = true): void => {
            if (attempt !== this.listening) return;
            this.turn(() => {
                if (heard) this.core.server.heard();
                // What cannot be handled is as if it had not come.
                if (!this.guarded(use)) ++this.context.malformed;
            });
        };
        return {
            profile: (presence, registration, profile) =>
                on(() => {
                    this.desk.onEntity(presence === "left", registration.entity, registration.name, profile.length > 0);
                    this.core.onProfile(presence, registration, profile);
                }),
            status: (status) => on(() => this.core.onStatus(status)),
            entityMessage: (head, bytes) => on(() => this.onEntityMessage(head, bytes)),
            refused: (head, refusal) =>
                on(() => {
                    if (head.msgType === "STOP" || head.msgType === "RESET" || head.msgType === "CLEAR") this.desk.onRefusal(head.seq, head.entity, refusal);
                    if (head.msgType !== "STOP") this.core.onRefusal(head, refusal);
                }),
            stopAccepted: (head, entities) => on(() => this.desk.onStopAccepted(head.seq, head.entity, entities)),
            serverText: (code, text) => on(() => this.serverText(refusalOf(code, text)?.code ?? "OK", text)),
            heartbeat: () => on(() => undefined),
            closed: (reason) => on(() => this.connectionLost(attempt, reason), false),
        };
    }
    private onEntityMessage(head: Header, bytes: Uint8Array): void {
        if (this.desk.onReceipt(head.entity, head.msgType, bytes)) return;
        if (head.msgType === "REPLY") this.desk.onReply(head.entity, bytes);
        this.core.onEntityMessage(head, bytes);
    }

    async close(): Promise<void> {
        if (this.closed) return;
        const released = this.turn(() =>
            this.core.leases.held().map((held) => {
                this.holdings.delete(keyOf(held));
                return new Promise<void>((resolve) => {
                    try {
                        this.core.leases.release(held, () => resolve());
                    } catch {
                        resolve();
                    }
                });
            }),
        );
        await this.within(Promise.all(released), RELEASE_MS);
        const connection = this.connection;
        this.turn(() => {
            if (!this.closed) this.end("this client was closed");
        });
        await connection?.leave();
    }
    /** For good. */
    private end(why: string): void {
        this.connection = undefined;
        this.listening = 0;
        this.reconnectAt = Infinity;
        this.attachAt = Infinity;
        this.signalLane = "shared";
        this.become("closed", why);
        this.core.onDisconnected(why, true);
        this.desk.onDisconnected();
        this.desk.endOrders();
        this.alarm.end();
    }
    /** When it is an upload's turn to send a chunk. Returns what withdraws it. */
    onRoom(call: () => void): () => void {
        return this.context.link?.onRoom(call) ?? (() => undefined);
    }
    /** On the clock of this client. */
    delay(ms: number): Promise<void> {
        return this.within(new Promise(() => undefined), ms);
    }
    /** Waits for it, and no longer than that. */
    async within(promise: Promise<unknown>, ms: number): Promise<void> {
        if (ms === Infinity) return void (await promise);
        let alarm: Alarm | undefined;
        const late = new Promise<void>((resolve) => {
            const until = this.options.clock.now() + Math.max(ms, 0);
            const own = this.options.clock.alarm(() => (this.options.clock.now() < until ? own.set(until) : resolve()));
            own.set(until);
            alarm = own;
        });
        try {
            await Promise.race([promise, late]);
        } finally {
            alarm?.end();
        }
    }
    /** The first value that `look` gives, now or after a change; undefined when the time is up. */
    async until<Value>(look: () => Value | undefined, ms: number): Promise<Value | undefined> {
        let found = look();
        if (found !== undefined || ms <= 0) return found;
        let changed: (() => void) | undefined;
        const first = new Promise<void>((resolve) => {
            changed = () => {
                found = look();
                if (found !== undefined) resolve();
            };
            this.changes.add(changed);
        });
        await this.within(first, ms);
        if (changed !== undefined) this.changes.delete(changed);
        return found ?? look();
    }

    // News of the core.
    entity(news: EntityNews): void {
        this.say(this.onEntity, news);
    }
    orphaned(held: Held, reason: string): void {
        const holding = this.holdings.get(keyOf(held));
        if (holding !== undefined) this.say(holding.onOrphaned, reason);
    }
    resumed(held: Held): void {
        const holding = this.holdings.get(keyOf(held));
        if (holding !== undefined) this.say(holding.onResumed);
    }
    lost(held: Held, why: Refusal): void {
        const holding = this.holdings.get(keyOf(held));
        if (holding === undefined) return;
        holding.lost = why;
        this.holdings.delete(keyOf(held));
        this.say(holding.onLost, why);
    }
    handOver(held: Held, request: HandOverRequest): void {
        const holding = this.holdings.get(keyOf(held));
        if (holding !== undefined) this.say(holding.onHandOver, request);
    }
    service(held: Held, service: Service): void {
        const holding = this.holdings.get(keyOf(held));
        if (holding !== undefined) this.say(holding.onService, service);
    }
    text(held: Held, text: string): void {
        const holding = this.holdings.get(keyOf(held));
        if (holding !== undefined) this.say(holding.onText, text);
    }
    raw(held: Held, bytes: Uint8Array): void {
        const holding = this.holdings.get(keyOf(held));
        if (holding !== undefined) this.say(holding.onRaw, bytes);
    }
    sample(sample: Sample): void {
        for (const watch of this.watches) {
            if (watch.entity !== sample.entity || (watch.streams.length > 0 && !watch.streams.includes(sample.stream))) continue;
            this.news.push(() => {
                if (this.watches.has(watch)) watch.callback(sample);
            });
        }
    }
    task(report: TaskReport): void {
        const id = parseUuid(report.id) ?? "";
        const followed = this.tasks.get(id);
        if (followed === undefined) return;
        followed.report = report;
        if (isFinalTask(report.state)) this.tasks.delete(id);
        this.say(followed.onUpdate, report);
    }
    run(report: RunReport): void {
        const id = parseUuid(report.id) ?? "";
        const followed = this.runs.get(id);
        if (followed === undefined) return;
        followed.report = report;
        if (isFinalRun(report.state)) this.runs.delete(id);
        this.say(followed.onUpdate, report);
    }
    serverText(code: string, text: string): void {
        this.say(this.onServerText, { code, text });
    }
    credit(transfer: Id, from: number, to: number): void {
        this.credits.get(transfer)?.(from, to);
    }
}
