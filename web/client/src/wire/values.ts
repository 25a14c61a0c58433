// SPDX-License-Identifier: GPL-2.0-or-later
// The rules for the values of parameters, and for finding things in a profile by name (docs/reference/profiles.md). The Entity
// Manager has the same rules and the last word; here they spare a round trip and can explain themselves in a form. Pure functions.
import type * as proto from "../../gen/messages.js";
import { Refusal, type RefusalCode } from "../refusal.js";
import type { Argument, DataType, Parameter, Resource, Service, Value } from "../types.js";
import type { Init } from "./codec.js";
import { fromValue, textOf } from "./content.js";

const TEXT_MAX = 65_536;
const SEARCH_BUDGET = 50_000; // cells of edit distance, whatever a hostile profile names its services
const letters = new TextEncoder();

/** For a message: no control characters, and not too long. */
export function inQuotes(text: string, most = 64): string {
    const shown = Array.from(text.slice(0, 2 * most)).slice(0, most).join("");
    // eslint-disable-next-line no-control-regex
    return `"${shown.replace(/[\u0000-\u001f\u007f]/g, "?")}${shown.length < text.length ? "..." : ""}"`;
}

/** Upper and lower case of A to Z are the same. */
export function folded(text: string): string {
    return text.replace(/[A-Z]/g, (letter) => letter.toLowerCase());
}

function editDistance(a: string, b: string): number {
    let row = Array.from({ length: b.length + 1 }, (_, j) => j);
    for (let i = 1; i <= a.length; ++i) {
        const next = [i];
        for (let j = 1; j <= b.length; ++j) {
            const replaced = (row[j - 1] as number) + (folded(a[i - 1] as string) === folded(b[j - 1] as string) ? 0 : 1);
            next.push(Math.min(replaced, (row[j] as number) + 1, (next[j - 1] as number) + 1));
        }
        row = next;
    }
    return row[b.length] as number;
}
/** At most three names that somebody may have meant. */
export function nearNames(name: string, candidates: readonly string[]): string[] {
    if (name === "" || name.length > 512) return [];
    const limit = Math.max(2, Math.floor(name.length / 3));
    let budget = SEARCH_BUDGET;
    const near: { distance: number; candidate: string }[] = [];
    for (const candidate of new Set(candidates)) {
        const longer = Math.max(candidate.length, name.length);
        if (candidate === "" || Math.abs(candidate.length - name.length) > limit) continue;
        budget -= name.length * candidate.length;
        if (budget < 0) break;
        const distance = editDistance(name, candidate);
        if (distance <= limit && distance < longer) near.push({ distance, candidate });
    }
    return near.sort((a, b) => a.distance - b.distance).slice(0, 3).map(({ candidate }) => candidate);
}
export function alternatives(names: readonly string[]): string {
    return names.map((name) => inQuotes(name)).join(", ").replace(/, ([^,]*)$/, " or $1");
}

/** The one with this name in any of the lists, or else the only one that differs in upper and lower case alone. */
function find<One>(wanted: string, all: readonly One[], names: readonly ((one: One) => string)[], code: RefusalCode, what: string, where: string): One {
    for (const name of names) {
        const exact = all.find((one) => wanted !== "" && name(one) === wanted);
        if (exact !== undefined) return exact;
    }
    const same = all.filter((one) => wanted !== "" && names.some((name) => folded(name(one)) === folded(wanted)));
    if (same.length === 1) return same[0] as One;
    const first = names[0] as (one: One) => string;
    const candidates = same.length > 0 ? same.slice(0, 8).map(first) : nearNames(wanted, all.flatMap((one) => names.map((name) => name(one))));
    let message = `no ${what} ${inQuotes(wanted)} ${where}`;
    if (candidates.length > 0) message += `; did you mean ${alternatives(candidates)}?`;
    else if (all.length === 0) message += "; it has none";
    else message += `; it has ${all.slice(0, 8).map((one) => inQuotes(first(one))).join(", ")}${all.length > 8 ? ` and ${all.length - 8} more` : ""}`;
    throw new Refusal(code, message);
}
export function findService(services: readonly Service[], nameOrGlobalId: string): Service {
    return find(nameOrGlobalId, services, [(one) => one.name, (one) => one.globalId], "UNKNOWN_SERVICE", "service", "is offered by this entity");
}
export function findParameter(service: Service, name: string): Parameter {
    return find(name, service.parameters, [(one) => one.name], "UNKNOWN_PARAMETER", "parameter", `in service ${inQuotes(service.name)}`);
}
export function findResource(service: Service, name: string): Resource {
    return find(name, service.resources, [(one) => one.name], "UNKNOWN_RESOURCE", "resource", `in service ${inQuotes(service.name)}`);
}

/** What the parameter accepts, for a person: `INT from 0 to 5000 in mm`, `STR, one of "red", "green"`. */
export function describeValues(meta: Parameter): string {
    let text = meta.dataType === "" ? "a value of a data type that its profile does not give" : meta.dataType === "BOOL" ? "BOOL (true or false)" : meta.dataType;
    if (meta.multiple) text += " list";
    if (meta.minimum !== undefined && meta.maximum !== undefined) text += ` from ${meta.minimum} to ${meta.maximum}`;
    else if (meta.minimum !== undefined) text += ` of at least ${meta.minimum}`;
    else if (meta.maximum !== undefined) text += ` of at most ${meta.maximum}`;
    if (meta.units !== "") text += ` in ${meta.units}`;
    if (meta.choices.length > 0) {
        text += `, one of ${meta.choices.slice(0, 12).map((choice) => (typeof choice === "string" ? inQuotes(choice) : textOf(choice))).join(", ")}`;
        if (meta.choices.length > 12) text += ", ...";
    }
    return text;
}

function described(value: Value): string {
    switch (typeof value) {
        case "bigint":
            return `the INT ${value}`;
        case "number":
            return `the DBL ${value}`;
        case "boolean":
            return `the BOOL ${value}`;
        case "string":
            return `the STR ${inQuotes(value)}`;
        default:
            return `what is no value: ${inQuotes(String(value))}`; // of a program without types
    }
}
const wrongType = (meta: Parameter, found: string): Refusal => new Refusal("WRONG_TYPE", `${inQuotes(meta.name)} takes ${describeValues(meta)}; found ${found}`);

/** A whole number that an INT can be. */
function whole(value: number): bigint | undefined {
    if (!Number.isInteger(value)) return undefined;
    const exact = BigInt(value);
    return BigInt.asIntN(64, exact) === exact ? exact : undefined;
}
function converted(type: DataType, value: Value): Value | undefined {
    switch (type) {
        case "INT":
            if (typeof value === "bigint") return BigInt.asIntN(64, value) === value ? value : undefined;
            return typeof value === "number" ? whole(value) : undefined;
        case "DBL":
            return typeof value === "bigint" ? Number(value) : typeof value === "number" ? value : undefined;
        case "STR":
            return typeof value === "string" ? value : undefined;
        case "BOOL":
            return typeof value === "boolean" ? value : undefined;
        default:
            return undefined;
    }
}
/** One value from an input field, of the parameter's type. */
export function parseValue(meta: Parameter, text: string): Value {
    const trimmed = text.trim();
    const number = /^[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d{1,4})?$/i;
    switch (meta.dataType) {
        case "INT": {
            if (/^[+-]?\d{1,19}$/.test(trimmed)) {
                const value = BigInt(trimmed.replace(/^\+/, ""));
                if (BigInt.asIntN(64, value) === value) return value;
            }
            const value = number.test(trimmed) ? whole(Number(trimmed)) : undefined;
            if (value === undefined) throw wrongType(meta, inQuotes(text));
            return value;
        }
        case "DBL": {
            const value = number.test(trimmed) ? Number(trimmed) : Number.NaN;
            if (!Number.isFinite(value)) throw wrongType(meta, inQuotes(text));
            return value;
        }
        case "BOOL":
            if (/^(true|1|yes|on)$/i.test(trimmed)) return true;
            if (/^(false|0|no|off)$/i.test(trimmed)) return false;
            throw wrongType(meta, inQuotes(text));
        case "STR":
            return text;
        default:
            throw wrongType(meta, inQuotes(text));
    }
}

/** Throws WRONG_TYPE, OUT_OF_RANGE or TOO_LARGE. */
export function acceptValue(meta: Parameter, given: Value): Value {
    const value = converted(meta.dataType, given);
    if (value === undefined) throw wrongType(meta, described(given));
    const outOfRange = new Refusal("OUT_OF_RANGE", `${inQuotes(meta.name)} takes ${describeValues(meta)}; found ${typeof value === "string" ? inQuotes(value) : textOf(value)}`);
    if (typeof value === "string" && letters.encode(value).length > TEXT_MAX) {
        throw new Refusal("TOO_LARGE", `${inQuotes(meta.name)} takes texts of at most ${TEXT_MAX} bytes: upload a file as a resource`);
    }
    if (typeof value === "number" && !Number.isFinite(value)) throw outOfRange;
    // A bigint is compared with a number exactly.
    if (typeof value === "number" || typeof value === "bigint") {
        if (meta.minimum !== undefined && value < meta.minimum) throw outOfRange;
        if (meta.maximum !== undefined && value > meta.maximum) throw outOfRange;
    }
    if (meta.choices.length > 0 && !meta.choices.includes(value)) throw outOfRange;
    return value;
}

/** What an argument becomes on the wire. Throws a Refusal that says what the parameter takes. */
export function toParam(service: Service, argument: Argument): Init<proto.Param> {
    if (typeof argument?.name !== "string" || !Array.isArray(argument.values)) {
        throw new Refusal("MALFORMED", "An argument has a name and a list of values: { name: \"Distance\", values: [100] }.");
    }
    const meta = findParameter(service, argument.name);
    if (argument.values.length === 0) throw wrongType(meta, "no value");
    if (argument.values.length > 1 && !meta.multiple) throw wrongType(meta, `${argument.values.length} values where one is allowed`);
    const units = argument.units ?? "";
    if (units !== "" && units !== meta.units) {
        throw new Refusal("WRONG_UNITS", `${inQuotes(meta.name)} takes ${describeValues(meta)}; found the unit ${inQuotes(units)}${meta.units === "" ? ": leave the unit out" : ": convert the value"}`);
    }
    const values = argument.values.map((given) => acceptValue(meta, argument.fromText === true ? parseValue(meta, textOf(given)) : given));
    return { name: meta.name, units, values: values.map(fromValue) };
}
