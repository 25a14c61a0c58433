// SPDX-License-Identifier: GPL-2.0-or-later
import { signal } from "@preact/signals";

/** Milliseconds since 1970, about once a second: what shows an age reads it, and is drawn again. */
export const now = signal(Date.now());
setInterval(() => (now.value = Date.now()), 1000);
