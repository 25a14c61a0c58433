// SPDX-License-Identifier: GPL-2.0-or-later
import type { GlobalService, Proposal, RoleOutlook, Unfit } from "../global_types.js";
import { Refusal, type RefusalCode } from "../refusal.js";
import type { EntityState, Service } from "../types.js";
import { availabilityOf } from "./entities.js";

/** What one step asks of whoever plays its role: a service, to which the step gives these parameters. */
interface Need {
    readonly service: string;
    readonly given: readonly string[];
}
export interface RoleWanted {
    readonly number: number;
    readonly category: string;
    readonly type: string;
    readonly needs: Need[];
}
/** An entity that might play. */
export interface Candidate {
    readonly entity: string;
    readonly name: string;
    readonly category: string;
    readonly type: string;
    readonly state: EntityState;
    readonly latched: boolean;
    readonly holder: string;
    readonly heldHere: boolean;
    readonly services: readonly Service[];
    /** Why its services are not known; empty = they are. */
    readonly silent: string;
}

export function rolesOf(service: GlobalService): RoleWanted[] {
    const roles = new Map<number, RoleWanted>();
    for (const step of [...service.steps, ...service.compensation]) {
        const role = roles.get(step.role) ?? { number: step.role, category: step.category, type: step.type, needs: [] };
        role.needs.push({ service: step.serviceGlobalId, given: [...step.parameters.map(({ name }) => name), ...step.sources.map(({ parameter }) => parameter)] });
        roles.set(step.role, role);
    }
    return [...roles.values()].sort((a, b) => a.number - b.number);
}

const kindOf = (category: string, type: string): string => (category === "" && type === "" ? "any entity" : [category, type].filter((word) => word !== "").join("/"));
const listed = (parts: readonly string[], last: string): string => (parts.length < 2 ? parts.join("") : parts.slice(0, -1).join(", ") + last + (parts.at(-1) ?? ""));
const offerOf = (candidate: Candidate, service: string): Service | undefined =>
    candidate.services.find(({ globalId }) => globalId === service) ?? candidate.services.find(({ name }) => name === service);

/** Why it cannot play the role: the weightiest reason first. */
function unfitness(role: RoleWanted, candidate: Candidate): Unfit | undefined {
    const lacks: { distance: number; code: RefusalCode; what: string }[] = [];
    const add = (distance: number, code: RefusalCode, what: string): void => {
        if (!lacks.some((lack) => lack.what === what)) lacks.push({ distance, code, what });
    };
    if ((role.category !== "" && role.category !== candidate.category) || (role.type !== "" && role.type !== candidate.type)) {
        add(8, "WRONG_TYPE", `is ${kindOf(candidate.category, candidate.type)}`);
    }
    if (candidate.silent !== "") add(4, "UNAVAILABLE", `does not tell its services (${candidate.silent})`);
    for (const need of candidate.silent === "" ? role.needs : []) {
        const offer = offerOf(candidate, need.service);
        if (offer === undefined) {
            add(7, "UNKNOWN_SERVICE", `does not offer ${need.service}`);
            continue;
        }
        if (!offer.active) add(6, "INACTIVE_SERVICE", `has ${need.service} inactive`);
        const missing = offer.missing.filter((name) => !need.given.includes(name));
        if (missing.length > 0) add(5, "MISSING_DEPENDENCY", `lacks ${listed(missing, " and ")} of ${need.service}`);
    }
    const availability = availabilityOf(candidate.state);
    if (availability === "working" && candidate.heldHere) add(2, "BLOCKED", `is ${candidate.state}`);
    if (availability === "away") add(4, "UNAVAILABLE", `is ${candidate.state}`);
    if (!candidate.heldHere && candidate.holder !== "") add(3, "ALREADY_HELD", `is held by ${candidate.holder}`);
    if (candidate.latched) add(1, "LATCHED", "was stopped and is not rearmed");
    lacks.sort((a, b) => b.distance - a.distance);
    const first = lacks[0];
    if (first === undefined) return undefined;
    const why = new Refusal(first.code, listed(lacks.map(({ what }) => what), ", and "), candidate.heldHere ? "" : candidate.holder);
    return { entity: candidate.entity, name: candidate.name, why, distance: first.distance };
}

type Outlook = { -readonly [Key in keyof RoleOutlook]: RoleOutlook[Key] };

/** Why nobody plays the role, as a line of its own. */
function explained(outlook: Outlook, choice: string | undefined, chosenName: string, unoffered: readonly string[]): string {
    const begin = `role ${outlook.role} (${outlook.kind}): `;
    if (choice !== undefined) {
        const unfit = outlook.unfit.find(({ entity }) => entity === choice);
        if (unfit !== undefined) return `${begin}${unfit.name} ${unfit.why.message}`;
        return begin + (chosenName === "" ? "the entity chosen for it is not there" : `${chosenName} was chosen for another role as well`);
    }
    if (outlook.able.length > 0) {
        return `${begin}${listed(outlook.able, " and ")} ${outlook.able.length === 1 ? "plays" : "play"} other roles that nobody else can; one more such entity is missing`;
    }
    if (outlook.unfit.length === 0) return `${begin}there is no entity at all`;
    // What is of another kind is worth a word only where nothing is nearer.
    const near = outlook.unfit.filter(({ distance }) => distance !== 8);
    const named = (near.length > 0 ? near : outlook.unfit.slice(0, 1)).slice(0, 3);
    const more = near.length > named.length ? `; and ${near.length - named.length} more` : "";
    return `${begin}${unoffered.length > 0 ? `nobody offers ${listed(unoffered, " and ")}; ` : ""}${named.map(({ name, why }) => `${name} ${why.message}`).join("; ")}${more}`;
}

/**
 * Gives each role an entity of its own: as many roles as possible are played (a maximum matching), by entities that are held
 * already where that can be, then by the first in order of name and UUID. `chosen` (role -> UUID) is kept to, and checked like
 * everything else. The same input gives the same proposal.
 */
export function propose(roles: readonly RoleWanted[], unsorted: readonly Candidate[], chosen: ReadonlyMap<number, string>): Proposal {
    const order = (a: string, b: string): number => (a < b ? -1 : a > b ? 1 : 0);
    const candidates = [...unsorted].sort((a, b) => Number(b.heldHere) - Number(a.heldHere) || order(a.name, b.name) || order(a.entity, b.entity));
    const offered = (service: string): boolean => candidates.some((one) => offerOf(one, service) !== undefined);
    const nobodyOffers = [...new Set(roles.flatMap(({ needs }) => needs.map(({ service }) => service)).filter((service) => !offered(service)))].sort();

    const fits: boolean[][] = [];
    const outlooks = roles.map((role): Outlook => {
        const services = [...new Set(role.needs.map(({ service }) => service))];
        const kind = kindOf(role.category, role.type);
        const unfits = candidates.map((candidate) => unfitness(role, candidate));
        // A choice is not to be had for another role, not even where its own role cannot be played by it.
        fits.push(
            candidates.map(({ entity }, c) => {
                const choice = chosen.get(role.number);
                return unfits[c] === undefined && (choice === undefined ? ![...chosen.values()].includes(entity) : choice === entity);
            }),
        );
        return {
            role: role.number,
            kind,
            wanted: services.length === 0 ? kind : `${kind} with ${services.join(", ")}`,
            able: candidates.filter((_, c) => unfits[c] === undefined).map(({ name }) => name),
            unfit: unfits.filter((one) => one !== undefined).sort((a, b) => a.distance - b.distance),
            entity: "",
            name: "",
        };
    });

    // Augmenting paths from the candidates' side: who has a role once keeps one, so the first in order are used before the others.
    const player: (number | undefined)[] = roles.map(() => undefined);
    const seat = (candidate: number, tried: Set<number>): boolean => {
        for (const free of [true, false]) {
            for (let r = 0; r < roles.length; ++r) {
                if (tried.has(r) || fits[r]?.[candidate] !== true || (player[r] === undefined) !== free) continue;
                tried.add(r);
                const present = player[r];
                if (present === undefined || seat(present, tried)) {
                    player[r] = candidate;
                    return true;
                }
            }
        }
        return false;
    };
    candidates.forEach((_, c) => seat(c, new Set()));

    let code: RefusalCode | undefined;
    let holder = "";
    const lines: string[] = [];
    outlooks.forEach((outlook, r) => {
        const one = candidates[player[r] ?? -1];
        if (one !== undefined) {
            outlook.entity = one.entity;
            outlook.name = one.name;
            return;
        }
        const choice = chosen.get(outlook.role);
        const unoffered = [...new Set((roles[r]?.needs ?? []).map(({ service }) => service))].filter((service) => nobodyOffers.includes(service)).sort();
        if (code === undefined) {
            const about = outlook.unfit.find(({ entity }) => choice === undefined || entity === choice);
            const tells = about !== undefined && (outlook.able.length === 0 || choice !== undefined);
            code = unoffered.length > 0 && choice === undefined ? "UNKNOWN_SERVICE" : tells ? about.why.code : "UNAVAILABLE";
            holder = tells ? about.why.holder : "";
        }
        lines.push(explained(outlook, choice, candidates.find(({ entity }) => entity === choice)?.name ?? "", unoffered));
    });
    return { roles: outlooks, nobodyOffers, why: code === undefined ? undefined : new Refusal(code, lines.join("\n"), holder) };
}
