// SPDX-License-Identifier: GPL-2.0-or-later

/** Time, and what wakes a session. Everything in this library that waits does it with one of these. */
export interface Clock {
    /** Milliseconds since some moment; never goes back. */
    now(): number;
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
            if (!this.ended) this.ring();
        }, Math.ceil(wait));
    }
    end(): void {
        this.ended = true;
        this.stop?.();
    }
}

const now = (): number => performance.now();

/** With the timers of the page or of Node. A browser slows these down while its tab is in the background. */
export function plainClock(): Clock {
    const start: Start = (ring, ms) => {
        const timer = setTimeout(ring, ms);
        return () => clearTimeout(timer);
    };
    return { now, alarm: (ring) => new TimerAlarm(now, start, ring) };
}

/**
 * With the timers of a Worker, which go on while the tab is in the background. The script of the Worker is `timer_worker.js`
 * beside this file. A browser that freezes a whole tab stops its Workers as well: the server then takes the client for lost.
 */
export function workerClock(worker: Worker = new Worker(new URL("./timer_worker.js", import.meta.url), { type: "module", name: "axon-timer" })): Clock {
    let plain: Clock | undefined; // if the worker cannot be loaded
    let last = 0;
    const waiting = new Map<number, { ring: () => void; at: number; cancel?: () => void }>();
    worker.addEventListener("message", (event: MessageEvent<unknown>) => {
        const one = typeof event.data === "number" ? waiting.get(event.data) : undefined;
        if (one === undefined) return;
        waiting.delete(event.data as number);
        one.ring();
    });
    worker.addEventListener("error", () => {
        if (plain !== undefined) return;
        plain = plainClock();
        for (const one of waiting.values()) {
            const timer = setTimeout(one.ring, Math.max(one.at - now(), 0));
            one.cancel = () => clearTimeout(timer);
        }
    });
    const start: Start = (ring, ms) => {
        if (plain !== undefined) {
            const timer = setTimeout(ring, ms);
            return () => clearTimeout(timer);
        }
        const id = ++last;
        const one: { ring: () => void; at: number; cancel?: () => void } = { ring, at: now() + ms };
        waiting.set(id, one);
        worker.postMessage({ start: id, ms });
        return () => {
            waiting.delete(id);
            one.cancel?.();
            worker.postMessage({ stop: id });
        };
    };
    return { now, alarm: (ring) => new TimerAlarm(now, start, ring) };
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
