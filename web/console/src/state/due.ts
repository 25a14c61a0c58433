// SPDX-License-Identifier: GPL-2.0-or-later
/** An entity that has not answered is asked again after this. */
const AGAIN_MS = 10_000;
/** One that has answered may offer something else by then, as when its application was started with other profiles. */
const ANSWER_OLD_MS = 120_000;

/** Whether to ask an entity for its services. */
export function isDue(answered: boolean, askedAt: number | undefined, now: number): boolean {
    return askedAt === undefined || now - askedAt >= (answered ? ANSWER_OLD_MS : AGAIN_MS);
}
