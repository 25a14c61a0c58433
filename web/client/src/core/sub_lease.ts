// SPDX-License-Identifier: GPL-2.0-or-later
import { blake2b } from "@noble/hashes/blake2b";
import { concatBytes, utf8ToBytes } from "@noble/hashes/utils";

/** The right of one master over one entity in one run, which its holder gives (docs/adr/0019-collaboration.md). */
export interface SubLease {
    readonly epoch: number;
    readonly number: number;
    readonly root: Uint8Array;
    readonly stopGeneration: number;
}

/**
 * The proof of a sub-lease: a MAC over all of it under the key of the entity's own lease, which only its holder and its Entity
 * Manager know. Each field goes with its length, so that none can be taken for a part of another.
 */
export function seal(lease: SubLease, runId: Uint8Array, master: string, entity: string, key: Uint8Array): Uint8Array {
    const fields: (string | Uint8Array)[] = ["axon sub-lease 1", runId, master, entity, String(lease.epoch), String(lease.number), lease.root, String(lease.stopGeneration)];
    const text = fields.flatMap((field) => {
        const bytes = typeof field === "string" ? utf8ToBytes(field) : field;
        return [utf8ToBytes(`${bytes.length}:`), bytes];
    });
    return blake2b(concatBytes(...text), { key, dkLen: 32 });
}
