// SPDX-License-Identifier: GPL-2.0-or-later
import { randomBytes } from "@noble/hashes/utils";

/** Where random bytes come from; tests inject others. */
export type Random = (count: number) => Uint8Array;
export const systemRandom: Random = (count) => randomBytes(count);

/** 16 bytes as 32 hexadecimal digits: how requests and tasks are found here. */
export type Id = string;

export function hex(bytes: Uint8Array): string {
    let text = "";
    for (const byte of bytes) text += byte.toString(16).padStart(2, "0");
    return text;
}
export function fromHex(text: string): Uint8Array {
    const bytes = new Uint8Array(text.length / 2);
    for (let i = 0; i < bytes.length; ++i) bytes[i] = Number.parseInt(text.slice(2 * i, 2 * i + 2), 16);
    return bytes;
}
/** Nothing if it does not have 16 bytes. */
export function idOf(bytes: Uint8Array): Id | undefined {
    return bytes.length === 16 ? hex(bytes) : undefined;
}
export function uuidText(id: Id): string {
    return [id.slice(0, 8), id.slice(8, 12), id.slice(12, 16), id.slice(16, 20), id.slice(20)].join("-");
}
/** Of a UUID as text. */
export function parseUuid(text: string): Id | undefined {
    return /^[0-9a-f]{8}(-[0-9a-f]{4}){3}-[0-9a-f]{12}$/i.test(text) ? text.replaceAll("-", "").toLowerCase() : undefined;
}
export function randomUuid(random: Random): Id {
    const bytes = random(16);
    bytes[6] = ((bytes[6] ?? 0) & 0x0f) | 0x40;
    bytes[8] = ((bytes[8] ?? 0) & 0x3f) | 0x80;
    return hex(bytes);
}
