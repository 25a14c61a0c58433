// SPDX-License-Identifier: GPL-2.0-or-later
import { Refusal } from "../refusal.js";
import { inQuotes } from "../wire/values.js";

export type Scheme = "tcp" | "ws" | "wss";
export interface Endpoint {
    readonly scheme: Scheme;
    readonly host: string;
    readonly port: number;
    /** Of ws and wss: the path. */
    readonly resource: string;
}
/** A server, or a Glacier2 router. */
export interface Target {
    readonly endpoint: Endpoint;
    /** "Axon.Clients/router"; undefined = a server. */
    readonly router: string | undefined;
}

const EXPECTED = "expected ws://HOST:PORT/PATH, wss://HOST:PORT/PATH, or in Node HOST:PORT, or one of these in Ice's form: ws -h HOST -p PORT -r /PATH";

function checked(text: string, scheme: string, host: string, port: string, resource: string): Endpoint {
    const number = /^\d{1,5}$/.test(port) ? Number(port) : Number.NaN;
    // Host and path become part of an endpoint's text: nothing that Ice would read as an option may be in them.
    const plain = /^[A-Za-z0-9_][A-Za-z0-9._-]*$/.test(host) && /^(\/[A-Za-z0-9._~/%-]*)?$/.test(resource);
    if (!plain || !(number <= 65_535)) throw new Refusal("MALFORMED", `${inQuotes(text, 128)}: ${EXPECTED}`);
    if (scheme === "ssl") throw new Refusal("NOT_SUPPORTED", "JavaScript cannot speak TLS over TCP to a server of Ice; use wss://HOST:PORT/PATH.");
    return { scheme: scheme as Scheme, host, port: number, resource };
}

export function parseEndpoint(text: string): Endpoint {
    const ice = /^\s*(tcp|ws|wss|ssl)\s+-h\s+(\S+)\s+-p\s+(\d+)(?:\s+-r\s+(\S+))?\s*$/.exec(text);
    if (ice !== null) return checked(text, ice[1] ?? "", ice[2] ?? "", ice[3] ?? "", ice[4] ?? "");
    const url = /^(?:(tcp|ws|wss|ssl):\/\/)?([^:/?#]+)(?::(\d+))?(\/[^?#]*)?$/.exec(text);
    if (url === null) throw new Refusal("MALFORMED", `${inQuotes(text, 128)}: ${EXPECTED}`);
    const scheme = url[1] ?? "tcp";
    const usual = scheme === "ws" ? "80" : scheme === "wss" ? "443" : "";
    const resource = url[4] ?? "";
    if (scheme === "tcp" && resource !== "") throw new Refusal("MALFORMED", `${inQuotes(text, 128)}: ${EXPECTED}`);
    return checked(text, scheme, url[2] ?? "", url[3] ?? usual, resource);
}
/** Endpoints with ":" between them, in Ice's form; those that cannot be used here are left out. */
export function parseEndpoints(text: string): Endpoint[] {
    return text
        .split(/:(?=\s*(?:tcp|ssl|ws|wss|udp)\s)/)
        .map((one) => {
            try {
                return parseEndpoint(one);
            } catch {
                return undefined;
            }
        })
        .filter((one) => one !== undefined);
}
export function parseTarget(text: string): Target {
    const router = /^\s*([A-Za-z0-9._-]+\/[A-Za-z0-9._-]+)\s*:\s*((?:tcp|ws|wss|ssl)\s.*)$/.exec(text);
    if (router === null) return { endpoint: parseEndpoint(text), router: undefined };
    const usable = parseEndpoints(router[2] ?? "").filter(isUsable);
    if (usable[0] === undefined) throw new Refusal("NOT_SUPPORTED", `${inQuotes(text, 128)} has no endpoint that this program can reach; a browser needs ws or wss.`);
    return { endpoint: usable[0], router: router[1] };
}

export function endpointText({ scheme, host, port, resource }: Endpoint): string {
    return `${scheme} -h ${host} -p ${port}${scheme === "tcp" ? "" : ` -r ${resource === "" ? "/" : resource}`}`;
}
export function endpointAddress({ scheme, host, port, resource }: Endpoint): string {
    return scheme === "tcp" ? `${host}:${port}` : `${scheme}://${host}:${port}${resource}`;
}

/** Whether this program can connect to it: browsers have no TCP, and Node 18 and 20 have no WebSocket of their own. */
export function isUsable({ scheme }: Endpoint): boolean {
    const inNode = typeof process !== "undefined" && process.versions?.node !== undefined;
    return scheme === "tcp" ? inNode : typeof WebSocket !== "undefined";
}
declare const process: { readonly versions?: { readonly node?: string } } | undefined;
