// SPDX-License-Identifier: GPL-2.0-or-later
// Reads and writes the messages of api/proto (protobuf, proto3) by the rows that tools/generate.mjs makes.
// What arrives is hostile until it is read: keys come from the rows and never from the bytes, depth and number of elements
// are bounded, and texts must be UTF-8.
import { type Messages, type Row, schema } from "../../gen/messages.js";

/** A message that is to be written: what is left out has its default. */
export type Init<T> = T extends Uint8Array | bigint | string | number | boolean | undefined
    ? T
    : T extends readonly (infer One)[]
      ? readonly Init<One>[]
      : { [Key in keyof T]?: Init<T[Key]> | undefined };

/** Bytes that are no such message. */
export class Malformed extends Error {}

/** Messages within messages: twice what the deepest of api/proto has. */
const DEPTH_MAX = 24;
/**
 * Submessages, texts and numbers in one message, but for packed ones of a fixed size: a few bytes on the wire may become a large
 * object.
 */
const ELEMENTS_MAX = 65_536;

type Plain = Record<string, unknown>;
interface Known {
    readonly rows: readonly Row[];
    /** A message without fields, but for its lists. */
    readonly empty: Plain;
    readonly lists: readonly string[];
    readonly byNumber: ReadonlyMap<number, Row>;
    readonly alternatives: readonly string[];
}

const known = new Map<keyof Messages, Known>();
for (const [name, rows] of Object.entries(schema) as [keyof Messages, readonly Row[]][]) {
    known.set(name, {
        rows,
        empty: Object.fromEntries(rows.map(([, key, kind, often]) => [key, often === "" ? defaultOf(kind) : undefined])),
        lists: rows.filter((row) => row[3] === "*").map((row) => row[1]),
        byNumber: new Map(rows.map((row) => [row[0], row])),
        alternatives: rows.filter((row) => row[3] === "|").map((row) => row[1]),
    });
}
const knownOf = (name: keyof Messages): Known => known.get(name) as Known;

const texts = new TextDecoder("utf-8", { fatal: true, ignoreBOM: true });
const letters = new TextEncoder();

function defaultOf(kind: string): unknown {
    switch (kind) {
        case "string":
            return "";
        case "bool":
            return false;
        case "bytes":
            return new Uint8Array(0);
        case "int64":
        case "uint64":
        case "sint64":
            return 0n;
        default:
            return 0;
    }
}

class Reader {
    private at = 0;
    constructor(
        private readonly bytes: Uint8Array,
        private readonly budget: { left: number },
    ) {}

    get done(): boolean {
        return this.at >= this.bytes.length;
    }
    spend(count = 1): void {
        if ((this.budget.left -= count) < 0) throw new Malformed(`a message with more than ${ELEMENTS_MAX} elements`);
    }
    /** As 64 bits without sign. */
    varint(): bigint {
        let low = 0; // of 28 bits each, so that numbers stay exact
        let middle = 0;
        let high = 0;
        for (let count = 0; count < 10; ++count) {
            const byte = this.bytes[this.at++];
            if (byte === undefined) throw new Malformed("a message that ends within a number");
            const bits = byte & 0x7f;
            if (count < 4) low |= bits << (7 * count);
            else if (count < 8) middle |= bits << (7 * (count - 4));
            else high |= bits << (7 * (count - 8));
            if (byte < 0x80) return count < 4 ? BigInt(low) : BigInt.asUintN(64, (BigInt(high) << 56n) | (BigInt(middle) << 28n) | BigInt(low));
        }
        throw new Malformed("a number of more than ten bytes");
    }
    /** A tag or a length. */
    size(): number {
        const value = this.varint();
        if (value > 0xffff_ffffn) throw new Malformed("a length above 4 GiB");
        return Number(value);
    }
    take(count: number): Uint8Array {
        if (count > this.bytes.length - this.at) throw new Malformed("a message that is shorter than it says");
        return this.bytes.subarray(this.at, (this.at += count));
    }
    private view(count: number): DataView {
        const part = this.take(count);
        return new DataView(part.buffer, part.byteOffset, count);
    }
    skip(wire: number): void {
        if (wire === 0) this.varint();
        else if (wire === 1) this.take(8);
        else if (wire === 2) this.take(this.size());
        else if (wire === 5) this.take(4);
        else throw new Malformed(`a field of the wire type ${wire}`);
    }
    value(kind: string): unknown {
        switch (kind) {
            case "double":
                return this.view(8).getFloat64(0, true);
            case "float":
                return this.view(4).getFloat32(0, true);
            case "int64":
                return BigInt.asIntN(64, this.varint());
            case "uint64":
                return this.varint();
            case "sint64": {
                const value = this.varint();
                return (value >> 1n) ^ -(value & 1n);
            }
            case "int32":
            case "enum":
                return Number(BigInt.asIntN(32, this.varint()));
            case "uint32":
                return Number(BigInt.asUintN(32, this.varint()));
            case "sint32": {
                const value = BigInt.asUintN(32, this.varint());
                return Number((value >> 1n) ^ -(value & 1n));
            }
            case "bool":
                return this.varint() !== 0n;
            case "string":
                return this.text();
            default:
                return this.take(this.size()).slice();
        }
    }
    /** How many numbers a packed list has, before any of them is read. Those of a fixed size take no more memory than bytes. */
    count(kind: string): number {
        const rest = this.bytes.length - this.at;
        const size = kind === "double" ? 8 : kind === "float" ? 4 : 0;
        if (size > 0) {
            if (rest % size !== 0) throw new Malformed("a list of numbers that ends within one");
            return rest / size;
        }
        let count = 0;
        for (let i = this.at; i < this.bytes.length; ++i) if ((this.bytes[i] as number) < 0x80) ++count;
        this.spend(count);
        return count;
    }
    private text(): string {
        const part = this.take(this.size());
        try {
            return texts.decode(part);
        } catch {
            throw new Malformed("a text that is not UTF-8");
        }
    }
    inner(): Reader {
        return new Reader(this.take(this.size()), this.budget);
    }
}

function wireOf(kind: string): number {
    switch (kind) {
        case "double":
            return 1;
        case "string":
        case "bytes":
        case "message":
            return 2;
        case "float":
            return 5;
        default:
            return 0;
    }
}

function empty(name: keyof Messages): Plain {
    const { empty: fields, lists } = knownOf(name);
    const message: Plain = { ...fields };
    for (const key of lists) message[key] = [];
    return message;
}

function read(name: keyof Messages, from: Reader, depth: number): Plain {
    if (depth > DEPTH_MAX) throw new Malformed(`messages within messages, more than ${DEPTH_MAX} deep`);
    const { byNumber, alternatives } = knownOf(name);
    const message = empty(name);
    while (!from.done) {
        const tag = from.size();
        const wire = tag & 7;
        const number = tag >>> 3;
        if (number === 0) throw new Malformed("a field with the number 0");
        const row = byNumber.get(number);
        const packed = row !== undefined && row[3] === "*" && wire === 2 && wireOf(row[2]) !== 2;
        if (row === undefined || (wire !== wireOf(row[2]) && !packed)) {
            from.skip(wire);
            continue;
        }
        const [, key, kind, often, of] = row;
        if (packed) {
            const values = from.inner();
            const list = message[key] as unknown[];
            for (let left = values.count(kind); left > 0; --left) list.push(values.value(kind));
            if (!values.done) throw new Malformed("a list of numbers that ends within one");
            continue;
        }
        if (often === "*" || kind === "message") from.spend();
        const value = kind === "message" ? read(of as keyof Messages, from.inner(), depth + 1) : from.value(kind);
        if (often === "*") {
            (message[key] as unknown[]).push(value);
        } else {
            if (often === "|") for (const other of alternatives) message[other] = undefined;
            message[key] = value;
        }
    }
    return message;
}

/** Throws Malformed. */
export function decode<Name extends keyof Messages>(name: Name, bytes: Uint8Array): Messages[Name] {
    return read(name, new Reader(bytes, { left: ELEMENTS_MAX }), 0) as unknown as Messages[Name];
}

class Writer {
    private bytes = new Uint8Array(256);
    private at = 0;

    private room(count: number): void {
        if (this.at + count <= this.bytes.length) return;
        const wider = new Uint8Array(Math.max(this.bytes.length * 2, this.at + count));
        wider.set(this.bytes.subarray(0, this.at));
        this.bytes = wider;
    }
    varint(value: bigint | number): void {
        this.room(10);
        if (typeof value === "number" && value >= 0 && value < 0x8000_0000) {
            for (; value > 0x7f; value >>>= 7) this.bytes[this.at++] = (value & 0x7f) | 0x80;
            this.bytes[this.at++] = value;
            return;
        }
        let rest = BigInt.asUintN(64, BigInt(value));
        for (; rest > 0x7fn; rest >>= 7n) this.bytes[this.at++] = Number(rest & 0x7fn) | 0x80;
        this.bytes[this.at++] = Number(rest);
    }
    block(part: Uint8Array): void {
        this.varint(part.length);
        this.room(part.length);
        this.bytes.set(part, this.at);
        this.at += part.length;
    }
    private fixed(count: number, set: (view: DataView) => void): void {
        this.room(count);
        set(new DataView(this.bytes.buffer, this.at, count));
        this.at += count;
    }
    value(kind: string, value: unknown): void {
        switch (kind) {
            case "double":
                return this.fixed(8, (view) => view.setFloat64(0, value as number, true));
            case "float":
                return this.fixed(4, (view) => view.setFloat32(0, value as number, true));
            case "sint64":
                return this.varint(((value as bigint) << 1n) ^ ((value as bigint) >> 63n));
            case "sint32":
                return this.varint((BigInt(value as number) << 1n) ^ (BigInt(value as number) >> 31n));
            case "bool":
                return this.varint(value === true ? 1 : 0);
            case "string":
                return this.block(letters.encode(value as string));
            case "bytes":
                return this.block(value as Uint8Array);
            case "int64":
            case "uint64":
                return this.varint(value as bigint);
            default:
                return this.varint(Math.trunc(value as number));
        }
    }
    take(): Uint8Array {
        return this.bytes.slice(0, this.at);
    }
}

const isDefault = (value: unknown): boolean =>
    value === 0n || value === "" || value === false || Object.is(value, 0) || (value instanceof Uint8Array && value.length === 0);

function write(name: keyof Messages, message: Plain): Uint8Array {
    const out = new Writer();
    const put = (row: Row, value: unknown): void => {
        out.varint((row[0] << 3) | wireOf(row[2]));
        if (row[2] === "message") out.block(write(row[4] as keyof Messages, value as Plain));
        else out.value(row[2], value);
    };
    for (const row of knownOf(name).rows) {
        const [number, key, kind, often] = row;
        const value = message[key];
        if (value === undefined) continue;
        if (often !== "*") {
            if (often !== "" || !isDefault(value)) put(row, value);
        } else if (wireOf(kind) === 2) {
            for (const one of value as readonly unknown[]) put(row, one);
        } else if ((value as readonly unknown[]).length > 0) {
            const packed = new Writer();
            for (const one of value as readonly unknown[]) packed.value(kind, one);
            out.varint((number << 3) | 2);
            out.block(packed.take());
        }
    }
    return out.take();
}

export function encode<Name extends keyof Messages>(name: Name, message: Init<Messages[Name]>): Uint8Array {
    return write(name, message as Plain);
}
