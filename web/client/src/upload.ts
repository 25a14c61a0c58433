// SPDX-License-Identifier: GPL-2.0-or-later
import { sha256 } from "@noble/hashes/sha256";
import { CHUNK_MAX } from "./core/commands.js";
import type { Held } from "./core/context.js";
import { Refusal } from "./refusal.js";
import type { Session } from "./session.js";

export interface UploadOptions {
    /** For the robot's machine; a File's own name, or that of the resource. */
    readonly fileName?: string;
    /** Bytes that have been sent, and all of them. */
    readonly onProgress?: (sent: number, total: number) => void;
    /** Called with the SHA-256 of the file before its first byte is sent. */
    readonly onHash?: (sha256: Uint8Array) => void;
    /** Ends the upload with CANCELLED before its next chunk; a later one goes on from there. */
    readonly signal?: AbortSignal;
}

const READ_BYTES = 1024 * 1024;

const unreadable = (why: string): Refusal => new Refusal("UNKNOWN_RESOURCE", `The file cannot be read: ${why}`);
async function bytesOf(file: Blob, from: number, to: number): Promise<Uint8Array> {
    let bytes: Uint8Array;
    try {
        bytes = new Uint8Array(await file.slice(from, to).arrayBuffer());
    } catch (error) {
        throw unreadable(error instanceof Error ? error.message : String(error)); // moved or deleted since it was chosen
    }
    if (bytes.length !== to - from) throw unreadable("it has become shorter while it was sent.");
    return bytes;
}
async function hashOf(file: Blob): Promise<Uint8Array> {
    const hash = sha256.create();
    for (let at = 0; at < file.size; at += READ_BYTES) hash.update(await bytesOf(file, at, Math.min(at + READ_BYTES, file.size)));
    return hash.digest();
}

/** What an upload waits for: more credit, or its end. */
class Window {
    from: number | undefined;
    to = 0;
    ended = false;
    refusal: Refusal | undefined;
    private wake: (() => void) | undefined;

    credit(from: number, to: number): void {
        this.from ??= from;
        this.to = Math.max(this.to, to);
        this.wake?.();
    }
    finish(refusal?: Refusal): void {
        if (!this.ended) this.refusal = refusal;
        this.ended = true;
        this.wake?.();
    }
    change(): Promise<void> {
        return new Promise((resolve) => (this.wake = resolve));
    }
    /** Sends when it is this upload's turn: uploads share the data lane chunk by chunk. False if the upload has ended. */
    inTurn(session: Session, send: () => boolean): Promise<boolean> {
        return new Promise((resolve, reject) => {
            const withdraw = session.onRoom(() => {
                try {
                    resolve(!this.ended && send());
                } catch (error) {
                    reject(error);
                }
            });
            this.wake = () => {
                if (!this.ended) return;
                withdraw();
                resolve(false);
            };
        });
    }
}

/** Sends a file in chunks, as fast as the Entity Manager gives credit. Goes on where an earlier upload of the same file ended. */
export async function upload(session: Session, held: Held, service: string, resource: string, content: Blob | Uint8Array, options: UploadOptions): Promise<void> {
    const file = content instanceof Uint8Array ? new Blob([content as Uint8Array<ArrayBuffer>]) : content;
    const most = session.core.leases.mine(held).resourceBytesMax;
    if (most > 0 && file.size > most) {
        throw new Refusal("TOO_LARGE", `The file has ${file.size} bytes, and the entity takes at most ${most}. Upload a smaller one, or raise Axon.ResourceBytesMax in the configuration of its Entity Manager.`);
    }
    const own = "name" in file && typeof file.name === "string" ? file.name : resource;
    const sum = await hashOf(file);
    options.onHash?.(sum);
    const cancelled = (): Refusal => new Refusal("CANCELLED", "The upload was cancelled; it goes on when it is begun again.");
    if (options.signal?.aborted === true) throw cancelled();

    const window = new Window();
    const id = session.turn(() => session.core.commands.offer(held, service, resource, { name: options.fileName ?? own, size: file.size, sha256: sum }, (refusal) => window.finish(refusal)));
    session.credits.set(id, (from, to) => window.credit(from, to));
    const onAbort = (): void => window.finish(cancelled());
    options.signal?.addEventListener("abort", onAbort);
    let sent: number | undefined;
    try {
        while (!window.ended) {
            sent ??= window.from;
            const to = Math.min(window.to, file.size);
            if (sent === undefined || sent >= to) {
                await window.change();
                continue;
            }
            const end = Math.min(sent + CHUNK_MAX, to);
            const chunk = await bytesOf(file, sent, end);
            const from = sent;
            if (window.ended || !(await window.inTurn(session, () => session.turn(() => session.core.commands.sendChunk(id, from, chunk))))) continue;
            sent = end;
            const { onProgress } = options;
            if (onProgress !== undefined) session.later(() => onProgress(end, file.size));
        }
    } catch (error) {
        window.finish(error instanceof Refusal ? error : unreadable(error instanceof Error ? error.message : String(error)));
    } finally {
        options.signal?.removeEventListener("abort", onAbort);
        session.credits.delete(id);
    }
    const { refusal } = window;
    if (refusal === undefined) return;
    session.turn(() => {
        // An empty chunk makes the Entity Manager put away what it has, to be gone on with.
        session.core.commands.sendChunk(id, sent ?? 0, new Uint8Array(0));
        session.core.commands.endUpload(id, refusal);
    });
    throw refusal;
}
