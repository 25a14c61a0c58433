// SPDX-License-Identifier: GPL-2.0-or-later
// The clock of a page against a Worker that the test plays, and the Worker's own script.
import assert from "node:assert/strict";
import { test } from "node:test";
import { workerClock } from "../../dist/index.js";

interface Order {
    readonly start?: number;
    readonly stop?: number;
    readonly ms?: number;
}
class FakeWorker extends EventTarget {
    readonly orders: Order[] = [];
    postMessage(order: Order): void {
        this.orders.push(order);
    }
    ring(id: number): void {
        this.dispatchEvent(new MessageEvent("message", { data: id }));
    }
    fail(): void {
        this.dispatchEvent(new Event("error"));
    }
    get started(): number[] {
        return this.orders.flatMap(({ start }) => (start === undefined ? [] : [start]));
    }
}
function world(): { worker: FakeWorker; rung: string[]; alarm: (name: string) => { set(at: number): void; end(): void }; now: () => number } {
    const worker = new FakeWorker();
    const clock = workerClock(worker as unknown as Worker);
    const rung: string[] = [];
    return { worker, rung, alarm: (name) => clock.alarm(() => rung.push(name)), now: () => clock.now() };
}

/** Timers of the page that go on when the test says so. */
function pageTimers(): { tick: (ms: number) => void; reset: () => void } {
    const { setTimeout: set, clearTimeout: clear } = globalThis;
    const timers = new Map<number, { readonly at: number; readonly ring: () => void }>();
    let last = 0;
    let time = 0;
    Object.assign(globalThis, {
        setTimeout: (ring: () => void, ms: number) => (timers.set(++last, { at: time + ms, ring }), last),
        clearTimeout: (id: number | undefined) => void (id !== undefined && timers.delete(id)),
    });
    return {
        tick: (ms) => {
            time += ms;
            for (const [id, { at, ring }] of [...timers].sort(([, a], [, b]) => a.at - b.at)) if (at <= time && timers.delete(id)) ring();
        },
        reset: () => void Object.assign(globalThis, { setTimeout: set, clearTimeout: clear }),
    };
}

test("A Worker's timer rings once, however often the Worker says so", () => {
    const { worker, rung, alarm, now } = world();
    alarm("a").set(now() + 1000);
    const [id] = worker.started;
    assert.ok(id !== undefined);
    worker.ring(id);
    worker.ring(id);
    worker.ring(id + 1);
    assert.deepEqual(rung, ["a"]);
});

test("After a Worker has failed each timer rings once, whoever comes first", () => {
    const timers = pageTimers();
    try {
        const { worker, rung, alarm, now } = world();
        const at = now() + 1000;
        alarm("late worker").set(at);
        alarm("early worker").set(at);
        const ended = alarm("ended");
        ended.set(at);
        const [first = 0, second = 0, third = 0] = worker.started;
        worker.fail();
        worker.fail();
        worker.ring(second); // it had been on its way
        ended.end();
        timers.tick(2000);
        worker.ring(first);
        worker.ring(third);
        assert.deepEqual(rung, ["early worker", "late worker"]);
        const after = alarm("after");
        after.set(now() + 5);
        after.end();
        alarm("by the page's own timers").set(now() + 5);
        timers.tick(10);
        assert.deepEqual(rung, ["early worker", "late worker", "by the page's own timers"]);
    } finally {
        timers.reset();
    }
});

test("A timer that was set earlier, or has ended, does not ring for its old time", () => {
    const { worker, rung, alarm, now } = world();
    const one = alarm("a");
    one.set(now() + 5000);
    one.set(now() + 1000);
    const [old = 0, fresh = 0] = worker.started;
    assert.ok(worker.orders.some(({ stop }) => stop === old));
    worker.ring(old); // it had been on its way
    assert.deepEqual(rung, []);
    worker.ring(fresh);
    worker.ring(old);
    assert.deepEqual(rung, ["a"]);
    one.set(now() + 1000);
    one.end();
    worker.ring(worker.started.at(-1) ?? 0);
    assert.deepEqual(rung, ["a"]);
});

test("The Worker's script has one timer for each id, and none that was stopped", async () => {
    const scope = globalThis as unknown as { addEventListener?: unknown; postMessage?: unknown };
    const rung: number[] = [];
    let listen: ((event: { data: Order }) => void) | undefined;
    const { addEventListener: before, postMessage: beforeToo } = scope;
    scope.addEventListener = (_: string, on: typeof listen) => void (listen = on);
    scope.postMessage = (id: number) => rung.push(id);
    const timers = pageTimers();
    try {
        await import("../../dist/timer_worker.js" as string);
        listen?.({ data: { start: 1, ms: 10 } });
        listen?.({ data: { start: 1, ms: 20 } });
        listen?.({ data: { start: 2, ms: 10 } });
        listen?.({ data: { stop: 2 } });
        listen?.({ data: { start: 3, ms: 10 } });
        timers.tick(100);
        listen?.({ data: { stop: 3 } });
        timers.tick(100);
        assert.deepEqual(rung, [3, 1]);
    } finally {
        timers.reset();
        scope.addEventListener = before;
        scope.postMessage = beforeToo;
    }
});
