// SPDX-License-Identifier: GPL-2.0-or-later
// The values that the library takes and returns. They are plain values: a program may keep them, and the library never changes
// one that it has returned. Texts come from other machines: show them as text, never as HTML.
import type { Refusal } from "./refusal.js";

/** The nine states of an Entity Manager. */
export type EntityState = "UNAV" | "INIT" | "ENVCONN" | "IDLE" | "REG" | "COLLAB" | "SLAVE" | "BUSY" | "ERR";
/** What a client can do with an entity that is in a state: nothing, check it out or give it a task, or wait for its task. */
export type Availability = "away" | "ready" | "working";
export type Role = "observer" | "operator" | "admin";

export interface Sender {
    readonly id: string;
    /** For people: user@host, or the name of an entity. */
    readonly name: string;
    readonly role: Role;
}

/**
 * One value of a parameter. INT is a bigint, because it has 64 bits; DBL is a number. A whole number is accepted where an INT
 * is expected, and a bigint where a DBL is. Everything else that counts or measures in this library is a number; what is above
 * 2^53 - 1 on the wire is 2^53 - 1 here.
 */
export type Value = bigint | number | string | boolean;

/** A parameter that is given to a task or set on a service. Only a "multiple" parameter takes more than one value. */
export interface Argument {
    readonly name: string;
    readonly values: readonly Value[];
    /** Refused with WRONG_UNITS if it differs from the profile. */
    readonly units?: string;
    /** Every value is a text, as from an input field, and is parsed by the declared type of the parameter. */
    readonly fromText?: boolean;
}

export type ParameterKind = "INPUT" | "OUTPUT" | "CONFIG" | "FEEDBACK";
/** "" if the entity does not say which. */
export type DataType = "INT" | "DBL" | "STR" | "BOOL" | "";

export interface Parameter {
    readonly name: string;
    readonly kind: ParameterKind;
    readonly dataType: DataType;
    readonly units: string;
    readonly descr: string;
    readonly ready: boolean;
    readonly required: boolean;
    readonly savable: boolean;
    readonly multiple: boolean;
    /** The value that it has now, or that the profile gives. */
    readonly values: readonly Value[];
    /** If not empty, the only values that are accepted. */
    readonly choices: readonly Value[];
    readonly minimum: number | undefined;
    readonly maximum: number | undefined;
}

export interface Resource {
    readonly name: string;
    readonly descr: string;
    readonly ready: boolean;
    readonly required: boolean;
    readonly savable: boolean;
    /** Bytes. */
    readonly size: number;
}

/** SMPL: carried out by the robot application. CMPLX: the services in `parts`, one after the other. */
export type ServiceKind = "SMPL" | "CMPLX";
/** What happens to a running task when its client is lost. */
export type OnClientLoss = "stop" | "hold" | "finish";

export interface Service {
    readonly name: string;
    readonly globalId: string;
    readonly kind: ServiceKind;
    readonly descr: string;
    readonly notes: string;
    readonly active: boolean;
    /** Why it is not active; empty if the robot application gave no reason. */
    readonly inactiveReason: string;
    readonly executing: boolean;
    readonly blocking: boolean;
    readonly pausable: boolean;
    readonly onClientLoss: OnClientLoss;
    readonly parameters: readonly Parameter[];
    readonly resources: readonly Resource[];
    /** Parameters and resources to set or upload before it can run. */
    readonly missing: readonly string[];
    readonly parts: readonly string[];
}

/** The part of an entity's state that every client may see. */
export interface Entity {
    /** UUID. */
    readonly id: string;
    /**
     * False until the robot application has uploaded valid profiles. `name` is then that of the application, `category`, `type`
     * and `descr` are empty, and `reason` says what is missing.
     */
    readonly ready: boolean;
    readonly name: string;
    /** ROBOT or MACHINE. */
    readonly category: string;
    /** MOBILE or STATIONARY. */
    readonly type: string;
    readonly descr: string;
    readonly xMm: number;
    readonly yMm: number;
    readonly zMm: number;
    readonly state: EntityState;
    readonly latched: boolean;
    readonly stopGeneration: number;
    /** Undefined if nobody holds the entity. */
    readonly holder: Sender | undefined;
    /** Of UNAV, INIT and ERR; in IDLE: from whom it was taken, and why. */
    readonly reason: string;
    /** The holder is lost and may still come back. */
    readonly orphaned: boolean;
    /** Clients in its wait list. */
    readonly waiting: number;
    /** To the application and back, in the server's own last drill. */
    readonly stopLatencyMs: number | undefined;
}

export type Presence = "joined" | "changed" | "left";

export interface EntityNews {
    readonly presence: Presence;
    readonly entity: Entity;
    /** It left because this client lost its connection: the entity itself may be where it was. */
    readonly connectionLost: boolean;
}

/** How close a watchdog came to tripping. */
export interface WatchdogMargin {
    readonly hop: string;
    readonly timeoutMs: number;
    /** The longest silence in the last minute. */
    readonly longestGapMs: number;
}

export interface Details {
    readonly services: readonly Service[];
    readonly watchdogs: readonly WatchdogMargin[];
    /** What is wrong, and what to do about it. */
    readonly findings: readonly { readonly message: string; readonly fix: string }[];
}

/**
 * connected      requests are sent.
 * lost           the connection is gone, and the library waits before it logs in again.
 * reconnecting   it is logging in again.
 * closed         final.
 */
export type ConnectionKind = "connected" | "lost" | "reconnecting" | "closed";

export interface ConnectionReport {
    readonly kind: ConnectionKind;
    /** How long ago the connection was made, or lost, or closed: lost and reconnecting count from the loss. */
    readonly ageMs: number;
    /** For how long nothing has come from the server. Unless it is asked (`silent`), it sends a sign of life every 2 s while no task runs. */
    readonly silentMs: number;
    /**
     * When something came from the server last, as Date.now() counts. Date.now() less `silentMs` would be too late after this
     * computer has slept, because the clock of durations stands still meanwhile.
     */
    readonly heardAt: number;
    /** Of "connected": nothing has come for Options.noticeSilenceMs. False until then, and again when something comes. */
    readonly silent: boolean;
    /** Why it was lost, or why the last try to log in again has failed. */
    readonly reason: string;
    /** Tries to log in again since the loss. */
    readonly tries: number;
    /** Until the next try; undefined if none is due. */
    readonly nextTryMs: number | undefined;
    /** Whether stops have a connection of their own, or share the one of data. It may become "own" later. */
    readonly signalLane: "own" | "shared";
    /**
     * Of "closed": why the library has ended the session for good. PERMISSION_DENIED: another user has logged in meanwhile, as in
     * another tab of the same browser. Undefined if the program has closed it.
     */
    readonly ended: Refusal | undefined;
}

export type TaskState = "QUEUED" | "DISPATCHED" | "RUNNING" | "PAUSED" | "SUCCEEDED" | "FAILED" | "STOPPED" | "CANCELLED" | "REFUSED" | "UNKNOWN";

export interface TaskReport {
    /** UUID text of the task. */
    readonly id: string;
    readonly entity: string;
    readonly service: string;
    readonly state: TaskState;
    /** 0 to 1; undefined = not known. */
    readonly progress: number | undefined;
    readonly feedback: string;
    readonly results: ReadonlyMap<string, readonly Value[]>;
    /** Why it failed, was stopped, was refused … */
    readonly reason: Refusal | undefined;
    /** The Entity Manager has accepted it: it is queued there, or has begun. */
    readonly accepted: boolean;
}

/**
 * The result of a stop for one entity, stage by stage (docs/reference/messages.md, "Stages of a receipt"). Times are milliseconds
 * from the call, on this client's clock. A stage that has not answered within the deadline has no time.
 */
export interface Receipt {
    readonly entity: string;
    readonly name: string;
    readonly stopGeneration: number;
    readonly state: EntityState;
    readonly serverMs: number | undefined;
    readonly managerMs: number | undefined;
    readonly callbackReturnedMs: number | undefined;
    readonly standstillMs: number | undefined;
    /** No robot application is linked and none was lost, so there was nothing to stop. */
    readonly noApplication: boolean;
    /** Why nobody can confirm that the robot was stopped; empty = no application was lost. If not, tell a person. */
    readonly applicationLost: string;
    readonly applicationLostForMs: number | undefined;
    /** What the stop callback threw; it is called again until it returns. */
    readonly fault: string;
    /** The robot was moving, and its application will report when it stands still. */
    readonly standstillFollows: boolean;
    /** Running tasks that a reset or a clear has ended, and waiting ones that a clear has removed. */
    readonly tasksEnded: number;
    readonly tasksRemoved: number;
    /** The Entity Manager has answered and, if there is an application, its stop callback has returned. */
    readonly confirmed: boolean;
    /** The stop is confirmed and no report of a standstill is outstanding. */
    readonly atRest: boolean;
}

export interface StopOptions {
    /** How long to wait for the receipts; 1 s. */
    readonly deadlineMs?: number;
    /** How long after the call to wait for robots that are coming to rest, once all stops are confirmed; 0. */
    readonly standstillMs?: number;
    /** Called with everything that is known, whenever a stage is heard of. */
    readonly onProgress?: (receipts: readonly Receipt[]) => void;
}

/** What a drill has measured for one entity: one entry for each try. Undefined means that the answer never arrived. */
export interface DrillReport {
    readonly entity: string;
    readonly name: string;
    readonly managerMs: readonly (number | undefined)[];
    readonly callbackMs: readonly (number | undefined)[];
    readonly noApplication: boolean;
}

/** How requests of other clients for an entity that this client holds are answered. */
export interface HandOverPolicy {
    /** How long the program has to answer; 30 s, at most 600 s. */
    readonly answerWithinMs?: number;
    /** Without an answer: true hands the entity over, false refuses. */
    readonly yield?: boolean;
    /** The library refuses every request at once and does not ask the program. */
    readonly refuse?: boolean;
}

/** Another client asks for an entity that this client holds. */
export interface HandOverRequest {
    readonly by: string;
    readonly reason: string;
    /** Time left. */
    readonly answerWithinMs: number;
    readonly yield: boolean;
    /** The other client has gone, or its time is up: no answer is expected. */
    readonly withdrawn: boolean;
}

/** The progress of a check-out that waits. */
export interface Waiting {
    /** UUID; empty if the check-out waits for several entities. */
    readonly entity: string;
    /** In the Entity Manager's wait list, 1 = next; 0 = not in one. */
    readonly place: number;
    readonly message: string;
}

/** Options of a check-out. The defaults grant it immediately or refuse it. */
export interface CheckOutOptions {
    /**
     * How long to wait for entities that others hold; without a value, do not wait. A check-out of one entity waits in the wait
     * list of its Entity Manager. One of several waits until all of them are free at the same time. With `ask`, it waits for the
     * holder's answer, and then in the wait list if the answer is no.
     */
    readonly waitMs?: number;
    readonly onWaiting?: (waiting: Waiting) => void;
    /** Ask the holder to hand the entity over; for one entity. */
    readonly ask?: boolean;
    /** Take the entities from their holders; for admins. Each robot is stopped first, and its holder is told. */
    readonly force?: boolean;
    /** Shown to the holder, with `ask` and `force`. */
    readonly reason?: string;
    readonly handOver?: HandOverPolicy;
    /** Ends the wait with CANCELLED. */
    readonly signal?: AbortSignal;
}

export interface Scan {
    readonly kind: "scan";
    /** Radians: beam i looks towards startAngle + i * step, or towards angles[i] if there are any. */
    readonly startAngle: number;
    readonly step: number;
    readonly maxRange: number;
    /** Metres. */
    readonly ranges: readonly number[];
    readonly angles: readonly number[];
}
/** Metres and radians, in the entity's own map frame unless `frame` says otherwise. */
export interface Pose {
    readonly kind: "pose";
    readonly x: number;
    readonly y: number;
    readonly z: number;
    readonly roll: number;
    readonly pitch: number;
    readonly yaw: number;
    readonly frame: string;
}
/** A picture. `encoding` says what the pixels are: "jpeg", "png", "rgb8" … */
export interface Picture {
    readonly kind: "picture";
    readonly width: number;
    readonly height: number;
    readonly encoding: string;
    readonly pixels: Uint8Array;
}
export type Content =
    | { readonly kind: "scalar"; readonly value: number; readonly units: string }
    | { readonly kind: "vector"; readonly values: readonly number[]; readonly units: string }
    | Pose
    | Scan
    | Picture
    | { readonly kind: "raw"; readonly bytes: Uint8Array };

/** One sample of a stream. */
export interface Sample {
    readonly entity: string;
    readonly stream: string;
    /** Counts from 1 for each stream; a gap is a dropped sample. */
    readonly sequence: number;
    /** The clock of the entity's host, microseconds. */
    readonly takenAtUs: number;
    /** When it arrived here, on the clock of this client. */
    readonly arrivedAtMs: number;
    readonly content: Content;
}

/** What the server says of a message that had no request, or of itself. */
export interface ServerText {
    readonly code: string;
    readonly text: string;
}
