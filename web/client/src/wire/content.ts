// SPDX-License-Identifier: GPL-2.0-or-later
// Between the messages of api/proto and the public types. Pure functions; what arrives may say anything.
import type * as proto from "../../gen/messages.js";
import * as enums from "../../gen/messages.js";
import type { GlobalService, GlobalServices, GlobalStep, OnFailure, RunProblem, RunRecord, RunState, StepReport } from "../global_types.js";
import { idOf, uuidText } from "../ids.js";
import { Refusal, refusalOf } from "../refusal.js";
import type { Content, DataType, Details, EntityState, HandOverPolicy, OnClientLoss, Parameter, ParameterKind, Sample, Service, TaskState, Value } from "../types.js";
import type { Init } from "./codec.js";

const STATES: readonly EntityState[] = ["UNAV", "INIT", "ENVCONN", "IDLE", "REG", "COLLAB", "SLAVE", "BUSY", "ERR"];
const TASK_STATES: readonly TaskState[] = ["QUEUED", "DISPATCHED", "RUNNING", "PAUSED", "SUCCEEDED", "FAILED", "STOPPED", "CANCELLED", "REFUSED", "UNKNOWN"];
const RUN_STATES: readonly RunState[] = ["CHECKING", "RUNNING", "PAUSED", "HELD", "STOPPING", "COMPENSATING", "SUCCEEDED", "FAILED", "STOPPED", "CANCELLED", "REFUSED", "UNKNOWN"];
const DATA_TYPES: readonly DataType[] = ["", "INT", "DBL", "STR", "BOOL"];
const KINDS: readonly ParameterKind[] = ["INPUT", "OUTPUT", "CONFIG", "FEEDBACK"];
const ON_CLIENT_LOSS: readonly OnClientLoss[] = ["stop", "hold", "finish"];
const ON_FAILURE: readonly OnFailure[] = ["stop-all", "hold-others", "compensate"];

/** What is above 2^53 - 1 becomes that. */
export function safeNumber(value: bigint): number {
    const most = BigInt(Number.MAX_SAFE_INTEGER);
    return Number(value > most ? most : value < -most ? -most : value);
}
/** Makes -0 a 0, and what is no number nothing. */
function known(value: number): number | undefined {
    return Number.isFinite(value) && value >= 0 ? value + 0 : undefined;
}
/** A laboratory is smaller: what says something else, or is no number, is no place. */
const PLACE_MAX_MM = 1e9;
const isPlace = (metres: number): boolean => Math.abs(metres * 1000) <= PLACE_MAX_MM;
function seconds(value: number): number {
    return Number.isFinite(value) ? value * 1000 : 0;
}

/** The state on the wire counts from 1. */
export const stateOf = (state: number): EntityState | undefined => STATES[state - 1];
export const taskStateOf = (state: number): TaskState | undefined => TASK_STATES[state - 1];
export const runStateOf = (state: number): RunState | undefined => RUN_STATES[state - 1];
/** The state in Slice counts from 0. */
export const stateInSlice = (state: number): EntityState => STATES[state] ?? "UNAV";

export function isFinalTask(state: TaskState): boolean {
    return TASK_STATES.indexOf(state) >= TASK_STATES.indexOf("SUCCEEDED");
}
export function isFinalRun(state: RunState): boolean {
    return RUN_STATES.indexOf(state) >= RUN_STATES.indexOf("SUCCEEDED");
}
/** Duplicates and late-comers must not turn a task back: only pause and resume go both ways. */
export function taskFollows(now: TaskState, next: TaskState): boolean {
    if (isFinalTask(now)) return false;
    return TASK_STATES.indexOf(next) >= TASK_STATES.indexOf(now) || (now === "PAUSED" && next === "RUNNING");
}

export function toRefusal(refusal: proto.Refusal | undefined): Refusal | undefined {
    return refusal === undefined ? undefined : refusalOf(refusal.code, refusal.message, refusal.holder);
}

export function toValue(value: proto.Value): Value {
    return value.int ?? value.dbl ?? value.bool ?? value.str ?? "";
}
export function fromValue(value: Value): Init<proto.Value> {
    switch (typeof value) {
        case "bigint":
            return { int: value };
        case "number":
            return { dbl: value };
        case "boolean":
            return { bool: value };
        default:
            return { str: value };
    }
}
export function textOf(value: Value): string {
    return String(value);
}

function valuesOf(params: readonly proto.Param[]): Map<string, readonly Value[]> {
    return new Map(params.map(({ name, values }) => [name, values.map(toValue)]));
}
export { valuesOf as toResults };

function toParameter(meta: proto.CtrlParam): Parameter {
    return {
        name: meta.name,
        kind: KINDS[meta.type] ?? "INPUT",
        dataType: DATA_TYPES[meta.dataType] ?? "",
        units: meta.units,
        descr: meta.descr,
        ready: meta.ready,
        required: meta.required,
        savable: meta.savable,
        multiple: meta.multiple,
        values: meta.initial.map(toValue),
        choices: meta.choices.map(toValue),
        minimum: meta.minimum,
        maximum: meta.maximum,
    };
}

export function toService(service: proto.Service): Service {
    return {
        name: service.name,
        globalId: service.globalId,
        kind: service.type === enums.ServiceType.CMPLX ? "CMPLX" : "SMPL",
        descr: service.descr,
        notes: service.notes,
        active: service.isActive,
        inactiveReason: service.inactiveReason,
        executing: service.isExec,
        blocking: service.isBlocking,
        pausable: service.isPausable,
        onClientLoss: ON_CLIENT_LOSS[service.onClientLoss] ?? "stop",
        parameters: service.params.map(toParameter),
        resources: service.resources.map(({ name, descr, ready, required, savable, size }) => ({ name, descr, ready, required, savable, size: safeNumber(size) })),
        missing: service.missing,
        parts: service.serviceList,
    };
}

export function toDetails(status: proto.EntityStatus): Details {
    return {
        services: status.services.map(toService),
        watchdogs: status.watchdogs.map(({ hop, timeoutMs, longestGapMs }) => ({ hop, timeoutMs, longestGapMs })),
        findings: status.findings.map(({ message, fix }) => ({ message, fix })),
    };
}

export function fromPolicy(policy: HandOverPolicy): Init<proto.HandOverPolicy> {
    const within = policy.answerWithinMs ?? 30_000;
    return { answerWithinS: Math.min(Math.max(within / 1000, 0), 600), yield: policy.yield === true && policy.refuse !== true };
}

function toContent(sample: proto.StreamSample): Content | undefined {
    const { scalar, vector, pose, scan, image, raw } = sample;
    if (scalar !== undefined) return { kind: "scalar", value: scalar.value, units: scalar.units };
    if (vector !== undefined) return { kind: "vector", values: vector.values, units: vector.units };
    if (pose !== undefined) return [pose.x, pose.y, pose.z].every(isPlace) && Number.isFinite(pose.yaw) ? { kind: "pose", ...pose } : undefined;
    if (scan !== undefined) return { kind: "scan", ...scan };
    if (image !== undefined) return { kind: "picture", ...image };
    return raw === undefined ? undefined : { kind: "raw", bytes: raw };
}
export function toSample(entity: string, sample: proto.StreamSample, arrivedAtMs: number): Sample | undefined {
    const content = toContent(sample);
    if (content === undefined) return undefined;
    return { entity, stream: sample.stream, sequence: safeNumber(sample.sequence), takenAtUs: safeNumber(sample.takenAtUs), arrivedAtMs, content };
}

const CATEGORIES: Readonly<Record<number, string>> = { 1: "ROBOT", 2: "MACHINE" };
const MOBILITIES: Readonly<Record<number, string>> = { 1: "MOBILE", 2: "STATIONARY" };

function toStep(step: proto.GlobalStep): GlobalStep {
    return {
        role: step.role,
        category: CATEGORIES[step.category] ?? "",
        type: MOBILITIES[step.type] ?? "",
        serviceGlobalId: step.serviceGlobalId,
        preced: step.preced,
        name: step.name,
        parameters: step.params.map(({ name, values, units }) => ({ name, values: values.map(toValue), units, fromText: true })),
        sources: step.sources.map(({ param, step: from, output }) => ({ parameter: param, step: from, output })),
    };
}
function fromStep(step: GlobalStep): Init<proto.GlobalStep> {
    return {
        category: step.category === "ROBOT" ? 1 : step.category === "MACHINE" ? 2 : 0,
        type: step.type === "MOBILE" ? 1 : step.type === "STATIONARY" ? 2 : 0,
        role: step.role,
        serviceGlobalId: step.serviceGlobalId,
        preced: step.preced,
        name: step.name,
        params: step.parameters.map(({ name, values, units }) => ({ name, units: units ?? "", values: values.map((value) => ({ str: textOf(value) })) })),
        sources: step.sources.map(({ parameter, step: from, output }) => ({ param: parameter, step: from, output })),
    };
}
export function toGlobalService(service: proto.GlobalService, file = ""): GlobalService {
    return {
        name: service.name,
        descr: service.descr,
        file,
        onFailure: ON_FAILURE[service.onFailure] ?? "stop-all",
        steps: service.steps.map(toStep),
        compensation: service.compensation.map(toStep),
    };
}
export function fromGlobalService(service: GlobalService): Init<proto.GlobalService> {
    return {
        name: service.name,
        descr: service.descr,
        onFailure: ON_FAILURE.indexOf(service.onFailure),
        steps: service.steps.map(fromStep),
        compensation: service.compensation.map(fromStep),
    };
}
export function toGlobalServices(services: proto.GlobalServices): GlobalServices {
    return {
        services: services.files.flatMap(({ name, profile, bad }) => (bad ? [] : (profile?.services ?? []).map((one) => toGlobalService(one, name)))),
        files: services.files.map(({ name, findings, bad }) => ({ name, findings, bad })),
    };
}

export function toStepReport(status: proto.StepStatus): StepReport {
    const state = taskStateOf(status.state);
    const since = (at: number): number | undefined => (Number.isFinite(at) && at >= 0 ? at * 1000 : undefined);
    return {
        step: status.step,
        compensation: false,
        called: "",
        entity: status.entity,
        name: status.name,
        service: status.service,
        preced: status.preced,
        state,
        progress: known(status.progress),
        feedback: status.feedback,
        parameters: valuesOf(status.params),
        results: valuesOf(status.results),
        reason: toRefusal(status.reason),
        // A step whose turn has not come has no times, whatever its fields are by default.
        beganMs: state === undefined ? undefined : since(status.beganS),
        endedMs: state !== undefined && isFinalTask(state) ? since(status.endedS) : undefined,
        tries: Math.max(status.tries, 1),
    };
}
export function toProblem(problem: proto.Problem): RunProblem {
    return { step: problem.step, entity: problem.entity, refusal: toRefusal(problem.refusal) ?? new Refusal("INTERNAL", "no reason is given") };
}
export function toRunRecord(record: proto.RunRecord): RunRecord {
    const id = idOf(record.runId);
    const service = toGlobalService(record.service ?? { name: "", descr: "", steps: [], onFailure: 0, compensation: [] });
    const steps = record.steps.map((status) => {
        const step = toStepReport(status);
        return { ...step, compensation: step.step >= service.steps.length, called: service.steps[step.step]?.name ?? "" };
    });
    return {
        id: id === undefined ? "" : uuidText(id),
        service,
        by: record.by,
        master: record.master,
        participants: record.participants.map(({ role, entity, name }) => ({ role, entity, name })),
        askedAt: new Date(safeNumber(record.askedAtMs)),
        durationMs: seconds(record.durationS),
        state: runStateOf(record.state) ?? "UNKNOWN",
        reason: toRefusal(record.reason),
        steps: steps.sort((a, b) => a.step - b.step),
    };
}
export { known as knownProgress, seconds as secondsToMs };
