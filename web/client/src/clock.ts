// SPDX-License-Identifier: GPL-2.0-or-later

/** Time, and what wakes a session. Everything in this library that waits does it with one of these. */
export interface Clock {
    /** Milliseconds since some moment; never goes back. */
    now(): number;
    /** Milliseconds since 1970. Unlike now() it goes on while the computer sleeps, and somebody may set it. */
    date(): number;
    /** An alarm that calls `ring` at about the time that it was last set to. */
    alarm(ring: () => void): Alarm;
}

export interface Alarm {
    /** Infinity = not at all. An alarm may ring too early; it is set again then. */
    set(at: number): void;
    /** It never rings again. */
    end(): void;
}

/** No timer of JavaScript waits for longer than this. */
const LONGEST_MS = 2 ** 30;

/** Rings at most once, and not after it was stopped with what this returns. */
type Start = (ring: () => void, ms: number) => () => void;

/** One timer at a time. Setting it to a later time leaves the timer as it is: it rings too early, and is then set again. */
class TimerAlarm implements Alarm {
    private armed = Infinity;
    private stop: (() => void) | undefined;
    private ended = false;

    constructor(
        private readonly now: () => number,
        private readonly start: Start,
        private readonly ring: () => void,
    ) {}

    set(at: number): void {
        if (this.ended || at >= this.armed) return;
        this.stop?.();
        this.armed = at;
        const wait = Math.min(Math.max(at - this.now(), 0), LONGEST_MS);
        this.stop = this.start(() => {
            this.armed = Infinity;
            this.stop = undefined;
            this.ring();
        }, Math.ceil(wait));
    }
    end(): void {
        this.ended = true;
        this.stop?.();
    }
}

const now = (): number => performance.now();
const date = (): number => Date.now();

/** With the timers of the page or of Node. A browser slows these down while its tab is in the background. */
export function plainClock(): Clock {
    const start: Start = (ring, ms) => {
        const timer = setTimeout(ring, ms);
        return () => clearTimeout(timer);
    };
    return { now, date, alarm: (ring) => new TimerAlarm(now, start, ring) };
}

/**
 * With the timers of a Worker, which go on while the tab is in the background. The script of the Worker is `timer_worker.js`
 * beside this file. A browser that freezes a whole tab stops its Workers as well: the server then takes the client for lost.
 */
export function workerClock(worker: Worker = new Worker(new URL("./timer_worker.js", import.meta.url), { type: "module", name: "axon-timer" })): Clock {
    let lost = false; // the worker cannot be loaded, or has failed
    let last = 0;
    const waiting = new Map<number, { readonly ring: () => void; readonly at: number; timer?: ReturnType<typeof setTimeout> }>();
    // Whoever comes first, the worker or a timer in its place, takes it out.
    const ringOnce = (id: number): void => {
        const one = waiting.get(id);
        if (one === undefined) return;
        waiting.delete(id);
        clearTimeout(one.timer);
        one.ring();
    };
    const inItsPlace = (id: number): void => {
        const one = waiting.get(id);
        if (one !== undefined) one.timer = setTimeout(() => ringOnce(id), Math.max(one.at - now(), 0));
    };
    worker.addEventListener("message", (event: MessageEvent<unknown>) => {
        if (typeof event.data === "number") ringOnce(event.data);
    });
    worker.addEventListener("error", () => {
        if (lost) return;
        lost = true;
        for (const id of waiting.keys()) inItsPlace(id);
    });
    const start: Start = (ring, ms) => {
        const id = ++last;
        waiting.set(id, { ring, at: now() + ms });
        if (lost) inItsPlace(id);
        else worker.postMessage({ start: id, ms });
        return () => {
            const one = waiting.get(id);
            if (one === undefined) return;
            waiting.delete(id);
            clearTimeout(one.timer);
            if (!lost) worker.postMessage({ stop: id });
        };
    };
    return { now, date, alarm: (ring) => new TimerAlarm(now, start, ring) };
}

let ofThisProcess: Clock | undefined;

/** The clock that a client uses unless it is told another: a Worker's in a page, the plain one in Node and in Workers. */
export function usualClock(): Clock {
    if (ofThisProcess === undefined) {
        const page = typeof window !== "undefined" && typeof document !== "undefined" && typeof Worker !== "undefined";
        try {
            ofThisProcess = page ? workerClock() : plainClock();
        } catch {
            ofThisProcess = plainClock(); // a page whose policy permits no Worker
        }
    }
    return ofThisProcess;
}
