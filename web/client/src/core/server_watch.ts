// SPDX-License-Identifier: GPL-2.0-or-later
import type { Connection } from "../transport.js";
import { type Parts, SERVER_SILENCE_BUSY_MS, SERVER_SILENCE_IDLE_MS } from "./context.js";

/** Signs of life in each of the server's watchdogs, and no more of them than this, whatever it says. */
const BEATS_IN_WATCHDOG = 5;
const SHORTEST_BEAT_MS = 10;
/** A program that was itself away for this long has heard nobody meanwhile, and cannot judge. */
const AWAY_MS = 250;

/** Times that the server is asked in the time after which its silence is told. */
const ASKS_IN_NOTICE = 4;

/** When to send a heartbeat or to ask for one, and whether the server is silent. */
export class ServerWatch {
    watchdogBusyMs = 250;
    watchdogIdleMs = 10_000;
    /** Nothing has come for Settings.noticeMs. It stays so until something comes. */
    silent = false;
    private heardAt: number;
    /** The same on Clock.date(). */
    heardDate: number;
    /** This program was away until then, so that silence counts from there. */
    private backAt = -Infinity;
    /** The heartbeats of the server are fast since then. */
    private busyAt: number | undefined;
    private nextBeat = Infinity;
    private nextAsk = Infinity;
    private beat = 0;

    constructor(private readonly parts: Parts) {
        this.heardAt = parts.context.now();
        this.heardDate = parts.context.clock.date();
    }

    connected(busyMs: number, idleMs: number): void {
        if (busyMs > 0) this.watchdogBusyMs = busyMs;
        if (idleMs > 0) this.watchdogIdleMs = idleMs;
        this.busyAt = undefined;
        this.heard();
        this.nextBeat = this.parts.context.now();
        this.nextAsk = this.nextBeat + this.noticeMs / ASKS_IN_NOTICE;
    }
    disconnected(): void {
        this.nextBeat = Infinity;
        this.nextAsk = Infinity;
        this.busyAt = undefined;
        this.silent = false;
    }
    heard(): void {
        this.heardAt = this.parts.context.now();
        this.heardDate = this.parts.context.clock.date();
        this.silent = false;
    }
    get silentMs(): number {
        return this.parts.context.now() - this.heardAt;
    }
    private get noticeMs(): number {
        return this.parts.context.settings.noticeMs;
    }
    private get silentSince(): number {
        return Math.max(this.heardAt, this.backAt);
    }
    /** What this client holds moves, or is about to. */
    get busy(): boolean {
        return this.parts.tasks.anyOpen || this.parts.runs.anyOpen || this.parts.entities.anyMoving;
    }
    /** After every change of tasks, runs, leases and states. */
    pace(): void {
        if (!this.parts.context.connected) return;
        const now = this.parts.context.now();
        // The server beats fast only while it sees an entity of ours BUSY; our own tasks begin a little earlier.
        if (!this.parts.entities.anyBusyForServer) this.busyAt = undefined;
        else this.busyAt ??= now;
        if (this.busy) this.nextBeat = Math.min(this.nextBeat, now + this.period(true));
    }
    private period(fast: boolean): number {
        return Math.max((fast ? this.watchdogBusyMs : this.watchdogIdleMs) / BEATS_IN_WATCHDOG, SHORTEST_BEAT_MS);
    }
    /** At which the server has been silent for too long. */
    get deadline(): number {
        if (!this.parts.context.connected) return Infinity;
        const idle = this.silentSince + SERVER_SILENCE_IDLE_MS;
        return this.busyAt === undefined ? idle : Math.min(idle, Math.max(this.silentSince, this.busyAt) + SERVER_SILENCE_BUSY_MS);
    }
    /** When onTimer() has something to do, or the server is to be given up. */
    nextDeadline(): number {
        if (!this.parts.context.connected) return Infinity;
        return Math.min(this.deadline, this.nextBeat, this.nextAsk, this.silent ? Infinity : this.silentSince + this.noticeMs);
    }
    /** `lateMs`: how much later than it was to this call comes. */
    awayFor(lateMs: number): void {
        // Once until something comes: if every call is late, as with timers that a browser slows down, silence still counts.
        if (lateMs > AWAY_MS && this.heardAt >= this.backAt) this.backAt = this.parts.context.now();
    }
    /** Sends a heartbeat if one is due and, while a task runs, the program permits it. Asks the server for one. */
    onTimer(keepRunning: () => boolean): void {
        const { link } = this.parts.context;
        const now = this.parts.context.now();
        if (link === undefined) return;
        if (now >= this.nextAsk) {
            this.nextAsk = now + this.noticeMs / ASKS_IN_NOTICE;
            link.ask();
        }
        if (now >= this.silentSince + this.noticeMs) this.silent = true;
        if (now >= this.nextBeat) this.sendBeat(link, keepRunning);
    }
    private sendBeat(link: Connection, keepRunning: () => boolean): void {
        const now = this.parts.context.now();
        const fast = this.busy;
        this.nextBeat = now + this.period(fast);
        ++this.beat;
        if (!fast || keepRunning()) link.keepAlive(this.beat);
    }
    /** At once, as the sending of a task asks for. */
    beatNow(): void {
        this.nextBeat = Math.min(this.nextBeat, this.parts.context.now());
    }
}
