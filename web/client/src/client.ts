// SPDX-License-Identifier: GPL-2.0-or-later
import { type Clock, usualClock } from "./clock.js";
import type { Held } from "./core/context.js";
import { keyOf } from "./core/context.js";
import { availabilityOf } from "./core/entities.js";
import { parseTicket } from "./core/leases.js";
import { type Candidate, propose, rolesOf } from "./core/proposal.js";
import type { Action } from "./core/requests.js";
import type { Bindings, GlobalService, GlobalServices, Proposal, RunHistory, RunRecord, RunReport } from "./global_types.js";
import { type Random, systemRandom } from "./ids.js";
import { IceTransport } from "./ice/ice_transport.js";
import { Refusal } from "./refusal.js";
import { type Credentials, Followed, Holding, Session, type WatchEntry } from "./session.js";
import type { Transport } from "./transport.js";
import type {
    Argument,
    CheckOutOptions,
    ConnectionReport,
    Details,
    DrillReport,
    Entity,
    EntityNews,
    HandOverPolicy,
    HandOverRequest,
    Receipt,
    Sample,
    Sender,
    ServerText,
    Service,
    StopOptions,
    TaskReport,
} from "./types.js";
import { upload, type UploadOptions } from "./upload.js";
import { isFinalRun, isFinalTask } from "./wire/content.js";

const DRILL_MS = 1000;
const NOTICE_LEAST_MS = 200;

/** Ends what it was returned for: a callback is not called any more, a stream is not watched any more. */
export type End = () => void;

export interface Options {
    /** ws://HOST:PORT/PATH or wss://…; in Node also HOST:PORT (TCP). Ice's form and the proxy of a Glacier2 router are accepted, too. */
    readonly server?: string;
    /**
     * Where the signal lane is, for which stops do not wait behind data: an address as in `server`, or "shared" to do without.
     * Left out: where the server says, if this program can reach that.
     */
    readonly signal?: string;
    readonly user?: string;
    readonly password?: string;
    /** Asked before each log-in, also before the library logs in again; what it leaves out is as in the options. */
    readonly credentials?: () => Promise<Partial<Credentials>>;
    /** What others see, if the server has no users: name@host. */
    readonly displayName?: string;
    /** How long a request waits for its answer before it is refused with TIMED_OUT; 5 s. */
    readonly timeoutMs?: number;
    readonly reconnect?: boolean;
    /** If a connection is lost, each Entity Manager keeps its lease for a grace, and the library resumes it if it is back in time. */
    readonly resume?: boolean;
    /** connect() waits, at most for `timeoutMs`, until this client knows every entity of the server. */
    readonly awaitEntities?: boolean;
    /**
     * Asked before each heartbeat while a task runs; false suppresses the heartbeat, and the server stops the robots. A page is
     * alive even if its operator sees nothing of it: see whileVisible().
     */
    readonly keepRunning?: () => boolean;
    /**
     * A connection on which nothing has come from the server for this long, at least 200 ms, is reported as `silent`, long before
     * it is given up. The library asks the server for signs of life four times in this time. Left out: nobody asks, and `silent`
     * is always false.
     */
    readonly noticeSilenceMs?: number;
    /** What a callback of the program has thrown; without it, the console is told. */
    readonly onError?: (error: unknown) => void;
    readonly clock?: Clock;
    readonly random?: Random;
    readonly transport?: Transport;
}

/** For Options.keepRunning in a page: true while its tab is in sight. */
export function whileVisible(): () => boolean {
    return () => typeof document === "undefined" || document.visibilityState === "visible";
}

declare const process: { readonly env: Readonly<Record<string, string | undefined>> } | undefined;
function usualName(): string {
    const env = typeof process === "undefined" ? undefined : process.env;
    return typeof document !== "undefined" ? "web@browser" : `${env?.["USER"] ?? "node"}@${env?.["HOSTNAME"] ?? "localhost"}`;
}

/** Logs in. Rejects with UNAVAILABLE, PERMISSION_DENIED, … if there is no session within the time-out; the message says how to fix it. */
export async function connect(options: Options = {}): Promise<Client> {
    const timeoutMs = Math.min(Math.max(options.timeoutMs ?? 5000, 1), 86_400_000);
    const server = options.server ?? "127.0.0.1:10410";
    const session = new Session({
        login: { server, signal: options.signal, displayName: options.displayName ?? usualName(), timeoutMs },
        credentials: async () => ({ user: options.user ?? "", password: options.password ?? "", ...(await options.credentials?.()) }),
        reconnect: options.reconnect ?? true,
        resume: options.resume ?? true,
        keepRunning: options.keepRunning,
        noticeMs: Math.max(options.noticeSilenceMs ?? Infinity, NOTICE_LEAST_MS),
        onError: options.onError ?? ((error) => console.error("axon: a callback threw:", error)),
        transport: options.transport ?? new IceTransport(),
        clock: options.clock ?? usualClock(),
        random: options.random ?? systemRandom,
    });
    try {
        await session.establish();
    } catch (error) {
        await session.close();
        const refusal = error as Refusal;
        const code = refusal.code === "NOT_CONNECTED" || refusal.code === "TIMED_OUT" ? "UNAVAILABLE" : refusal.code;
        throw new Refusal(code, `No session with the server at ${server}: ${refusal.message}`, refusal.holder);
    }
    if (options.awaitEntities ?? true) await session.until(() => (session.core.entities.complete || !session.connected ? true : undefined), timeoutMs);
    return new Client(session, server);
}

/** What tasks and runs have in common. */
abstract class Follower<Report extends TaskReport | RunReport> {
    /** @internal */
    constructor(
        protected readonly session: Session,
        protected readonly shared: Followed<Report>,
    ) {}
    protected abstract final(report: Report): boolean;
    protected abstract control(action: Action, done: (refusal?: Refusal) => void): void;

    get id(): string {
        return this.shared.report.id;
    }
    report(): Report {
        return this.shared.report;
    }
    /** Resolves with the newest report when the state is final, or when the time is up. */
    async wait(timeMs = Infinity): Promise<Report> {
        if (this.final(this.shared.report)) return this.shared.report;
        let end: End | undefined;
        const ended = new Promise<void>((resolve) => {
            end = this.shared.onUpdate.add((report) => {
                if (this.final(report)) resolve();
            });
        });
        await this.session.within(ended, timeMs);
        end?.();
        return this.shared.report;
    }
    /** Called with the current report first, then on every change. */
    onUpdate(callback: (report: Report) => void): End {
        const present = this.shared.report;
        this.session.later(() => callback(present));
        return this.shared.onUpdate.add(callback);
    }
    pause(): Promise<void> {
        return this.session.ask((done) => this.control("pause", done));
    }
    resume(): Promise<void> {
        return this.session.ask((done) => this.control("resume", done));
    }
    cancel(): Promise<void> {
        return this.session.ask((done) => this.control("cancel", done));
    }
}

/** A task that this client has asked for. Forgetting it does not cancel it. */
export class Task extends Follower<TaskReport> {
    protected override final({ state }: TaskReport): boolean {
        return isFinalTask(state);
    }
    protected override control(action: Action, done: (refusal?: Refusal) => void): void {
        this.session.core.tasks.control(this.shared.id, action, done);
    }
}

/** A run of a global service. Its master reports on it; each report has the whole timeline. */
export class Run extends Follower<RunReport> {
    protected override final({ state }: RunReport): boolean {
        return isFinalRun(state);
    }
    protected override control(action: Action, done: (refusal?: Refusal) => void): void {
        this.session.core.runs.control(this.shared.id, action, done);
    }
    /** Stops every participant, on the signal lane. They are latched; the run ends as STOPPED. */
    stop(options: StopOptions = {}): Promise<readonly Receipt[]> {
        const report = this.shared.report;
        return stopAll(this.session, [...new Set([report.master, ...report.steps.map(({ entity }) => entity)])], options);
    }
}

function stopAll(session: Session, names: readonly string[] | undefined, options: StopOptions): Promise<readonly Receipt[]> {
    return new Promise((resolve, reject) => {
        const done = (result: readonly Receipt[] | Refusal): void => (result instanceof Refusal ? reject(result) : resolve(result));
        const { onProgress } = options;
        const told = onProgress === undefined ? undefined : (receipts: readonly Receipt[]): void => session.later(() => onProgress(receipts));
        session.turn(() => session.desk.stop(names, options.deadlineMs ?? 1000, options.standstillMs ?? 0, done, told));
    });
}

/**
 * An entity that this client holds. All CheckOuts of one lease are the same to the library.
 *
 * held      the client may use the entity.
 * orphaned  the connection was lost, the entity has left, or the servers or its Entity Manager had lost this client for a
 *           moment. The robot stands still and is latched. Calls are refused with NOT_CONNECTED. It becomes held again
 *           (onResumed; the same lease) or gone (onLost).
 * gone      the lease has ended. Every call is refused with NOT_HOLDER.
 */
export class CheckOut {
    /** @internal */
    constructor(
        private readonly session: Session,
        private readonly holding: Holding,
    ) {}
    private get held(): Held {
        return this.holding.held;
    }

    /** As last known. */
    entity(): Entity {
        const { core } = this.session;
        if (core.entities.isThere(this.held.entity)) this.holding.last = core.entities.there(this.held.entity);
        return this.holding.last;
    }
    get orphaned(): boolean {
        return this.session.core.leases.find(this.held)?.orphaned ?? false;
    }
    /** Why the lease has ended; undefined while it has not. */
    get lost(): Refusal | undefined {
        return this.holding.lost;
    }
    services(): readonly Service[] {
        return this.session.core.leases.find(this.held)?.services ?? [];
    }
    /** Throws UNKNOWN_SERVICE. */
    service(nameOrGlobalId: string): Service {
        return this.session.core.leases.service(this.held, nameOrGlobalId);
    }

    /** Sets a parameter of a service. The robot application grants or denies it; DENIED carries its reason. */
    set(service: string, argument: Argument): Promise<void> {
        return this.session.ask((done) => this.session.core.commands.set(this.held, service, argument, done));
    }
    /** Sends a file. Resolves when the robot application has accepted it and the Entity Manager has stored it. */
    upload(service: string, resource: string, file: Blob | Uint8Array, options: UploadOptions = {}): Promise<void> {
        return upload(this.session, this.held, service, resource, file, options);
    }
    /**
     * Asks for a task; does not wait. A refusal arrives as state REFUSED, with its reason in the report. A task that has not begun
     * `notAfterMs` after the Entity Manager received it is refused with EXPIRED; 0 = it may begin at any time.
     */
    run(service: string, args: readonly Argument[] = [], notAfterMs = 0): Task {
        return this.session.turn(() => {
            const { tasks } = this.session.core;
            const id = tasks.run(this.held, service, args, notAfterMs);
            const report = tasks.report(id) as TaskReport;
            const followed = new Followed(id, report);
            if (!isFinalTask(report.state)) this.session.tasks.set(id, followed);
            return new Task(this.session, followed);
        });
    }
    /** Throws OVERLOADED if too much waits to be sent. */
    sendText(text: string): void {
        this.session.turn(() => this.session.core.commands.sendText(this.held, text));
    }
    sendRaw(bytes: Uint8Array): void {
        this.session.turn(() => this.session.core.commands.sendRaw(this.held, bytes));
    }
    onText(callback: (text: string) => void): End {
        return this.holding.onText.add(callback);
    }
    onRaw(callback: (bytes: Uint8Array) => void): End {
        return this.holding.onRaw.add(callback);
    }
    onServiceChanged(callback: (service: Service) => void): End {
        return this.holding.onService.add(callback);
    }
    /** Called once, with the reason; at once if the lease has ended already. Not called after release(). */
    onLost(callback: (why: Refusal) => void): End {
        const { lost } = this.holding;
        if (lost !== undefined) this.session.later(() => callback(lost));
        return this.holding.onLost.add(callback);
    }
    onOrphaned(callback: (reason: string) => void): End {
        return this.holding.onOrphaned.add(callback);
    }
    onResumed(callback: () => void): End {
        return this.holding.onResumed.add(callback);
    }
    /** Called when somebody asks for this entity, and when they have withdrawn. A request that is already open is reported at once. */
    onHandOverRequest(callback: (request: HandOverRequest) => void): End {
        const open = this.handOverRequest();
        if (open !== undefined) this.session.later(() => callback(open));
        return this.holding.onHandOver.add(callback);
    }
    handOverRequest(): HandOverRequest | undefined {
        return this.session.core.leases.question(this.held);
    }
    /** Throws WRONG_STATE if nobody asks. Accepting stops the robot, then ends the lease (onLost). */
    answerHandOver(accept: boolean, reason = ""): void {
        this.session.turn(() => this.session.core.leases.answerHandOver(this.held, accept, reason));
    }
    setHandOverPolicy(policy: HandOverPolicy): void {
        this.session.turn(() => this.session.core.leases.setHandOverPolicy(this.held, policy));
    }
    /** What Client.resume() needs to take this lease over. Whoever has the ticket has the lease: keep it like a password. */
    ticket(): string {
        return this.session.core.leases.ticket(this.held);
    }
    /** Stops the running task and goes on with the next one of the queue. Does not latch. */
    reset(): Promise<Receipt> {
        return this.signal((sequence) => this.session.core.commands.reset(this.held, sequence));
    }
    /** Stops the running task, empties the queue and leaves a collaboration. Does not latch. */
    clear(): Promise<Receipt> {
        return this.signal((sequence) => this.session.core.commands.clear(this.held, sequence));
    }
    private signal(send: (sequence: number) => void): Promise<Receipt> {
        return new Promise((resolve, reject) => {
            this.session.turn(() => {
                const { desk, context } = this.session;
                const sequence = context.marks.nextSequence();
                desk.await(this.held.entity, sequence, context.settings.timeoutMs, (result) => {
                    if (result instanceof Refusal) return reject(result);
                    const receipt = result[0];
                    if (receipt === undefined || receipt.managerMs === undefined) reject(new Refusal("TIMED_OUT", "The entity has not answered in time."));
                    else resolve(receipt);
                });
                try {
                    send(sequence);
                } catch (error) {
                    desk.withdraw(sequence);
                    throw error;
                }
            });
        });
    }
    release(): Promise<void> {
        return this.session.ask((done) => {
            this.session.core.leases.release(this.held, done);
            this.session.holdings.delete(keyOf(this.held));
            this.holding.lost ??= new Refusal("NOT_HOLDER", "It was released.");
        });
    }
}

/**
 * A connection to an Axon server, with its own heartbeats, reconnection and, where there is one, signal lane.
 *
 * Callbacks run one at a time, in order, after the library has done its own work; they may call everything. What one throws goes
 * to Options.onError. What can be refused rejects its promise with a Refusal, or throws one if it returns no promise.
 */
export class Client {
    /** @internal */
    constructor(
        private readonly session: Session,
        readonly server: string,
    ) {}

    get connected(): boolean {
        return this.session.connected;
    }
    connection(): ConnectionReport {
        return this.session.report();
    }
    /** Called with the present report first, then on every change. The age goes on: ask connection() for it. */
    onConnection(callback: (report: ConnectionReport) => void): End {
        const present = this.session.report();
        this.session.later(() => callback(present));
        return this.session.onConnection.add(callback);
    }
    get self(): Sender {
        return this.session.context.self;
    }
    /** Messages of others that could not be understood and were dropped. */
    get malformed(): number {
        return this.session.context.malformed;
    }
    onServerText(callback: (text: ServerText) => void): End {
        return this.session.onServerText.add(callback);
    }

    /** Those that are ready, or all, in order of UUID. */
    entities(listed: "ready" | "all" = "ready"): readonly Entity[] {
        return this.session.core.entities.list(listed === "all");
    }
    /** By name, by "Name#2", by UUID, or by a unique beginning of the UUID. Throws UNKNOWN_ENTITY or AMBIGUOUS_ENTITY. */
    find(name: string): Entity {
        return this.session.core.entities.find(name);
    }
    /** The shortest name that means only this entity. */
    label(id: string): string {
        return this.session.core.entities.label(id);
    }
    /** Resolves when such an entity is there and ready (and not UNAV, INIT, ENVCONN or ERR). */
    async waitFor(name: string, timeMs: number): Promise<Entity> {
        let why: Refusal | undefined;
        const able = await this.session.until(() => {
            try {
                const entity = this.find(name);
                why = new Refusal("TIMED_OUT", `${entity.name} is still ${entity.state}${entity.reason === "" ? "." : `: ${entity.reason}`}`);
                return entity.ready && availabilityOf(entity.state) !== "away" ? entity : undefined;
            } catch (error) {
                why = error as Refusal;
                return undefined;
            }
        }, timeMs);
        if (able === undefined) throw why ?? new Refusal("TIMED_OUT", "The time is up.");
        return able;
    }
    /** Called for the entities that are there, and then for each that joins, changes or leaves; for those that are ready only. */
    onEntity(callback: (news: EntityNews) => void): End {
        const present = this.entities();
        this.session.later(() => {
            for (const entity of present) callback({ presence: "joined", entity, connectionLost: false });
        });
        return this.session.onEntity.add(callback);
    }

    /** Checks out all of the named entities, or none of them. ALREADY_HELD names the holder. */
    async checkOutAll(names: readonly string[], options: CheckOutOptions = {}): Promise<readonly CheckOut[]> {
        const { session } = this;
        const cancelled = new Refusal("CANCELLED", "The check-out was given up.");
        if (options.signal?.aborted === true) throw cancelled;
        const { onWaiting } = options;
        const own: CheckOutOptions = onWaiting === undefined ? options : { ...options, onWaiting: (waiting) => session.later(() => onWaiting(waiting)) };
        return new Promise((resolve, reject) => {
            session.turn(() => {
                const onAbort = (): void => session.turn(() => session.core.checkOuts.giveUp(id));
                const id = session.core.checkOuts.checkOut(names, own, (granted) => {
                    options.signal?.removeEventListener("abort", onAbort);
                    if (granted instanceof Refusal) reject(granted);
                    else this.give(granted, resolve, reject);
                });
                options.signal?.addEventListener("abort", onAbort);
            });
        });
    }
    async checkOut(name: string, options: CheckOutOptions = {}): Promise<CheckOut> {
        return (await this.checkOutAll([name], options))[0] as CheckOut;
    }
    /** Takes over the lease whose CheckOut.ticket() came from another program, or from this page before it was loaded again. */
    resume(ticket: string): Promise<CheckOut> {
        return new Promise((resolve, reject) => {
            this.session.turn(() => {
                this.session.core.checkOuts.resume(parseTicket(ticket), (granted) => {
                    if (granted instanceof Refusal) reject(granted);
                    else this.give(granted, (all) => resolve(all[0] as CheckOut), reject);
                });
            });
        });
    }
    /** The entities that this client holds now. */
    held(): readonly CheckOut[] {
        return this.session.core.leases.held().map((held) => this.handle(held));
    }
    /** Within a turn of the core, which nothing that is thrown must leave half done. */
    private give(granted: readonly Held[], resolve: (all: readonly CheckOut[]) => void, reject: (why: unknown) => void): void {
        try {
            resolve(granted.map((held) => this.handle(held)));
        } catch (error) {
            reject(error);
        }
    }
    private handle(held: Held): CheckOut {
        const key = keyOf(held);
        let holding = this.session.holdings.get(key);
        if (holding === undefined) {
            const { entities } = this.session.core;
            const facts = entities.facts(held.entity);
            if (facts === undefined) throw new Refusal("UNKNOWN_ENTITY", `The entity ${held.entity} is not connected to the server.`);
            holding = new Holding(held, { ...facts });
            this.session.holdings.set(key, holding);
        }
        return new CheckOut(this.session, holding);
    }

    /**
     * Stops entities, whoever holds them: those that are named, those that this client holds, or all. An empty list means all.
     *
     * Resolves when all receipts have arrived, or after the deadline with what is known. Look at every receipt: only `confirmed`
     * says that the robot application was told, and only `standstillMs` that the machine stands still.
     */
    async stop(which: readonly string[] | "held" | "all", options: StopOptions = {}): Promise<readonly Receipt[]> {
        if (which !== "held") return stopAll(this.session, which === "all" || which.length === 0 ? undefined : which, options);
        const mine = this.session.core.leases.held().map(({ entity }) => entity);
        return mine.length === 0 ? [] : stopAll(this.session, mine, options);
    }
    /** Measures how long a stop takes, without stopping anything. Makes `count` tries, one every `periodMs`. */
    async drill(which: readonly string[] | "all", count = 1, periodMs = 100): Promise<readonly DrillReport[]> {
        const reports = new Map<string, { entity: string; name: string; managerMs: (number | undefined)[]; callbackMs: (number | undefined)[]; noApplication: boolean }>();
        for (let i = 0; i < count; ++i) {
            const pause = this.session.delay(periodMs);
            const receipts = await new Promise<readonly Receipt[]>((resolve, reject) => {
                this.session.turn(() => this.session.desk.drill(which === "all" ? undefined : which, DRILL_MS, (result) => (result instanceof Refusal ? reject(result) : resolve(result))));
            });
            for (const one of receipts) {
                const report = reports.get(one.entity) ?? { entity: one.entity, name: one.name, managerMs: [], callbackMs: [], noApplication: false };
                report.noApplication = one.noApplication;
                report.managerMs.push(one.managerMs);
                report.callbackMs.push(one.callbackReturnedMs);
                reports.set(one.entity, report);
            }
            if (i + 1 < count) await pause;
        }
        return [...reports.values()];
    }
    async rearm(name: string): Promise<void> {
        const { id } = this.find(name);
        return this.session.ask((done) => this.session.core.commands.rearm(id, done));
    }
    /** Services, findings and watchdogs of an entity, whoever holds it. */
    details(name: string): Promise<Details> {
        return new Promise((resolve, reject) => {
            this.session.turn(() => this.session.core.entities.fetchDetails(this.find(name).id, resolve, (refusal) => reject(refusal)));
        });
    }
    async services(name: string): Promise<readonly Service[]> {
        return (await this.details(name)).services;
    }

    /** Subscribes to streams of an entity, whoever holds it; an empty list means all of them. Throws UNKNOWN_ENTITY. */
    watch(name: string, streams: readonly string[], callback: (sample: Sample) => void): End {
        const { session } = this;
        const entity = this.find(name).id;
        const watch: WatchEntry = { entity, streams: [...streams], callback };
        session.turn(() => session.core.watches.watch(entity, watch.streams));
        session.watches.add(watch);
        return () => {
            if (session.watches.delete(watch)) session.turn(() => session.core.watches.unwatch(entity, watch.streams));
        };
    }

    /** The global services that the front-end server offers, and what it found in their files. */
    globalServices(): Promise<GlobalServices> {
        return new Promise((resolve, reject) => {
            this.session.turn(() => this.session.core.runs.fetchServices(resolve, (refusal) => reject(refusal)));
        });
    }
    /** Finds out which entity could play which role. Asks every entity for its services. `chosen` fixes some of the roles. */
    async propose(service: GlobalService, chosen: Bindings = new Map()): Promise<Proposal> {
        const choices = new Map([...chosen].map(([role, name]) => [role, this.find(name).id]));
        const mine = new Set(this.session.core.leases.held().map(({ entity }) => entity));
        const candidates = await Promise.all(
            this.entities().map(async (entity): Promise<Candidate> => {
                const { id, category, type, state, latched, holder } = entity;
                const facts = { entity: id, name: this.label(id), category, type, state, latched, holder: holder?.name ?? "", heldHere: mine.has(id) };
                try {
                    return { ...facts, services: await this.services(id), silent: "" };
                } catch (error) {
                    return { ...facts, services: [], silent: error instanceof Error ? error.message : String(error) };
                }
            }),
        );
        return propose(rolesOf(service), candidates, choices);
    }
    /**
     * Asks `master`, one of the participants, to carry the service out. Every role needs a different entity that this client
     * holds. Objections of the participants arrive as state REFUSED with all problems; nothing has moved then.
     */
    runGlobal(service: GlobalService, bindings: Bindings, master: string): Run {
        return this.begin(service, bindings, master, false);
    }
    /** Checks whether runGlobal() would be possible. Nothing moves. Ends as SUCCEEDED, or as REFUSED with the problems. */
    checkGlobal(service: GlobalService, bindings: Bindings, master: string): Run {
        return this.begin(service, bindings, master, true);
    }
    private begin(service: GlobalService, bindings: Bindings, master: string, checkOnly: boolean): Run {
        return this.session.turn(() => {
            const players = new Map([...bindings].map(([role, name]) => [role, this.find(name).id]));
            const { runs } = this.session.core;
            const id = runs.run({ service, players, master: this.find(master).id, checkOnly, askedAtMs: Date.now() });
            const followed = new Followed(id, runs.report(id) as RunReport);
            if (!isFinalRun(followed.report.state)) this.session.runs.set(id, followed);
            return new Run(this.session, followed);
        });
    }
    /** The past runs whose master was one of these entities; without names, of every entity. At most `most` of each; 0 = all. */
    async runHistory(names: readonly string[] = [], most = 0): Promise<RunHistory> {
        const asked = names.length === 0 ? this.entities() : names.map((name) => this.find(name));
        const silent: { name: string; why: Refusal }[] = [];
        const all = await Promise.all(
            [...new Map(asked.map((one) => [one.id, one])).values()].map(async ({ id }) => {
                try {
                    return await new Promise<readonly RunRecord[]>((resolve, reject) => {
                        this.session.turn(() => this.session.core.runs.fetchRecords(id, most, resolve, (refusal) => reject(refusal)));
                    });
                } catch (error) {
                    if (!(error instanceof Refusal)) throw error;
                    silent.push({ name: this.label(id), why: error });
                    return [];
                }
            }),
        );
        return { runs: all.flat().sort((a, b) => b.askedAt.getTime() - a.askedAt.getTime()), silent };
    }

    /** Releases what this client holds, waits for the answers and ends the session. */
    close(): Promise<void> {
        return this.session.close();
    }
}
