// SPDX-License-Identifier: GPL-2.0-or-later
import { type Parts, SERVER_SILENCE_BUSY_MS, SERVER_SILENCE_IDLE_MS } from "./context.js";

/** Signs of life in each of the server's watchdogs, and no more of them than this, whatever it says. */
const BEATS_IN_WATCHDOG = 5;
const SHORTEST_BEAT_MS = 10;
/** A program that was itself away for this long has heard nobody meanwhile, and cannot judge. */
const AWAY_MS = 250;

/** When to send a heartbeat, and whether the server is silent. */
export class ServerWatch {
    watchdogBusyMs = 250;
    watchdogIdleMs = 10_000;
    private heardAt: number;
    /** The heartbeats of the server are fast since then. */
    private busyAt: number | undefined;
    private nextBeat = Infinity;
    private beat = 0;

    constructor(private readonly parts: Parts) {
        this.heardAt = parts.context.now();
    }

    connected(busyMs: number, idleMs: number): void {
        if (busyMs > 0) this.watchdogBusyMs = busyMs;
        if (idleMs > 0) this.watchdogIdleMs = idleMs;
        this.busyAt = undefined;
        this.heard();
        this.nextBeat = this.parts.context.now();
    }
    disconnected(): void {
        this.nextBeat = Infinity;
        this.busyAt = undefined;
    }
    heard(): void {
        this.heardAt = this.parts.context.now();
    }
    get silentMs(): number {
        return this.parts.context.now() - this.heardAt;
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
        const idle = this.heardAt + SERVER_SILENCE_IDLE_MS;
        return this.busyAt === undefined ? idle : Math.min(idle, Math.max(this.heardAt, this.busyAt) + SERVER_SILENCE_BUSY_MS);
    }
    get nextHeartbeat(): number {
        return this.parts.context.connected ? this.nextBeat : Infinity;
    }
    /** `lateMs`: how much later than it was to this call comes. */
    awayFor(lateMs: number): void {
        if (lateMs > AWAY_MS) this.heard();
    }
    /** Sends a heartbeat if one is due and, while a task runs, the program permits it. */
    onTimer(keepRunning: () => boolean): void {
        const { context } = this.parts;
        const now = context.now();
        if (context.link === undefined || now < this.nextBeat) return;
        const fast = this.busy;
        this.nextBeat = now + this.period(fast);
        ++this.beat;
        if (!fast || keepRunning()) context.link.keepAlive(this.beat);
    }
    /** At once, as the sending of a task asks for. */
    beatNow(): void {
        this.nextBeat = Math.min(this.nextBeat, this.parts.context.now());
    }
}
