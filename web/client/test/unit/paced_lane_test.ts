// SPDX-License-Identifier: GPL-2.0-or-later
// What goes to a connection at a time, with a connection that takes it when the test says so.
import assert from "node:assert/strict";
import { test } from "node:test";
import { PacedLane } from "../../dist/paced_lane.js";
import { settle } from "./support.js";

const KIB = 1024;

/** Messages that were given to the connection and not taken by it. */
class Wire {
    readonly given: { readonly name: string; readonly bytes: number; readonly taken: () => void; readonly lost: (why: Error) => void }[] = [];
    readonly order: string[] = [];
    readonly failed: unknown[] = [];
    readonly lane: PacedLane;

    constructor(most: number) {
        this.lane = new PacedLane(most, (error) => this.failed.push(error));
    }
    post(name: string, bytes: number): void {
        this.lane.post(bytes, () => {
            this.order.push(name);
            return new Promise<void>((resolve, reject) => this.given.push({ name, bytes, taken: resolve, lost: reject }));
        });
    }
    get onTheWay(): number {
        return this.given.reduce((sum, { bytes }) => sum + bytes, 0);
    }
    async take(count = 1): Promise<void> {
        for (const one of this.given.splice(0, count)) one.taken();
        await settle();
    }
}

test("However much is sent, a signal on the same connection has at most 128 KiB before it", async () => {
    const wire = new Wire(128 * KIB);
    for (let i = 0; i < 250; ++i) wire.post(`chunk ${i}`, 60 * KIB);
    let most = 0;
    while (wire.given.length > 0) {
        most = Math.max(most, wire.onTheWay);
        await wire.take();
    }
    assert.equal(most, 120 * KIB);
    assert.deepEqual(wire.order, Array.from({ length: 250 }, (_, i) => `chunk ${i}`));
    assert.deepEqual(wire.lane.backlog(), { messages: 0, bytes: 0 });
});

test("A message that is larger than that goes alone, and nothing overtakes it", async () => {
    const wire = new Wire(128 * KIB);
    wire.post("small", KIB);
    wire.post("large", 4096 * KIB);
    wire.post("after", KIB);
    assert.deepEqual([wire.order, wire.lane.backlog()], [["small"], { messages: 2, bytes: 4097 * KIB }]);
    await wire.take();
    assert.deepEqual(wire.order, ["small", "large"]);
    await wire.take();
    assert.deepEqual(wire.order, ["small", "large", "after"]);
});

test("Uploads take turns, chunk by chunk, and what else is sent goes between them", async () => {
    const wire = new Wire(128 * KIB);
    const begin = (name: string, chunks: number): void => {
        const next = (i: number): void => {
            if (i === chunks) return;
            wire.lane.onRoom(() => {
                wire.post(`${name}${i}`, 64 * KIB);
                queueMicrotask(() => next(i + 1));
            });
        };
        next(0);
    };
    begin("a", 4);
    begin("b", 4);
    await settle();
    assert.deepEqual(wire.order, ["a0", "b0"]); // 128 KiB
    wire.post("task", KIB);
    for (let i = 0; i < 9; ++i) await wire.take();
    assert.deepEqual(wire.order, ["a0", "b0", "task", "a1", "b1", "a2", "b2", "a3", "b3"]);
});

test("Who withdraws is not called, and nobody is after the end", async () => {
    const wire = new Wire(128 * KIB);
    wire.post("all", 128 * KIB);
    const called: string[] = [];
    const withdraw = wire.lane.onRoom(() => called.push("first"));
    wire.lane.onRoom(() => called.push("second"));
    withdraw();
    await wire.take();
    assert.deepEqual(called, ["second"]);
    wire.post("more", 128 * KIB);
    wire.post("waits", KIB);
    wire.lane.onRoom(() => called.push("third"));
    wire.lane.end();
    await wire.take();
    assert.deepEqual([called, wire.order], [["second"], ["all", "more"]]);
});

test("A message that cannot be sent is told once, and never within the call that sent it", async () => {
    const wire = new Wire(128 * KIB);
    wire.lane.post(1, () => {
        throw new Error("at once");
    });
    wire.post("later", 1);
    assert.deepEqual(wire.failed, []);
    wire.given[0]?.lost(new Error("later"));
    await settle();
    assert.deepEqual(wire.failed.map(String), ["Error: at once", "Error: later"]);
});
