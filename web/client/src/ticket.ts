// SPDX-License-Identifier: GPL-2.0-or-later
import { Refusal, type RefusalCode, refusalCodes } from "./refusal.js";
import type { Credentials } from "./session.js";

const WAIT_MS = 5000;

/**
 * For Options.credentials in a page that a server of the web console has served, and whose user has logged in there: asks for a
 * ticket, with which one session can be opened, and for the address of the sessions. PERMISSION_DENIED: nobody is logged in.
 */
export function ticketFrom(url: string | URL): () => Promise<Credentials> {
    return async () => {
        let answer: Response;
        let body: unknown;
        try {
            answer = await fetch(url, { method: "POST", credentials: "same-origin", signal: AbortSignal.timeout(WAIT_MS) });
            body = await answer.json();
        } catch {
            throw new Refusal("NOT_CONNECTED", "the server gives no ticket; is it running?");
        }
        const text = (key: string): string => {
            const value = typeof body === "object" && body !== null ? (body as Record<string, unknown>)[key] : undefined;
            return typeof value === "string" ? value : "";
        };
        if (!answer.ok) {
            const code = refusalCodes().find((one) => one.code === text("code"))?.code ?? (answer.status === 401 ? "PERMISSION_DENIED" : "NOT_CONNECTED");
            throw new Refusal(code as RefusalCode, text("message") || `the server answers ${answer.status} instead of a ticket`);
        }
        return { user: text("user"), password: text("password"), ...(text("endpoint") === "" ? {} : { server: text("endpoint") }) };
    };
}
