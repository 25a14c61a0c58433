// SPDX-License-Identifier: GPL-2.0-or-later
// The session of this page: log-in, connection, and who the person is.
import { type Client, connect, type ConnectionReport, type Credentials, type Refusal, ticketFrom } from "@axon/client";
import { computed, signal } from "@preact/signals";
import { follow } from "./entities";
import { keepRunning } from "./guard";
import { abandon, resumeHolds } from "./holds";
import { asRefusal, note, say } from "./journal";

const RETRY_MS = 1500;
/** A person sees within a second that the server is silent; drawing takes its time, too. */
const SILENCE_MS = 700;

/** connecting: not yet, or no longer; login: somebody has to log in first. A session that comes back by itself stays open. */
export type Phase = "connecting" | "login" | "open";
export const phase = signal<Phase>("connecting");
/** Why there is no session. */
export const problem = signal("");
export const client = signal<Client | undefined>(undefined);
export const connection = signal<ConnectionReport | undefined>(undefined);
/** The server answers: what is shown is how it is now, and what only the server can do can be asked for. */
export const reachable = computed(() => connection.value?.kind === "connected" && !connection.value.silent);
/** There is a connection, and nothing comes over it. */
export const silent = computed(() => connection.value?.silent === true);
/** When the server was last heard, on the clock of Date.now(), unless it is reachable. */
export const heardAt = signal<number | undefined>(undefined);
/** The user who has logged in; empty where the server asks nobody. */
export const user = signal("");
/** By that others know this page, if the server has no users. */
export const ownName = signal(localStorage.getItem("axon-name") ?? "");

const at = (path: string): URL => new URL(path, location.href.replace(/#.*/, ""));
const ticket = ticketFrom(at("ticket"));
let unfollow: (() => void) | undefined;
/** The user of the session. */
let openedBy = "";
let generation = 0;

async function credentials(): Promise<Credentials> {
    try {
        const its = await ticket();
        user.value = its.user;
        if (phase.value === "login" && client.value !== undefined) phase.value = "open";
        return its;
    } catch (error) {
        // The server has forgotten who this is, as after a restart.
        if (asRefusal(error).code === "PERMISSION_DENIED" && client.value !== undefined) askForLogin();
        throw error;
    }
}
function askForLogin(): void {
    if (phase.value === "login") return;
    phase.value = "login";
    problem.value = client.value === undefined ? "" : "The server no longer knows who you are: it was restarted, or your log-in has run out. Log in again.";
}

function opened(its: Client): void {
    client.value = its;
    phase.value = "open";
    problem.value = "";
    let before: ConnectionReport | undefined;
    unfollow = follow(its);
    const opener = (openedBy = user.value);
    its.onConnection((report) => {
        connection.value = report;
        if (reachable.value) heardAt.value = undefined;
        else heardAt.value ??= report.heardAt;
        if (report.kind === "closed" && report.ended !== undefined && client.value === its) void replaced(opener);
        if (before?.kind !== report.kind && report.kind !== "reconnecting" && !(before?.kind === "reconnecting" && report.kind === "lost")) {
            if (report.kind === "lost") note("connection", undefined, `the connection to the server was lost: ${report.reason}`);
            if (report.kind === "connected") {
                note("connection", undefined, before === undefined ? "connected to the server" : "the connection to the server is back");
                if (before !== undefined) say("good", "The connection to the server is back.");
            }
        }
        if (before?.silent !== true && report.silent) note("connection", undefined, "the server is silent");
        if (before?.silent === true && report.kind === "connected" && !report.silent) note("connection", undefined, "the server is heard again");
        before = report;
    });
    its.onServerText(({ code, text }) => {
        note(code === "OK" ? "message" : "refusal", { id: "", name: "server" }, text);
        say(code === "OK" ? "wait" : "bad", text);
    });
    void resumeHolds(its, opener);
}
/** In another tab of this browser somebody else has logged in: a person has to say who goes on here. */
async function replaced(opener: string): Promise<void> {
    const now = user.value;
    const ending = end();
    const own = generation;
    await ending;
    if (own !== generation) return; // it was here that somebody logged in, and a new session is being opened
    user.value = "";
    askForLogin();
    const name = (one: string): string => (one === "" ? "nobody" : one);
    problem.value = `${name(now)} has logged in with this browser meanwhile, and this page was ${name(opener)}'s. What it held was stopped, and is not kept. Log in to go on.`;
    note("connection", undefined, `the session of ${name(opener)} has ended: ${name(now)} has logged in meanwhile`);
}

/** Opens the session, and tries again until there is one or somebody has to log in. */
export async function start(): Promise<void> {
    const own = ++generation;
    phase.value = "connecting";
    while (own === generation) {
        try {
            if (ownName.value === "") rename(`guest ${String(Math.floor(1000 + Math.random() * 9000))}`, false);
            const its = await connect({ credentials, displayName: `${ownName.value.replaceAll("@", " ")}@web`, keepRunning, noticeSilenceMs: SILENCE_MS });
            if (own === generation) return opened(its);
            return await its.close();
        } catch (error) {
            if (own !== generation) return; // somebody has logged out meanwhile, or begun again
            const refusal: Refusal = asRefusal(error);
            problem.value = refusal.message;
            if (refusal.code === "PERMISSION_DENIED") return askForLogin();
            await new Promise((wake) => setTimeout(wake, RETRY_MS));
        }
    }
}

/** Empty = it worked; otherwise what to tell the person. */
export async function login(name: string, password: string): Promise<string> {
    try {
        const answer = await fetch(at("login"), { method: "POST", credentials: "same-origin", body: new URLSearchParams({ user: name, password }), signal: AbortSignal.timeout(10_000) });
        if (!answer.ok) {
            const body = (await answer.json().catch(() => ({}))) as Record<string, unknown>;
            return typeof body["message"] === "string" ? body["message"] : `The server answers ${answer.status}.`;
        }
        const body = (await answer.json().catch(() => ({}))) as Record<string, unknown>;
        // Another user gets a session of their own.
        if (client.value !== undefined && body["user"] !== openedBy) await end();
    } catch {
        return "The server does not answer. Is it running?";
    }
    if (client.value === undefined) void start();
    else phase.value = "open"; // the library logs in again by itself
    return "";
}

async function end(): Promise<void> {
    ++generation;
    const its = client.value;
    unfollow?.();
    abandon();
    client.value = undefined;
    connection.value = undefined;
    heardAt.value = undefined;
    await its?.close();
}
export async function logout(): Promise<void> {
    await end();
    await fetch(at("logout"), { method: "POST", credentials: "same-origin" }).catch(() => undefined);
    user.value = "";
    askForLogin();
    problem.value = "You are logged out. What you held is free again.";
}
/** What others see; it begins with the next session. */
export function rename(name: string, again = true): void {
    ownName.value = name.trim().slice(0, 40) || "guest";
    localStorage.setItem("axon-name", ownName.value);
    if (again) void end().then(start);
}
