// SPDX-License-Identifier: GPL-2.0-or-later
import type * as proto from "../../gen/messages.js";
import { fromHex, hex, type Id, idOf, randomUuid, uuidText } from "../ids.js";
import { Refusal } from "../refusal.js";
import type { Argument, TaskReport, TaskState, Value } from "../types.js";
import { isFinalTask, knownProgress, taskFollows, taskStateOf, toRefusal, toResults } from "../wire/content.js";
import { toParam } from "../wire/values.js";
import { type Done, type Held, keyOf, type Parts, TASKS_KEPT } from "./context.js";
import type { Action, Requests } from "./requests.js";

const ACTIONS: Readonly<Record<Action, number>> = { pause: 1, resume: 2, cancel: 3 };
/** Results of one task; an application that gives more of them is ignored from there on. */
const RESULTS_MAX = 1024;

/** Pause, resume and cancel are one message for tasks and runs. Returns its number. */
export function sendControl(parts: Parts, id: Id, under: Held, action: Action): number {
    return parts.context.send(under.entity, "TASK_CONTROL", under.lease, { taskControl: { taskId: fromHex(id), action: ACTIONS[action] } });
}
/** Asks for it, in the place of what was asked before for the same id. */
export function requestControl(parts: Parts, id: Id, under: Held, final: string | undefined, action: Action, noun: "task" | "run", done: Done): void {
    if (final !== undefined) throw new Refusal("WRONG_STATE", `The ${noun} has ended already: ${final}.`);
    parts.leases.ready(under);
    parts.requests.settle("control", id, new Refusal("CANCELLED", `A newer request for the same ${noun} took its place.`));
    const sequence = sendControl(parts, id, under, action);
    parts.requests.await(id, { kind: "control", action, done }, { ...under, sequence });
}
/** It is in this state now: answers the request for it, where that says so. */
export function settleControl(requests: Requests, id: Id, state: string, isFinal: boolean, noun: "task" | "run"): void {
    const pending = requests.find("control", id);
    if (pending === undefined) return;
    const { action } = pending.what;
    if (isFinal) {
        const unknown = state === "UNKNOWN";
        if (action === "cancel" && !unknown) requests.settle("control", id);
        else requests.settle("control", id, new Refusal(unknown ? "OUTCOME_UNKNOWN" : "WRONG_STATE", `The ${noun} has ended meanwhile: ${state}.`));
    } else if ((action === "pause" && state === "PAUSED") || (action === "resume" && state === "RUNNING")) {
        requests.settle("control", id);
    }
}

interface Entry {
    readonly held: Held;
    report: TaskReport;
}

/** Which tasks were asked for, and their state. A report never leaves a final state. */
export class Tasks {
    private readonly tasks = new Map<Id, Entry>();
    private readonly open = new Map<string, Set<Id>>(); // of a lease
    private readonly finished: Id[] = [];
    private openCount = 0;

    constructor(private readonly parts: Parts) {}

    get anyOpen(): boolean {
        return this.openCount > 0;
    }
    has(id: Id): boolean {
        return this.tasks.has(id);
    }
    report(id: Id): TaskReport | undefined {
        return this.tasks.get(id)?.report;
    }
    /** A refusal arrives in the report. */
    run(held: Held, service: string, args: readonly Argument[], notAfterMs: number): Id {
        const { context, leases, requests, server } = this.parts;
        const id = randomUuid(context.random);
        const report: TaskReport = {
            id: uuidText(id),
            entity: held.entity,
            service,
            state: "QUEUED",
            progress: undefined,
            feedback: "",
            results: new Map(),
            reason: undefined,
            accepted: false,
        };
        const entry: Entry = { held, report };
        this.tasks.set(id, entry);
        ++this.openCount;
        const key = keyOf(held);
        this.open.set(key, (this.open.get(key) ?? new Set()).add(id));
        try {
            const backlog = context.link?.backlog();
            if (backlog !== undefined && isFull(backlog)) throw overloaded();
            leases.ready(held);
            const chosen = leases.service(held, service);
            const params = args.map((argument) => toParam(chosen, argument));
            entry.report = { ...report, service: chosen.name };
            const sequence = context.send(held.entity, "TASK", held.lease, { task: { taskId: fromHex(id), service: chosen.name, params, notAfterS: Math.max(notAfterMs, 0) / 1000 } });
            requests.await(id, { kind: "startTask" }, { ...held, sequence });
            server.beatNow();
            server.pace();
        } catch (error) {
            // Whatever it is, the task has not been sent: it must not stay open.
            this.finish(id, "REFUSED", error instanceof Refusal ? error : new Refusal("MALFORMED", `The arguments cannot be sent: ${error instanceof Error ? error.message : String(error)}`));
        }
        return id;
    }
    onEvent(entity: string, event: proto.TaskEvent): void {
        const { context, leases, requests, server } = this.parts;
        const id = idOf(event.taskId);
        const state = taskStateOf(event.state);
        if (id === undefined || state === undefined) {
            ++context.malformed;
            return;
        }
        const entry = this.tasks.get(id);
        if (entry === undefined || entry.held.entity !== entity) return;
        requests.settle("startTask", id);
        const { report } = entry;
        if (isFinalTask(report.state)) {
            // Given up here, alive there: a task whose outcome this client has called unknown must not go on.
            if (report.state === "UNKNOWN" && !isFinalTask(state) && leases.find(entry.held) !== undefined) sendControl(this.parts, id, entry.held, "cancel");
            return;
        }
        if (!taskFollows(report.state, state)) return;
        const progress = knownProgress(event.progress);
        const results = new Map<string, readonly Value[]>(report.results);
        for (const [name, values] of toResults(event.results)) if (results.size < RESULTS_MAX || results.has(name)) results.set(name, values);
        entry.report = {
            ...report,
            state,
            accepted: report.accepted || !isFinalTask(state),
            progress: progress === undefined ? report.progress : Math.min(Math.max(report.progress ?? 0, progress), 1),
            feedback: event.feedback === "" ? report.feedback : event.feedback,
            results,
            reason: toRefusal(event.reason),
        };
        const told = entry.report;
        if (isFinalTask(state)) this.noteFinal(id);
        else if (leases.find(entry.held) === undefined) this.awaitEnd(id, entry);
        // The report first: whoever waited for the pause finds the task paused.
        context.observer.task(told);
        settleControl(requests, id, told.state, isFinalTask(told.state), "task");
        if (state === "REFUSED" && told.reason !== undefined) leases.onRefusal(entity, entry.held.lease, told.reason);
        server.pace();
    }
    finish(id: Id, state: TaskState, why: Refusal): void {
        const entry = this.tasks.get(id);
        if (entry === undefined || isFinalTask(entry.report.state)) return;
        this.parts.requests.settle("startTask", id);
        entry.report = { ...entry.report, state, reason: why };
        this.noteFinal(id);
        this.parts.context.observer.task(entry.report);
        settleControl(this.parts.requests, id, state, true, "task");
        this.parts.server.pace();
    }
    private noteFinal(id: Id): void {
        --this.openCount;
        const key = keyOf((this.tasks.get(id) as Entry).held);
        const open = this.open.get(key);
        open?.delete(id);
        if (open?.size === 0) this.open.delete(key);
        this.finished.push(id);
        while (this.finished.length > TASKS_KEPT) this.tasks.delete(this.finished.shift() as Id);
    }
    private openOf(held: Held): Id[] {
        return [...(this.open.get(keyOf(held)) ?? [])];
    }
    finishAll(held: Held, unknown: Refusal): void {
        for (const id of this.openOf(held)) this.finish(id, "UNKNOWN", unknown);
    }
    /** Those whose lease is no longer here. */
    finishUnheld(unknown: Refusal): void {
        for (const id of [...this.open.values()].flatMap((ids) => [...ids])) {
            const entry = this.tasks.get(id);
            if (entry !== undefined && this.parts.leases.find(entry.held) === undefined) this.finish(id, "UNKNOWN", unknown);
        }
    }
    private awaitEnd(id: Id, entry: Entry): void {
        if (this.parts.requests.find("startTask", id) === undefined) this.parts.requests.await(id, { kind: "startTask" }, entry.held);
    }
    awaitEnds(held: Held): void {
        for (const id of this.openOf(held)) this.awaitEnd(id, this.tasks.get(id) as Entry);
    }
    onDue(id: Id): void {
        const entry = this.tasks.get(id);
        if (entry === undefined) return void this.parts.requests.take("startTask", id);
        // It may or may not run: say so, and make an end of it if it does.
        if (this.parts.leases.isReady(entry.held)) sendControl(this.parts, id, entry.held, "cancel");
        this.finish(id, "UNKNOWN", new Refusal("OUTCOME_UNKNOWN", `${this.parts.entities.label(entry.held.entity)} has not answered the request in time.`));
    }
    /** Of a lease that was resumed. */
    askAfter(held: Held): void {
        const tasks = this.openOf(held);
        if (tasks.length === 0) return;
        const request = this.parts.context.random(16);
        const sequence = this.parts.context.send(held.entity, "STATUS", held.lease, { statusRequest: { requestId: request } });
        this.parts.requests.await(hex(request), { kind: "askAfterTasks", tasks }, { ...held, sequence });
    }
    /** Whether the status answers askAfter(). */
    onAnswer(status: proto.EntityStatus): boolean {
        const request = idOf(status.requestId);
        const pending = request === undefined ? undefined : this.parts.requests.take("askAfterTasks", request);
        if (pending === undefined) return false;
        const alive = new Set(status.tasks.map(({ taskId }) => hex(taskId)));
        for (const id of pending.what.tasks) {
            if (!alive.has(id)) this.finish(id, "UNKNOWN", new Refusal("OUTCOME_UNKNOWN", `${this.parts.entities.label(pending.entity)} has no record of how it ended.`));
        }
        return true;
    }
    onAskAfterDue(request: Id): void {
        const pending = this.parts.requests.take("askAfterTasks", request);
        for (const id of pending?.what.tasks ?? []) {
            this.finish(id, "UNKNOWN", new Refusal("OUTCOME_UNKNOWN", `${this.parts.entities.label(pending?.entity ?? "")} has not said in time what became of it.`));
        }
    }
    control(id: Id, action: Action, done: Done): void {
        const entry = this.tasks.get(id);
        if (entry === undefined) throw new Refusal("UNKNOWN_TASK", "This client has no record of such a task.");
        const { state } = entry.report;
        requestControl(this.parts, id, entry.held, isFinalTask(state) ? state : undefined, action, "task", done);
    }
}

/** What a program sends is refused before it is lost. */
const WAITING_MESSAGES_MAX = 256;
const WAITING_BYTES_MAX = 16 * 1024 * 1024;
export const isFull = ({ messages, bytes }: { messages: number; bytes: number }): boolean => messages >= WAITING_MESSAGES_MAX || bytes >= WAITING_BYTES_MAX;
export const overloaded = (): Refusal => new Refusal("OVERLOADED", "Too much waits to be sent to the server. Wait until it has read it, then try again.");
