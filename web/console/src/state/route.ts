// SPDX-License-Identifier: GPL-2.0-or-later
// Which page is shown is behind the "#" of the address; the server knows one page only.
import { computed, signal } from "@preact/signals";

export type Page = "laboratory" | "entity" | "collaboration" | "activity" | "stop";
export interface Route {
    readonly page: Page;
    /** Of an entity: its UUID. */
    readonly subject: string;
}

function read(): Route {
    const [page = "", subject = ""] = location.hash.replace(/^#\/?/, "").split("/");
    let decoded = "";
    try {
        decoded = decodeURIComponent(subject).slice(0, 200);
    } catch {
        // no address of ours
    }
    switch (page) {
        case "entity":
            return decoded === "" ? { page: "laboratory", subject: "" } : { page, subject: decoded };
        case "collaboration":
        case "activity":
        case "stop":
            return { page, subject: decoded };
        default:
            return { page: "laboratory", subject: "" };
    }
}
export const route = signal(read());
export const page = computed(() => route.value.page);
addEventListener("hashchange", () => (route.value = read()));

export const linkTo = (to: Page, subject = ""): string => `#/${to}${subject === "" ? "" : `/${encodeURIComponent(subject)}`}`;
