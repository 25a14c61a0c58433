// SPDX-License-Identifier: GPL-2.0-or-later
// Global services, and runs of them. A *global service* is a job for several entities: a list of steps, each of which is a
// service of one entity. A *role* is a place in it that one entity fills. A *run* is one execution of it, and its *master* is
// the participant that orders the steps.
import type { Refusal } from "./refusal.js";
import type { Argument, TaskState, Value } from "./types.js";

/** Takes the input `parameter` of a step from the output `output` of an earlier step, `step`. */
export interface ParameterSource {
    readonly parameter: string;
    readonly step: string;
    readonly output: string;
}

export interface GlobalStep {
    readonly role: number;
    /** Of an entity that may play the role: ROBOT or MACHINE, MOBILE or STATIONARY; empty = any. */
    readonly category: string;
    readonly type: string;
    readonly serviceGlobalId: string;
    /** Order, ascending; steps with equal numbers run at the same time. */
    readonly preced: number;
    /** By which later steps refer to it; empty = none. */
    readonly name: string;
    /** As texts, because only the entity knows their types. */
    readonly parameters: readonly Argument[];
    readonly sources: readonly ParameterSource[];
}

/** What happens to the other steps when a step fails. A stop of one participant always stops all of them. */
export type OnFailure = "stop-all" | "hold-others" | "compensate";

export interface GlobalService {
    readonly name: string;
    readonly descr: string;
    /** Name of its file on the server, without the folder. */
    readonly file: string;
    readonly onFailure: OnFailure;
    readonly steps: readonly GlobalStep[];
    readonly compensation: readonly GlobalStep[];
}

/** One file in the server's folder of global services. A file with an error offers no services. */
export interface GlobalFile {
    readonly name: string;
    readonly findings: readonly string[];
    readonly bad: boolean;
}

export interface GlobalServices {
    readonly services: readonly GlobalService[];
    readonly files: readonly GlobalFile[];
}

/** Which entity plays which role: role number → name, in the forms that Client.find accepts. */
export type Bindings = ReadonlyMap<number, string>;

/** An entity that cannot play a role now, and why. */
export interface Unfit {
    readonly entity: string;
    readonly name: string;
    /** The message is a predicate: "is held by ana@lab, and was stopped". */
    readonly why: Refusal;
    /**
     * How much is missing: 1 = it is latched: rearm it. 2 = this client holds it, but it is busy. 3 = another client holds it.
     * 4 = it is not available, or does not answer. 5 = a parameter or resource is missing. 6 = a service is not active.
     * 7 = it does not offer a service. 8 = it is another kind of entity.
     */
    readonly distance: number;
}

/** The candidates for one role. */
export interface RoleOutlook {
    readonly role: number;
    /** "ROBOT/MOBILE with drive, look". */
    readonly wanted: string;
    readonly kind: string;
    /** Names of the entities that could play it now. */
    readonly able: readonly string[];
    /** The others, smallest distance first. */
    readonly unfit: readonly Unfit[];
    /** The entity that is proposed; empty = none. */
    readonly entity: string;
    readonly name: string;
}

/** Which entity could play which role. Every role gets a different entity, and as many roles as possible get one. */
export interface Proposal {
    readonly roles: readonly RoleOutlook[];
    /** Services that no entity of any kind offers. */
    readonly nobodyOffers: readonly string[];
    /** Why roles have no entity, one line for each role; undefined = all have one. */
    readonly why: Refusal | undefined;
}

/** SUCCEEDED and those after it are final. */
export type RunState = "CHECKING" | "RUNNING" | "PAUSED" | "HELD" | "STOPPING" | "COMPENSATING" | "SUCCEEDED" | "FAILED" | "STOPPED" | "CANCELLED" | "REFUSED" | "UNKNOWN";

/** The progress of one step. */
export interface StepReport {
    /** Position in the service, from 0; the compensation follows the steps. */
    readonly step: number;
    readonly compensation: boolean;
    readonly called: string;
    readonly entity: string;
    readonly name: string;
    readonly service: string;
    readonly preced: number;
    /** Undefined = the step has not begun. */
    readonly state: TaskState | undefined;
    readonly progress: number | undefined;
    readonly feedback: string;
    readonly parameters: ReadonlyMap<string, readonly Value[]>;
    readonly results: ReadonlyMap<string, readonly Value[]>;
    readonly reason: Refusal | undefined;
    /** Since the launch. */
    readonly beganMs: number | undefined;
    readonly endedMs: number | undefined;
    /** Above 1 if it was tried again after a hold. */
    readonly tries: number;
}

/** Why a run is not possible. */
export interface RunProblem {
    /** As in StepReport; -1 = the problem concerns no single step. */
    readonly step: number;
    readonly entity: string;
    readonly refusal: Refusal;
}

export interface RunReport {
    /** UUID text of the run. */
    readonly id: string;
    readonly service: string;
    /** UUID. */
    readonly master: string;
    /** From checkGlobal(): nothing moves. */
    readonly check: boolean;
    readonly state: RunState;
    readonly progress: number;
    /** Since the launch, on the master's clock. */
    readonly elapsedMs: number;
    readonly steps: readonly StepReport[];
    readonly problems: readonly RunProblem[];
    readonly reason: Refusal | undefined;
}

export interface RunRecord {
    readonly id: string;
    readonly service: GlobalService;
    readonly by: string;
    readonly master: string;
    readonly participants: readonly { readonly role: number; readonly entity: string; readonly name: string }[];
    readonly askedAt: Date;
    readonly durationMs: number;
    readonly state: RunState;
    readonly reason: Refusal | undefined;
    readonly steps: readonly StepReport[];
}

export interface RunHistory {
    /** Newest first. */
    readonly runs: readonly RunRecord[];
    /** Entities that were asked and have not answered. */
    readonly silent: readonly { readonly name: string; readonly why: Refusal }[];
}
