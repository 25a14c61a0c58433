// SPDX-License-Identifier: GPL-2.0-or-later
import type * as proto from "../../gen/messages.js";
import type { GlobalService, GlobalServices, GlobalStep, RunRecord, RunReport, RunState, StepReport } from "../global_types.js";
import { fromHex, hex, type Id, idOf, randomUuid, uuidText } from "../ids.js";
import { Refusal } from "../refusal.js";
import { NO_LEASE } from "../transport.js";
import type { Parameter } from "../types.js";
import { encode } from "../wire/codec.js";
import { fromGlobalService, isFinalRun, isFinalTask, runStateOf, secondsToMs, toGlobalServices, toProblem, toRefusal, toRunRecord, toStepReport } from "../wire/content.js";
import { Context, type Done, type Held, keyOf, OUTCOME_AGAIN_MS, type Parts, RUNS_KEPT } from "./context.js";
import { rolesOf } from "./proposal.js";
import type { Action } from "./requests.js";
import { seal } from "./sub_lease.js";
import { isFull, overloaded, requestControl, sendControl, settleControl } from "./tasks.js";

/** More than any service has, and few enough to be kept. */
const STEPS_MAX = 4096;

/** Who plays which role: role number -> UUID; the master is one of them. */
export interface RunOrder {
    readonly service: GlobalService;
    readonly players: ReadonlyMap<number, string>;
    readonly master: string;
    readonly checkOnly: boolean;
    readonly askedAtMs: number;
}
interface Entry {
    readonly master: Held;
    report: RunReport;
    sequence: bigint;
}

function listed(names: readonly string[]): string {
    return names.join(", ").replace(/, ([^,]*)$/, " and $1");
}
/** Why a value of one parameter can never be one of another; empty where it may. */
function misfit(output: Parameter, input: Parameter): string {
    const numeric = ({ dataType }: Parameter): boolean => dataType === "INT" || dataType === "DBL";
    if (output.dataType !== input.dataType && !(numeric(output) && numeric(input))) return `${output.dataType} is not ${input.dataType}`;
    if (output.units !== input.units && output.units !== "" && input.units !== "") return `${output.units} is not ${input.units}`;
    return "";
}
function merged(steps: readonly StepReport[], changed: readonly StepReport[]): readonly StepReport[] {
    if (changed.length === 0) return steps;
    const all = new Map(steps.map((step) => [step.step, step]));
    for (const one of changed) {
        const known = all.get(one.step);
        if (known === undefined) {
            all.set(one.step, one);
            continue;
        }
        // What the service says of it does not travel; nor, in a record that was too large, what is long.
        const again = one.tries !== known.tries;
        all.set(one.step, {
            ...one,
            compensation: known.compensation,
            called: known.called,
            parameters: again || one.parameters.size > 0 ? one.parameters : known.parameters,
            results: again || one.results.size > 0 ? one.results : known.results,
            feedback: again || one.feedback !== "" ? one.feedback : known.feedback,
        });
    }
    return [...all.values()].sort((a, b) => a.step - b.step);
}

/** Runs of global services: which were asked for, and their state. A report never leaves a final state. */
export class Runs {
    private readonly runs = new Map<Id, Entry>();
    private readonly open = new Set<Id>();
    private readonly finished: Id[] = [];

    constructor(private readonly parts: Parts) {}

    get anyOpen(): boolean {
        return this.open.size > 0;
    }
    report(id: Id): RunReport | undefined {
        return this.runs.get(id)?.report;
    }

    fetchServices(answer: (services: GlobalServices) => void, done: Done): void {
        const { context, requests } = this.parts;
        if (context.link === undefined) throw Context.notConnected();
        const request = context.random(16);
        const head = context.header("", "GLOBAL_SERVICES");
        context.link.request(head, encode("ToEntity", { globalServices: { requestId: request } }));
        requests.await(hex(request), { kind: "globalServices", answer, done }, { sequence: head.seq });
    }
    onServices(services: proto.GlobalServices): void {
        const request = idOf(services.requestId);
        if (request !== undefined) this.parts.requests.take("globalServices", request)?.what.answer(toGlobalServices(services));
    }

    private misfits(order: RunOrder): string {
        const { entities, leases } = this.parts;
        const parameter = (step: GlobalStep, name: string): Parameter | undefined => {
            const services = leases.of(order.players.get(step.role) ?? "")?.services ?? [];
            const service = services.find(({ globalId }) => globalId === step.serviceGlobalId) ?? services.find((one) => one.name === step.serviceGlobalId);
            return service?.parameters.find((one) => one.name === name); // if there is none, the participant says so
        };
        const all: string[] = [];
        for (const step of [...order.service.steps, ...order.service.compensation]) {
            for (const source of step.sources) {
                const from = order.service.steps.find(({ name }) => name === source.step);
                const output = from === undefined ? undefined : parameter(from, source.output);
                const input = parameter(step, source.parameter);
                const why = output === undefined || input === undefined ? "" : misfit(output, input);
                if (why !== "") {
                    const who = entities.label(order.players.get(step.role) ?? "");
                    all.push(`${who}: '${source.parameter}' of ${step.serviceGlobalId} cannot take '${source.output}' of the step '${source.step}': ${why}.`);
                }
            }
        }
        return all.join(" ");
    }

    /** Throws what can be said at once; objections of the participants arrive in the report. */
    run(order: RunOrder): Id {
        const { context, entities, leases, requests, server } = this.parts;
        if (context.link === undefined) throw Context.notConnected();
        if (isFull(context.link.backlog())) throw overloaded();
        const roles = rolesOf(order.service).map(({ number }) => number);
        for (const role of roles) if (!order.players.has(role)) throw new Refusal("MALFORMED", `Nobody plays role ${role}. Bind an entity to each role.`);
        const strangers: string[] = [];
        const roots = new Set<string>();
        const seen = new Set<string>();
        for (const [role, entity] of order.players) {
            if (!roles.includes(role)) throw new Refusal("MALFORMED", `The service has no role ${role}.`);
            if (seen.has(entity)) throw new Refusal("DUPLICATE", `${entities.label(entity)} plays two roles. Each role needs an entity of its own.`);
            seen.add(entity);
            const mine = leases.of(entity);
            if (mine === undefined) {
                strangers.push(entities.label(entity));
                continue;
            }
            leases.ready({ entity, lease: mine.number });
            if (mine.key.length !== 16 || mine.root.length !== 16) {
                throw new Refusal("NOT_SUPPORTED", `${mine.name} has given no key or no root for its lease, so nobody else can be let command it. Update its Entity Manager.`);
            }
            roots.add(hex(mine.root));
        }
        if (strangers.length > 0) throw new Refusal("NOT_HOLDER", `This client does not hold ${listed(strangers)}. Check out every participant first.`);
        if (!seen.has(order.master)) throw new Refusal("MALFORMED", `The master must be one of the participants; ${entities.label(order.master)} is none.`);
        if (roots.size > 1) throw new Refusal("WRONG_STATE", "The participants were checked out by different sessions. Release them and check them all out by one.");
        const misfits = this.misfits(order);
        if (misfits !== "") throw new Refusal("WRONG_TYPE", misfits);

        const id = randomUuid(context.random);
        const participants = [...order.players].map(([role, entity]) => {
            const mine = leases.of(entity);
            if (mine === undefined) throw new Refusal("NOT_HOLDER", `This client does not hold ${entities.label(entity)}.`);
            const lease = { ...mine.number, root: mine.root, stopGeneration: context.marks.of(entity) };
            return { role, entity, name: entities.label(entity), lease: { ...lease, proof: seal(lease, fromHex(id), order.master, entity, mine.key) } };
        });
        const master: Held = { entity: order.master, lease: leases.of(order.master)?.number ?? NO_LEASE };
        const steps = [...order.service.steps, ...order.service.compensation].map(
            (step, i): StepReport => ({
                step: i,
                compensation: i >= order.service.steps.length,
                called: step.name,
                entity: order.players.get(step.role) ?? "",
                name: entities.label(order.players.get(step.role) ?? ""),
                service: step.serviceGlobalId,
                preced: step.preced,
                state: undefined,
                progress: undefined,
                feedback: "",
                parameters: new Map(),
                results: new Map(),
                reason: undefined,
                beganMs: undefined,
                endedMs: undefined,
                tries: 1,
            }),
        );
        const report: RunReport = {
            id: uuidText(id),
            service: order.service.name,
            master: order.master,
            check: order.checkOnly,
            state: "CHECKING",
            progress: 0,
            elapsedMs: 0,
            steps,
            problems: [],
            reason: undefined,
        };
        // Before anything is noted: a service that cannot be written must not leave a run open.
        const sequence = context.send(order.master, "RUN", master.lease, {
            collaboration: { runId: fromHex(id), service: fromGlobalService(order.service), participants, checkOnly: order.checkOnly, askedAtMs: BigInt(Math.round(order.askedAtMs)) },
        });
        this.runs.set(id, { master, report, sequence: 0n });
        this.open.add(id);
        requests.await(id, { kind: "startRun" }, { ...master, sequence });
        server.beatNow();
        server.pace();
        return id;
    }

    onEvent(entity: string, event: proto.RunEvent): void {
        const { context, leases, requests } = this.parts;
        const id = idOf(event.runId);
        const state = runStateOf(event.state);
        if (id === undefined || state === undefined) {
            ++context.malformed;
            return;
        }
        const entry = this.runs.get(id);
        if (entry === undefined || entry.master.entity !== entity) return;
        requests.settle("startRun", id);
        const { report } = entry;
        if (isFinalRun(report.state)) {
            // Given up here, alive there: a run whose outcome this client has called unknown must not go on.
            if (report.state === "UNKNOWN" && !isFinalRun(state) && leases.find(entry.master) !== undefined) sendControl(this.parts, id, entry.master, "cancel");
            return;
        }
        // It lives: nobody need be asked after it.
        for (const one of requests.of(entity)) if (one.what.kind === "askAfterRuns") one.what.runs.delete(id);
        if (event.sequence <= entry.sequence) return; // a duplicate
        entry.sequence = event.sequence;
        const known = event.steps.filter(({ step }) => step >= 0 && step < STEPS_MAX);
        context.malformed += event.steps.length - known.length;
        const steps = merged(report.steps, known.map(toStepReport));
        entry.report = {
            ...report,
            state,
            progress: Number.isFinite(event.progress) ? Math.min(Math.max(event.progress, 0), 1) : report.progress,
            elapsedMs: secondsToMs(event.atS),
            steps,
            // Why it had been held is no reason any more when it goes on.
            reason: event.reason !== undefined ? toRefusal(event.reason) : state === "RUNNING" ? undefined : report.reason,
            problems: event.problems.length > 0 ? event.problems.map(toProblem).sort((a, b) => a.step - b.step) : report.problems,
        };
        if (!isFinalRun(state) && leases.find(entry.master) === undefined) this.awaitEnd(id, entry);
        this.tell(id, entry);
    }
    private tell(id: Id, entry: Entry): void {
        const { report } = entry;
        if (isFinalRun(report.state) && this.open.delete(id)) {
            this.finished.push(id);
            while (this.finished.length > RUNS_KEPT) this.runs.delete(this.finished.shift() as Id);
        }
        // The report first: whoever waited for the pause finds the run paused.
        this.parts.context.observer.run(report);
        settleControl(this.parts.requests, id, report.state, isFinalRun(report.state), "run");
        this.parts.server.pace();
    }
    finish(id: Id, state: RunState, why: Refusal | undefined): void {
        const entry = this.runs.get(id);
        if (entry === undefined || isFinalRun(entry.report.state)) return;
        this.parts.requests.settle("startRun", id);
        // Of what was under way nothing more is heard.
        const steps = entry.report.steps.map((step) => (step.state !== undefined && !isFinalTask(step.state) ? { ...step, state: "UNKNOWN" as const } : step));
        entry.report = { ...entry.report, state, reason: why, steps };
        this.tell(id, entry);
    }
    private openOf(master: Held): Id[] {
        return [...this.open].filter((id) => keyOf((this.runs.get(id) as Entry).master) === keyOf(master));
    }
    finishAll(master: Held, unknown: Refusal): void {
        for (const id of this.openOf(master)) this.finish(id, "UNKNOWN", unknown);
    }
    finishUnheld(unknown: Refusal): void {
        for (const id of [...this.open]) if (this.parts.leases.find((this.runs.get(id) as Entry).master) === undefined) this.finish(id, "UNKNOWN", unknown);
    }
    /** The master refuses the request itself. */
    onRefused(id: Id, entity: string, why: Refusal): void {
        const entry = this.runs.get(id);
        // Once an event has come, a refusal is of something else, and the robots may move.
        if (entry === undefined || entry.master.entity !== entity || entry.sequence !== 0n) return;
        if (this.parts.requests.find("startRun", id) !== undefined) this.finish(id, "REFUSED", why);
    }
    private awaitEnd(id: Id, entry: Entry): void {
        if (this.parts.requests.find("startRun", id) === undefined) this.parts.requests.await(id, { kind: "startRun" }, entry.master);
    }
    awaitEnds(master: Held): void {
        for (const id of this.openOf(master)) this.awaitEnd(id, this.runs.get(id) as Entry);
    }
    onDue(id: Id): void {
        const entry = this.runs.get(id);
        if (entry === undefined) return void this.parts.requests.take("startRun", id);
        if (this.parts.leases.isReady(entry.master)) sendControl(this.parts, id, entry.master, "cancel");
        this.finish(id, "UNKNOWN", new Refusal("OUTCOME_UNKNOWN", `${this.parts.entities.label(entry.master.entity)}, its master, has not answered the request in time.`));
    }
    control(id: Id, action: Action, done: Done): void {
        const entry = this.runs.get(id);
        if (entry === undefined) throw new Refusal("UNKNOWN_TASK", "This client has no record of such a run.");
        const { state } = entry.report;
        requestControl(this.parts, id, entry.master, isFinalRun(state) ? state : undefined, action, "run", done);
    }

    fetchRecords(entity: string, most: number, answer: (records: readonly RunRecord[]) => void, done: Done): void {
        if (!this.parts.context.connected) throw Context.notConnected();
        this.parts.entities.there(entity);
        const request = this.parts.context.random(16);
        const sequence = this.parts.context.send(entity, "RUN", NO_LEASE, { runHistory: { requestId: request, most: Math.max(Math.trunc(most), 0) } });
        this.parts.requests.await(hex(request), { kind: "runRecords", answer, done }, { entity, sequence });
    }
    /** Of a master whose lease was resumed: asks again every second how its runs have ended. */
    askAfter(master: Held): void {
        const runs = new Set(this.openOf(master));
        if (runs.size === 0) return;
        const id = hex(this.parts.context.random(16));
        const now = this.parts.context.now();
        const until = now + this.parts.context.settings.timeoutMs;
        this.parts.requests.await(id, { kind: "askAfterRuns", runs, until }, { ...master, deadline: Math.min(until, now + OUTCOME_AGAIN_MS) });
        this.sendHistoryRequest(id, master);
    }
    private sendHistoryRequest(id: Id, master: Held): void {
        this.parts.context.send(master.entity, "RUN", master.lease, { runHistory: { requestId: fromHex(id) } });
    }
    onAskAfterDue(id: Id): void {
        const pending = this.parts.requests.find("askAfterRuns", id);
        if (pending === undefined) return;
        const { entity, lease, what } = pending;
        const now = this.parts.context.now();
        if (what.runs.size === 0 || now >= what.until) {
            this.parts.requests.take("askAfterRuns", id);
            for (const run of what.runs) this.finish(run, "UNKNOWN", new Refusal("OUTCOME_UNKNOWN", `${this.parts.entities.label(entity)}, its master, does not say what became of it.`));
            return;
        }
        this.sendHistoryRequest(id, { entity, lease }); // it may be ending at this moment
        pending.deadline = Math.min(what.until, now + OUTCOME_AGAIN_MS);
    }
    onHistory(entity: string, history: proto.RunHistory): void {
        const request = idOf(history.requestId);
        if (request === undefined) return;
        const asked = this.parts.requests.take("runRecords", request);
        if (asked !== undefined) return asked.what.answer(history.runs.map(toRunRecord));
        const pending = this.parts.requests.find("askAfterRuns", request);
        if (pending === undefined || pending.entity !== entity) return;
        for (const record of history.runs) {
            const id = idOf(record.runId);
            const state = runStateOf(record.state);
            if (id === undefined || state === undefined || !this.open.has(id)) continue;
            pending.what.runs.delete(id);
            this.parts.requests.settle("startRun", id);
            const entry = this.runs.get(id) as Entry;
            const recorded = toRunRecord(record);
            const steps = merged(entry.report.steps, recorded.steps.filter(({ step }) => step >= 0 && step < STEPS_MAX));
            entry.report = { ...entry.report, steps, elapsedMs: recorded.durationMs, progress: state === "SUCCEEDED" ? 1 : entry.report.progress };
            if (isFinalRun(state)) {
                this.finish(id, state, recorded.reason);
            } else {
                // It lives, and the master tells what comes.
                entry.report = { ...entry.report, state, reason: recorded.reason };
                this.tell(id, entry);
            }
        }
        if (pending.what.runs.size === 0) this.parts.requests.take("askAfterRuns", request);
    }
}
