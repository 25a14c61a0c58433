// SPDX-License-Identifier: GPL-2.0-or-later
import assert from "node:assert/strict";
import { test } from "node:test";
import { acceptValue, describeValues, type Parameter, parseValue, Refusal, refusalCodes, ticketFrom, type Value } from "../../dist/index.js";
import { parseEndpoint, parseTarget, endpointText } from "../../dist/ice/endpoint.js";
import { NameIndex } from "../../dist/core/name_index.js";
import { seal } from "../../dist/core/sub_lease.js";
import { hex } from "../../dist/ids.js";
import { parseTicket, ticketText } from "../../dist/core/leases.js";
import { refusalOf } from "../../dist/refusal.js";

const meta = (more: Partial<Parameter>): Parameter => ({
    name: "P",
    kind: "INPUT",
    dataType: "INT",
    units: "",
    descr: "",
    ready: false,
    required: false,
    savable: false,
    multiple: false,
    values: [],
    choices: [],
    minimum: undefined,
    maximum: undefined,
    ...more,
});
const codeOf = (use: () => unknown): string => {
    try {
        use();
    } catch (error) {
        if (error instanceof Refusal) return error.code;
        throw error;
    }
    return "";
};

test("Values are taken in the parameter's type, within its range, exactly", () => {
    assert.equal(acceptValue(meta({}), 5), 5n);
    assert.equal(acceptValue(meta({ dataType: "DBL" }), 5n), 5);
    assert.equal(codeOf(() => acceptValue(meta({}), 5.5)), "WRONG_TYPE");
    assert.equal(codeOf(() => acceptValue(meta({}), 2n ** 63n)), "WRONG_TYPE");
    assert.equal(codeOf(() => acceptValue(meta({ dataType: "BOOL" }), 1n)), "WRONG_TYPE");
    assert.equal(codeOf(() => acceptValue(meta({ dataType: "DBL" }), Number.NaN)), "OUT_OF_RANGE");
    assert.equal(codeOf(() => acceptValue(meta({ maximum: 2 ** 53 }), 2n ** 53n + 1n)), "OUT_OF_RANGE");
    assert.equal(codeOf(() => acceptValue(meta({ choices: [1n, 3n] }), 2)), "OUT_OF_RANGE");
    assert.equal(acceptValue(meta({ dataType: "STR", choices: ["a", "b"] }), "b"), "b");
    assert.equal(codeOf(() => acceptValue(meta({ dataType: "STR" }), "x".repeat(70_000))), "TOO_LARGE");
});

test("Texts of a form are parsed by the declared type", () => {
    const parsed: [Partial<Parameter>, string, Value][] = [
        [{}, " 9223372036854775807 ", 9223372036854775807n],
        [{}, "1e3", 1000n],
        [{ dataType: "DBL" }, "-.5", -0.5],
        [{ dataType: "BOOL" }, "Yes", true],
        [{ dataType: "STR" }, " as it is ", " as it is "],
    ];
    for (const [more, text, value] of parsed) assert.equal(parseValue(meta(more), text), value);
    for (const [more, text] of [[{}, "1.5"], [{}, "9223372036854775808"], [{}, ""], [{ dataType: "DBL" }, "1,5"], [{ dataType: "DBL" }, "1e999"], [{ dataType: "BOOL" }, "2"]] as [Partial<Parameter>, string][]) {
        assert.equal(codeOf(() => parseValue(meta(more), text)), "WRONG_TYPE", text);
    }
    assert.equal(describeValues(meta({ minimum: 0, maximum: 5000, units: "mm" })), "INT from 0 to 5000 in mm");
});

test("Endpoints are read in every form, and nothing else is", () => {
    for (const [text, ice] of [
        ["127.0.0.1:10410", "tcp -h 127.0.0.1 -p 10410"],
        ["ws://lab:10418/axon", "ws -h lab -p 10418 -r /axon"],
        ["wss://lab.example/axon", "wss -h lab.example -p 443 -r /axon"],
        ["ws -h 127.0.0.1 -p 10418 -r /axon", "ws -h 127.0.0.1 -p 10418 -r /axon"],
        ["ws://lab", "ws -h lab -p 80 -r /"],
    ] as const) {
        assert.equal(endpointText(parseEndpoint(text)), ice);
    }
    for (const bad of ["", "lab", "lab:", "lab:70000", "-h:1", "http://lab:1", "ws://a b:1", "ws://lab:1/x -p 9", "tcp://lab:1/path", "ws -h lab -p 1 -z", "ws -h -p -p 1"]) {
        assert.equal(codeOf(() => parseEndpoint(bad)), "MALFORMED", bad);
    }
    assert.equal(codeOf(() => parseEndpoint("ssl://lab:1")), "NOT_SUPPORTED");
    assert.deepEqual(parseTarget("Axon.Clients/router:tcp -h lab -p 10414").router, "Axon.Clients/router");
});

test("Names mean what people say", () => {
    const names = new NameIndex();
    names.put("aaaa1111", "Bot", true);
    names.put("bbbb2222", "Bot", true);
    names.put("cccc3333", "Arm", true);
    names.put("dddd4444", "Arm", false);
    assert.equal(names.resolve("Bot#2"), "bbbb2222");
    assert.equal(names.resolve("cccc"), "cccc3333");
    assert.equal(names.resolve("arm"), "cccc3333");
    assert.deepEqual(names.resolveAll("Arm"), ["cccc3333", "dddd4444"]);
    assert.deepEqual([names.label("bbbb2222"), names.label("cccc3333"), names.label("dddd4444"), names.label("eeee")], ["Bot#2", "Arm", "dddd4444", "eeee"]);
    assert.equal(codeOf(() => names.resolve("Bot")), "AMBIGUOUS_ENTITY");
    assert.equal(codeOf(() => names.resolve("Bots")), "UNKNOWN_ENTITY");
    assert.equal(codeOf(() => names.resolve("Bot#9")), "UNKNOWN_ENTITY");
    assert.equal(codeOf(() => names.resolve("")), "UNKNOWN_ENTITY");
});

test("The seal of a sub-lease is the one that Entity Managers expect", () => {
    const fill = (letter: string): Uint8Array => new TextEncoder().encode(letter.repeat(16));
    // By Python's hashlib.blake2b(text, key=key, digest_size=32) of the same fields.
    assert.equal(hex(seal({ epoch: 3, number: 7, root: fill("o"), stopGeneration: 5 }, fill("r"), "master", "entity", fill("k"))), "5326a596b7fb74af88c2695ceffe28ec8cd7297a3a35025eb504cb9e2659a573");
});

test("Tickets are read as they were written", () => {
    const ticket = { entity: "11111111-0000-4000-8000-000000000001", lease: { epoch: 3, number: 9 }, key: new Uint8Array(16).fill(1) };
    assert.deepEqual(parseTicket(ticketText(ticket)), ticket);
    for (const bad of ["", "axon-lease:x:1:2:y", `${ticketText(ticket)}:more`, ticketText(ticket).replace(":3:", ":-3:")]) assert.equal(codeOf(() => parseTicket(bad)), "MALFORMED");
});

test("Every refusal has a meaning, and a code that is not known is INTERNAL", () => {
    assert.ok(refusalCodes().length > 40);
    for (const { meaning } of refusalCodes()) assert.ok(meaning.length > 5 && !meaning.includes("]("), meaning);
    const held = new Refusal("ALREADY_HELD", "it is held", "ana@lab");
    assert.equal(held.number, 2);
    assert.match(held.remedy, /^ask ana@lab for it/);
    assert.deepEqual([refusalOf(999, "new")?.code, refusalOf(999, "new")?.number, refusalOf(0, "")], ["INTERNAL", 999, undefined]);
});

test("A ticket is what the server says, and its refusals are told", async () => {
    const real = globalThis.fetch;
    const answers = (status: number, body: string) => void (globalThis.fetch = async () => new Response(body, { status }));
    try {
        answers(200, '{"user": "ann", "password": "t1", "endpoint": "ws -h lab -p 10418 -r /axon", "more": 1}');
        assert.deepEqual(await ticketFrom("http://lab/ticket")(), { user: "ann", password: "t1", server: "ws -h lab -p 10418 -r /axon" });
        answers(200, '{"user": {"toString": 1}, "endpoint": ""}');
        assert.deepEqual(await ticketFrom("http://lab/ticket")(), { user: "", password: "" });
        for (const [status, body, code] of [[401, '{"code": "PERMISSION_DENIED", "message": "log in"}', "PERMISSION_DENIED"], [500, "[]", "NOT_CONNECTED"], [200, "<html>", "NOT_CONNECTED"], [400, '{"code": "NONSENSE"}', "NOT_CONNECTED"]] as const) {
            answers(status, body);
            await assert.rejects(ticketFrom("http://lab/ticket")(), (error: unknown) => error instanceof Refusal && error.code === code, body);
        }
    } finally {
        globalThis.fetch = real;
    }
});
