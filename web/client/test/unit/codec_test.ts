// SPDX-License-Identifier: GPL-2.0-or-later
import assert from "node:assert/strict";
import { execFileSync } from "node:child_process";
import { join, resolve } from "node:path";
import { test } from "node:test";
import { decode, encode, Malformed } from "../../dist/wire/codec.js";
import { toSample } from "../../dist/wire/content.js";

const ROOT = resolve(process.env["AXON_ROOT"] ?? "../..");
const bytes = (...all: number[]): Uint8Array => Uint8Array.from(all);

test("What is written is read as it was, at the edges of every type", () => {
    const values = [
        { int: -(2n ** 63n) },
        { int: 2n ** 63n - 1n },
        { int: 0n },
        { dbl: -0.1 },
        { dbl: 0 },
        { str: "Größe 🤖" },
        { str: "" },
        { bool: false },
    ];
    const task = { taskId: bytes(0, 1, 255), service: "Drive", params: [{ name: "a", values, units: "mm" }], notAfterS: 1.5 };
    const read = decode("ToEntity", encode("ToEntity", { task })).task;
    assert.deepEqual(read?.params[0]?.values, values.map((value) => ({ int: undefined, dbl: undefined, str: undefined, bool: undefined, ...value })));
    assert.deepEqual([read.service, read.notAfterS, [...read.taskId]], ["Drive", 1.5, [0, 1, 255]]);
    const scan = { startAngle: -1, step: 0.5, maxRange: 8, ranges: [1, 2.5], angles: [] };
    const sample = decode("StreamSample", encode("StreamSample", { stream: "s", sequence: 2n ** 64n - 1n, takenAtUs: -5n, scan }));
    assert.deepEqual([sample.sequence, sample.takenAtUs, sample.scan], [2n ** 64n - 1n, -5n, scan]);
    const step = decode("StepStatus", encode("StepStatus", { step: -1, preced: -(2 ** 31), tries: 2 ** 32 - 1 }));
    assert.deepEqual([step.step, step.preced, step.tries], [-1, -(2 ** 31), 2 ** 32 - 1]);
});

test("protoc reads what this codec writes, and the other way round", () => {
    const protoc = (mode: string, input: Uint8Array | string): Buffer =>
        execFileSync("protoc", [`-I${join(ROOT, "api/proto")}`, `--${mode}=axon.proto.ToEntity`, "axon/messages.proto"], { input });
    const text = protoc("decode", encode("ToEntity", { checkOut: { requestId: bytes(65), phase: 1, reserveS: 2.5, wait: true, resume: { epoch: 4_000_000_000, number: 7 } } })).toString();
    assert.match(text, /check_out \{\s+request_id: "A"\s+phase: TAKE\s+reserve_s: 2.5\s+wait: true\s+resume \{\s+epoch: 4000000000\s+number: 7\s+\}\s+\}/);
    const read = decode("ToEntity", protoc("encode", 'collaboration { run_id: "r" asked_at_ms: -3 service { name: "x" steps { preced: -1 role: 2 params { name: "p" values { int: -9 } } } } }'));
    assert.equal(read.collaboration?.askedAtMs, -3n);
    assert.deepEqual([read.collaboration.service?.steps[0]?.preced, read.collaboration.service?.steps[0]?.params[0]?.values[0]?.int], [-1, -9n]);
});

test("Unknown fields are skipped, and the last of several alternatives counts", () => {
    const known = encode("ToClient", { text: { text: "hello" } });
    const unknown = bytes(0xf8, 0x3f, 5, 0xfa, 0x3f, 2, 1, 2, 0xfd, 0x3f, 1, 2, 3, 4, 0xf9, 0x3f, 1, 2, 3, 4, 5, 6, 7, 8);
    assert.equal(decode("ToClient", Uint8Array.from([...unknown, ...known])).text?.text, "hello");
    const both = decode("ToClient", Uint8Array.from([...known, ...encode("ToClient", { reply: {} })]));
    assert.deepEqual([both.text, both.reply?.refusal], [undefined, undefined]);
    assert.ok(both.reply);
});

test("Hostile bytes are refused and leave nothing behind", () => {
    const bad = [
        bytes(0x0a), // ends within a length
        bytes(0x0a, 5, 1), // is shorter than it says
        bytes(0x0a, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 1), // a number without end
        bytes(0x0a, 0xff, 0xff, 0xff, 0xff, 0x7f), // 32 GiB
        bytes(0x00, 1), // field 0
        bytes(0x0b), // a group
        Uint8Array.from([0x4a, 4, 0x0a, 2, 0xc3, 0x28]), // a text that is not UTF-8
    ];
    for (const one of bad) assert.throws(() => decode("ToClient", one), Malformed, Buffer.from(one).toString("hex"));
    // Two bytes each become an object: not without a bound.
    const many = new Uint8Array(1_000_000);
    for (let i = 0; i < many.length; i += 2) many[i] = 0x0a;
    assert.throws(() => decode("ServicesProfile", many), Malformed);
    const mean = decode("TaskEvent", encode("TaskEvent", { results: [{ name: "__proto__", values: [{ str: "x" }] }] }));
    assert.equal(mean.results[0]?.name, "__proto__");
    assert.equal(({} as Record<string, unknown>)["values"], undefined);
});

test("Packed numbers are counted before memory is taken for them", () => {
    const length = (count: number): number[] => {
        const all: number[] = [];
        for (; count > 0x7f; count = Math.floor(count / 128)) all.push((count % 128) | 0x80);
        return [...all, count];
    };
    const packed = (field: number, content: Uint8Array, says = content.length): Uint8Array => {
        const head = [(field << 3) | 2, ...length(says)];
        const all = new Uint8Array(head.length + content.length);
        all.set(head);
        all.set(content, head.length);
        return all;
    };
    assert.throws(() => decode("Vector", packed(1, bytes(1, 2, 3), 0x7fff_ffff)), Malformed); // 2 GiB that are not there
    assert.throws(() => decode("Vector", packed(1, new Uint8Array(12))), Malformed); // one and a half
    assert.throws(() => decode("Scan", packed(4, new Uint8Array(7))), Malformed);
    const largest = new Uint8Array(4 * 1024 * 1024);
    assert.equal(decode("Vector", packed(1, largest.subarray(0, 8 * 1000))).values.length, 1000);
    // One byte of it becomes an entry of a list.
    const hostile = packed(3, largest);
    const before = process.memoryUsage().heapUsed;
    assert.throws(() => decode("InvitationAnswer", hostile), Malformed);
    assert.ok(process.memoryUsage().heapUsed - before < 8 * 1024 * 1024, "nothing was taken for them");
    const twice = decode("Vector", Uint8Array.from([...encode("Vector", { values: [1, 2] }), ...encode("Vector", { values: [3] })]));
    assert.deepEqual(twice.values, [1, 2, 3]);
});

test("Random bytes within messages that are otherwise right never do more than fail", () => {
    let seed = 20261126;
    const next = (): number => (seed = (seed * 1103515245 + 12345) & 0x7fffffff) >> 8;
    const right = [
        encode("ToClient", { sample: { stream: "laser", sequence: 1n, scan: { ranges: [1, 2, 3, 4], angles: [0, 1] } } }),
        encode("ToClient", { sample: { stream: "joints", sequence: 2n, vector: { values: [1, 2, 3], units: "deg" } } }),
        encode("ToClient", { task: { taskId: new Uint8Array(16), state: 3, results: [{ name: "a", values: [{ int: 5n }, { str: "x" }] }] } }),
    ];
    let refused = 0;
    for (let i = 0; i < 20_000; ++i) {
        const one = Uint8Array.from(right[i % right.length] as Uint8Array);
        for (let changes = 1 + (next() % 3); changes > 0; --changes) one[next() % one.length] = next() & 0xff;
        try {
            decode("ToClient", next() % 4 === 0 ? one.subarray(0, next() % one.length) : one);
        } catch (error) {
            assert.ok(error instanceof Malformed, String(error));
            ++refused;
        }
    }
    assert.ok(refused > 1000 && refused < 20_000, `${refused} were refused`);
});

test("Random bytes never do more than fail", () => {
    let seed = 12345;
    const next = (): number => (seed = (seed * 1103515245 + 12345) & 0x7fffffff) >> 8;
    for (let i = 0; i < 20_000; ++i) {
        const one = Uint8Array.from({ length: next() % 40 }, () => next() & 0xff);
        try {
            decode(i % 2 === 0 ? "ToClient" : "RunHistory", one);
        } catch (error) {
            assert.ok(error instanceof Malformed);
        }
    }
});

test("A pose that is no place is left out", () => {
    const poseOf = (more: object): unknown => toSample("x", decode("ToClient", encode("ToClient", { sample: { stream: "pose", pose: { x: 1, y: -2, yaw: 3, ...more } } })).sample as never, 0)?.content;
    assert.deepEqual(poseOf({}), { kind: "pose", x: 1, y: -2, z: 0, roll: 0, pitch: 0, yaw: 3, frame: "" });
    assert.ok(poseOf({ x: 1e6, y: -1e6 }));
    for (const more of [{ x: Number.NaN }, { y: Infinity }, { z: -Infinity }, { yaw: Number.NaN }, { x: 1e7 }, { y: -1e300 }]) assert.equal(poseOf(more), undefined, JSON.stringify(more));
});
