// SPDX-License-Identifier: GPL-2.0-or-later
// Makes web/client/gen from the contracts: Slice (by slice2js), messages (from protoc's descriptors) and the list of refusals.
//     node tools/generate.mjs
// AXON_ROOT names Axon's sources; without it they are two folders above web/client. ICE_SLICE_DIR names the folder of Ice's
// own Slice files. Nothing is written if nothing has changed.
import { execFileSync } from "node:child_process";
import { existsSync, mkdirSync, mkdtempSync, readFileSync, readdirSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { dirname, join, resolve } from "node:path";
import { fileURLToPath } from "node:url";

const client = resolve(dirname(fileURLToPath(import.meta.url)), "..");
const root = resolve(process.env.AXON_ROOT ?? join(client, "..", ".."));
const into = join(client, "gen");
const NOTE = "// SPDX-License-Identifier: GPL-2.0-or-later\n// Made by tools/generate.mjs; do not edit.\n";

function write(name, text) {
    const path = join(into, name);
    mkdirSync(dirname(path), { recursive: true });
    if (!existsSync(path) || readFileSync(path, "utf8") !== text) writeFileSync(path, text);
}

function run(tool, words, packaged) {
    try {
        execFileSync(tool, words, { stdio: ["ignore", "inherit", "inherit"] });
    } catch (error) {
        if (error.code !== "ENOENT") throw error;
        console.error(`generate: there is no ${tool}; fix: install Debian's package ${packaged}`);
        process.exit(2);
    }
}

/** What clients speak: commutil and frontendcomm. Imports get the file ending that Node wants. */
function slice(folder) {
    const ice = process.env.ICE_SLICE_DIR ?? "/usr/share/ice/slice";
    const api = join(root, "api/slice");
    const files = ["commutil", "frontendcomm"].map((name) => join(api, "axon", `${name}.ice`));
    run("slice2js", ["--typescript", `-I${ice}`, `-I${api}`, "--output-dir", folder, ...files], "zeroc-ice-compilers");
    for (const name of readdirSync(folder).filter((file) => /\.(js|d\.ts)$/.test(file))) {
        const text = readFileSync(join(folder, name), "utf8");
        write(join("slice", name), text.replace(/from "\.\/(\w+)"/g, 'from "./$1.js"'));
    }
}

/** The fields of one protobuf message, by number: varints as numbers, everything else as bytes. */
function fieldsOf(bytes) {
    const all = new Map();
    let at = 0;
    const varint = () => {
        let value = 0;
        for (let shift = 0; ; shift += 7) {
            const byte = bytes[at++];
            value += (byte & 0x7f) * 2 ** shift;
            if (byte < 0x80) return value;
        }
    };
    while (at < bytes.length) {
        const tag = varint();
        let value;
        if ((tag & 7) === 0) value = varint();
        else if ((tag & 7) === 2) {
            const size = varint();
            value = bytes.subarray(at, (at += size));
        } else throw new Error(`a descriptor with wire type ${tag & 7}`);
        const number = Math.floor(tag / 8);
        all.set(number, [...(all.get(number) ?? []), value]);
    }
    return { all: (no) => all.get(no) ?? [], one: (no) => all.get(no)?.at(-1), text: (no) => all.get(no)?.at(-1)?.toString("utf8") ?? "" };
}

const KINDS = { 1: "double", 2: "float", 3: "int64", 4: "uint64", 5: "int32", 8: "bool", 9: "string", 11: "message", 12: "bytes", 13: "uint32", 14: "enum", 17: "sint32", 18: "sint64" };
const TYPES = { double: "number", float: "number", int32: "number", uint32: "number", sint32: "number", enum: "number", int64: "bigint", uint64: "bigint", sint64: "bigint", bool: "boolean", string: "string", bytes: "Uint8Array" };
const camel = (name) => name.replace(/_(\w)/g, (_, letter) => letter.toUpperCase());

/** A message becomes an interface and a row of data, from which src/wire/codec.ts reads and writes it. */
function messages(folder) {
    const api = join(root, "api/proto");
    const wanted = ["messages"]; // it imports the others
    const set = join(folder, "all.bin");
    run("protoc", [`-I${api}`, "--include_imports", `--descriptor_set_out=${set}`, ...wanted.map((name) => join(api, "axon", `${name}.proto`))], "protobuf-compiler");
    const schema = {};
    let types = NOTE;
    let values = NOTE;
    const local = (full) => full.replace(/^\.axon\.proto\./, "").replaceAll(".", "_");
    const enumeration = (bytes, prefix) => {
        const descriptor = fieldsOf(bytes);
        const name = prefix + descriptor.text(1);
        const members = descriptor.all(2).map((value) => fieldsOf(value)).map((value) => [value.text(1), value.one(2) ?? 0]);
        types += `export declare const ${name}: {${members.map(([key, number]) => `readonly ${key}: ${number}`).join("; ")}};\n`;
        values += `export const ${name} = Object.freeze({${members.map(([key, number]) => `${key}: ${number}`).join(", ")}});\n`;
    };
    const message = (bytes, prefix) => {
        const descriptor = fieldsOf(bytes);
        const name = prefix + descriptor.text(1);
        for (const one of descriptor.all(4)) enumeration(one, `${name}_`);
        for (const one of descriptor.all(3)) message(one, `${name}_`);
        const rows = [];
        let members = "";
        for (const one of descriptor.all(2)) {
            const field = fieldsOf(one);
            const kind = KINDS[field.one(5)];
            if (!kind) throw new Error(`${name}.${field.text(1)}: a type that the codec does not have`);
            const repeated = field.one(4) === 3;
            const optional = field.one(17) === 1;
            const oneof = field.one(9) !== undefined && !optional;
            const type = kind === "message" ? local(field.text(6)) : TYPES[kind];
            const key = camel(field.text(1));
            const absent = !repeated && (optional || oneof || kind === "message");
            members += `    ${key}: ${type}${repeated ? "[]" : ""}${absent ? " | undefined" : ""};\n`;
            // number, name, kind, how often ("" = once, "*" = repeated, "?" = may be absent, "|" = one of several), its message
            rows.push([field.one(3), key, kind, repeated ? "*" : oneof ? "|" : absent ? "?" : "", ...(kind === "message" ? [type] : [])]);
        }
        types += `export interface ${name} {\n${members}}\n`;
        schema[name] = rows;
    };
    for (const file of fieldsOf(readFileSync(set)).all(1)) {
        const descriptor = fieldsOf(file);
        for (const one of descriptor.all(5)) enumeration(one, "");
        for (const one of descriptor.all(4)) message(one, "");
    }
    types += `export interface Messages {\n${Object.keys(schema).map((name) => `    ${name}: ${name};\n`).join("")}}\n`;
    types += "export type Row = readonly [number: number, name: string, kind: string, often: string, message?: keyof Messages];\n";
    types += "export declare const schema: Readonly<Record<keyof Messages, readonly Row[]>>;\n";
    values += `export const schema = ${JSON.stringify(schema)};\n`;
    write("messages.js", values);
    write("messages.d.ts", types);
}

/** src/common/axon/refusals.def: name, number, meaning and remedy of each. */
function refusals() {
    const text = readFileSync(join(root, "src/common/axon/refusals.def"), "utf8");
    const rows = [...text.matchAll(/^AXON_REFUSAL\((\w+), (\w+), (\d+), \d+, "((?:[^"\\]|\\.)*)", "((?:[^"\\]|\\.)*)", "((?:[^"\\]|\\.)*)"\)$/gm)];
    if (rows.length < 40) throw new Error("refusals.def has another form than expected");
    const plain = (phrase) => phrase.replace(/\[([^\]]*)\]\([^)]*\)/g, "$1").replaceAll('\\"', '"');
    const all = rows.map(([, , name, number, , meaning, remedy]) => ({ name, number: Number(number), meaning: plain(meaning), remedy: plain(remedy) }));
    write("refusals.js", `${NOTE}export const refusals = ${JSON.stringify(all, null, 1)};\n`);
    write("refusals.d.ts", `${NOTE}export type RefusalCode = ${all.filter(({ number }) => number !== 0).map(({ name }) => `"${name}"`).join(" | ")};\n`
        + "export declare const refusals: readonly {readonly name: RefusalCode | \"OK\"; readonly number: number; readonly meaning: string; readonly remedy: string}[];\n");
}

const folder = mkdtempSync(join(tmpdir(), "axon-generate-"));
try {
    slice(folder);
    messages(folder);
    refusals();
} finally {
    rmSync(folder, { recursive: true });
}
