// SPDX-License-Identifier: GPL-2.0-or-later
// What the tokens of the system mean, for people who do not know it.
import type { Entity, EntityState, Refusal, RunState, Service, TaskState } from "@axon/client";

/** A colour has a meaning, and a mark for those who see no colours. */
export type Tone = "good" | "busy" | "wait" | "bad" | "off";
export const marks: Readonly<Record<Tone, string>> = { good: "●", busy: "▶", wait: "◐", bad: "▲", off: "○" };

interface Plain {
    readonly tone: Tone;
    readonly short: string;
    readonly long: string;
}
const states: Readonly<Record<EntityState, Plain>> = {
    UNAV: { tone: "off", short: "not available", long: "Its robot application is not running, or cannot be reached." },
    INIT: { tone: "wait", short: "starting", long: "It is being set up." },
    ENVCONN: { tone: "wait", short: "connecting", long: "It is ready, and looks for the server." },
    IDLE: { tone: "good", short: "free", long: "Nobody is using it. You can check it out." },
    REG: { tone: "good", short: "in use, at rest", long: "Somebody has it and it waits for a task." },
    COLLAB: { tone: "busy", short: "leads a team", long: "It leads other robots in a common job." },
    SLAVE: { tone: "busy", short: "works in a team", long: "It takes part in a common job and obeys its leader." },
    BUSY: { tone: "busy", short: "working", long: "It carries out a task and may move at any time." },
    ERR: { tone: "bad", short: "fault", long: "Something is wrong with its profiles." },
};
export function plainState(entity: Entity): Plain {
    if (entity.latched && (entity.state === "IDLE" || entity.state === "REG")) return { tone: "bad", short: "stopped", long: "It was stopped, and does nothing until somebody rearms it." };
    return states[entity.state];
}
export const canMove = (entity: Entity): boolean => entity.state === "BUSY" || entity.state === "COLLAB" || entity.state === "SLAVE";

/** ROBOT/MOBILE: "mobile robot". */
export function plainKind({ category, type }: Pick<Entity, "category" | "type">): string {
    return [type === "MOBILE" ? "mobile" : type === "STATIONARY" ? "stationary" : type.toLowerCase(), category.toLowerCase()].filter((word) => word !== "").join(" ") || "kind not known";
}

interface Ended extends Plain {
    readonly final: boolean;
}
const tasks: Readonly<Record<TaskState, Ended>> = {
    QUEUED: { final: false, tone: "wait", short: "waiting its turn", long: "Tasks before it have to end first." },
    DISPATCHED: { final: false, tone: "wait", short: "handed over", long: "The robot application has it, and has not begun." },
    RUNNING: { final: false, tone: "busy", short: "running", long: "" },
    PAUSED: { final: false, tone: "wait", short: "paused", long: "" },
    SUCCEEDED: { final: true, tone: "good", short: "done", long: "" },
    FAILED: { final: true, tone: "bad", short: "failed", long: "" },
    STOPPED: { final: true, tone: "bad", short: "stopped", long: "" },
    CANCELLED: { final: true, tone: "off", short: "cancelled", long: "" },
    REFUSED: { final: true, tone: "bad", short: "refused", long: "It was not begun." },
    UNKNOWN: { final: true, tone: "bad", short: "outcome unknown", long: "The connection was lost meanwhile. It may have been done, in part or not at all: look at the robot." },
};
export const plainTask = (state: TaskState): Ended => tasks[state];

const runs: Readonly<Record<RunState, Ended>> = {
    CHECKING: { final: false, tone: "wait", short: "being checked", long: "" },
    RUNNING: { final: false, tone: "busy", short: "running", long: "" },
    PAUSED: { final: false, tone: "wait", short: "paused", long: "" },
    HELD: { final: false, tone: "bad", short: "held after a failure", long: "A step failed; the others stand still. Resume tries the step again." },
    STOPPING: { final: false, tone: "bad", short: "stopping", long: "" },
    COMPENSATING: { final: false, tone: "busy", short: "cleaning up", long: "A step failed; the robots now do what the job says for that case." },
    SUCCEEDED: { final: true, tone: "good", short: "done", long: "" },
    FAILED: { final: true, tone: "bad", short: "failed", long: "" },
    STOPPED: { final: true, tone: "bad", short: "stopped", long: "" },
    CANCELLED: { final: true, tone: "off", short: "cancelled", long: "" },
    REFUSED: { final: true, tone: "bad", short: "refused", long: "Nothing has moved." },
    UNKNOWN: { final: true, tone: "bad", short: "outcome unknown", long: "The connection was lost meanwhile: look at the robots." },
};
export const plainRun = (state: RunState): Ended => runs[state];

export function plainLoss(service: Service): string {
    switch (service.onClientLoss) {
        case "stop":
            return "If this tab closes or loses the server, the robot stops.";
        case "hold":
            return "If this tab closes or loses the server, the task is paused.";
        default:
            return "If this tab closes or loses the server, the task goes on to its end.";
    }
}

/** What a person can do in this console about a refusal; the library's remedies are for the command line. */
export function remedyOf(refusal: Refusal): string {
    switch (refusal.code) {
        case "NOT_HOLDER":
        case "OLDER_LEASE":
        case "REVOKED_LEASE":
        case "WRONG_EPOCH":
            return "Check it out first.";
        case "EXPIRED":
            return "Try again; if your check-out has run out, check it out again.";
        case "ALREADY_HELD":
        case "RESERVED":
            return `Ask ${refusal.holder === "" ? "the holder" : refusal.holder} for it, or wait in line.`;
        case "HAND_OVER_REFUSED":
            return "Wait in line until it is free.";
        case "LATCHED":
        case "STOPPED":
            return "Look at the robot. Rearm it when it is safe to move again.";
        case "CLIENT_LOST":
            return "Check it out again if you have lost it, then rearm it.";
        case "OLD_GENERATION":
        case "TIMED_OUT":
            return "Look at the robot, then try again.";
        case "MISSING_DEPENDENCY":
            return "Fill in what is marked as required, and upload the files that are missing.";
        case "BLOCKED":
        case "QUEUE_FULL":
            return "Wait until a task has ended, or cancel one.";
        case "NOT_PAUSABLE":
            return "It cannot be paused. Cancel it instead.";
        case "INACTIVE_SERVICE":
            return "The robot has switched this service off. Its page says why, if the robot does.";
        case "OUTCOME_UNKNOWN":
            return "Look at the robot before you try again.";
        case "ROBOT_LOST":
            return "Look at the robot, its power and its cable.";
        case "UNKNOWN_ENTITY":
            return "It is not connected now. The page Laboratory shows those that are.";
        case "NOT_CONNECTED":
            return "Wait until the connection is back.";
        case "OVERLOADED":
            return "Try again after a moment.";
        case "HASH_MISMATCH":
            return "Upload the file again.";
        case "PERMISSION_DENIED":
            return "Log in as a user who may do that, or ask an administrator.";
        case "UNAVAILABLE":
            return "Look at the robot and its machine; its page says what is wrong.";
        case "INTERNAL":
            return "Report it, with the log of the server.";
        default:
            return "";
    }
}
/** "why", as a sentence. */
export function sentence(text: string): string {
    const trimmed = text.trim();
    if (trimmed === "") return "";
    const begun = trimmed.charAt(0).toUpperCase() + trimmed.slice(1);
    return /[.!?…]$/.test(begun) ? begun : `${begun}.`;
}
/**
 * What becomes of the robots that this page holds when the server is not heard. Without the server they stop whatever their
 * tasks may do; only the loss of this page alone is one that a task may survive.
 */
export function heldMeanwhile(names: readonly string[], connected: boolean): string {
    if (names.length === 0) return "";
    return `What you hold (${names.join(", ")}) is stopped${connected ? " if this lasts" : ""}. Only if the server still runs does a task go on that may do so without you. `;
}
