// SPDX-License-Identifier: GPL-2.0-or-later
import { memo } from "preact/compat";
import { computed, signal } from "@preact/signals";
import type { Entity } from "@axon/client";
import { LabMap } from "../parts/map";
import { Age, Empty, Select, StateBadge } from "../parts/small";
import { type Seen, sorted, unready } from "../state/entities";
import { holds } from "../state/holds";
import { offered } from "../state/catalogue";
import { BATTERY, useLive } from "../state/live";
import { agoOf, liveOf } from "../state/live_store";
import { linkTo } from "../state/route";
import { silent } from "../state/session";
import { ticked } from "../state/stops";
import { formatCount, formatMs } from "../words/format";
import { canMove, plainKind, plainState } from "../words/words";

type Wanted = "any" | "free" | "mine" | "held" | "working" | "stopped" | "trouble";
const wanted = signal<Wanted>("any");
const category = signal("any");
const type = signal("any");
const service = signal("any");
const words = signal("");
const view = signal<"cards" | "map">("cards");
const most = signal(120);

function fits(entity: Entity, what: Wanted): boolean {
    switch (what) {
        case "free":
            return entity.state === "IDLE";
        case "mine":
            return holds.value.has(entity.id);
        case "held":
            return entity.holder !== undefined;
        case "working":
            return canMove(entity);
        case "stopped":
            return entity.latched;
        case "trouble":
            return entity.state === "ERR" || entity.state === "UNAV" || entity.orphaned;
        default:
            return true;
    }
}
const choicesOf = (all: readonly string[]): readonly string[] => [...new Set(all)].filter((one) => one !== "").sort();
const categories = computed(() => choicesOf(sorted.value.map(({ entity }) => entity.category)));
const types = computed(() => choicesOf(sorted.value.map(({ entity }) => entity.type)));
const services = computed(() => choicesOf([...offered.value.values()].flat()));
const shown = computed(() => {
    const search = words.value.trim().toLowerCase().split(/\s+/);
    return sorted.value.filter(({ entity }) => {
        if (category.value !== "any" && entity.category !== category.value) return false;
        if (type.value !== "any" && entity.type !== type.value) return false;
        if (service.value !== "any" && offered.value.get(entity.id)?.includes(service.value) !== true) return false;
        if (!fits(entity, wanted.value)) return false;
        const text = `${entity.name} ${entity.descr} ${plainKind(entity)} ${entity.state} ${plainState(entity).short} ${entity.holder?.name ?? ""} ${entity.id}`.toLowerCase();
        return search.every((word) => text.includes(word));
    });
});

interface CardProps {
    readonly seen: Seen;
    readonly mine: boolean;
    readonly selected: boolean;
    /** With its units; empty = it sends none. */
    readonly battery: string;
    /** How old that is, in words; empty = it is not old. */
    readonly batteryAgo: string;
}
const Card = memo(({ seen: { entity, fresh, seenAt, heldSince, heldFromBegin }, mine, selected, battery, batteryAgo }: CardProps) => {
    const { long, tone } = plainState(entity);
    const tick = (on: boolean): void => {
        const all = new Set(ticked.value);
        if (on) all.add(entity.id);
        else all.delete(entity.id);
        ticked.value = all;
    };
    return (
        <li class={`card entity ${tone} ${fresh ? "" : "stale"} ${mine ? "mine" : ""}`} data-entity={entity.name}>
            <div class="head">
                <h3>
                    <a href={linkTo("entity", entity.id)}>{entity.name}</a>
                </h3>
                <label class="tick" title="Selects it for the stop button">
                    <input type="checkbox" checked={selected} onChange={(event) => tick(event.currentTarget.checked)} />
                    <span class="unseen">Select {entity.name} for the stop button</span>
                </label>
            </div>
            <p class="quiet kind">{plainKind(entity)}</p>
            <StateBadge entity={entity} />
            <p class="why">{entity.latched ? "Stopped: it does nothing until somebody rearms it." : entity.reason !== "" ? entity.reason : entity.descr !== "" ? entity.descr : long}</p>
            <p class="who">
                {mine ? <strong>Yours</strong> : entity.holder === undefined ? "Nobody has it" : <strong>{entity.holder.name}</strong>}
                {entity.holder !== undefined && (
                    <>
                        {" "}
                        {heldFromBegin ? "for" : "for more than"} <Age at={heldSince} />
                    </>
                )}
                {entity.orphaned && ", connection lost"}
                {entity.waiting > 0 && `, ${formatCount(entity.waiting)} in line`}
            </p>
            <p class="foot quiet">
                {fresh && battery !== "" && (
                    <>
                        <span class={`battery ${batteryAgo === "" ? "" : "old"}`}>
                            battery {battery}
                            {batteryAgo !== "" && ` ${batteryAgo}`}
                        </span>{" "}
                        ·{" "}
                    </>
                )}
                {fresh ? (
                    entity.stopLatencyMs === undefined ? (
                        "stop not measured yet"
                    ) : (
                        <>stops in {formatMs(entity.stopLatencyMs)}</>
                    )
                ) : (
                    <>
                        as it was <Age at={seenAt} /> ago
                    </>
                )}
            </p>
        </li>
    );
});

function Unready(): preact.JSX.Element | null {
    if (unready.value.length === 0) return null;
    return (
        <details class="unready" open={sorted.value.length === 0}>
            <summary>Not ready yet: {unready.value.length}</summary>
            <ul class="rows">
                {unready.value.map((entity) => (
                    <li key={entity.id}>
                        <span>
                            <strong>{entity.name}</strong> <StateBadge entity={entity} /> {entity.reason}
                        </span>
                    </li>
                ))}
            </ul>
        </details>
    );
}

function Cards({ list }: { readonly list: readonly Seen[] }): preact.JSX.Element {
    useLive(
        list.filter(({ fresh }) => fresh || silent.value).map(({ entity }) => entity.id),
        BATTERY,
        1000,
    );
    const at = performance.now();
    return (
        <ul class="cards" aria-label="Entities">
            {list.map((seen) => {
                const { id } = seen.entity;
                const live = liveOf(id);
                const battery = live?.battery ?? "";
                return <Card key={id} seen={seen} mine={holds.value.has(id)} selected={ticked.value.has(id)} battery={battery} batteryAgo={live === undefined || battery === "" ? "" : agoOf(live.batteryAt, at)} />;
            })}
        </ul>
    );
}

export function LaboratoryPage(): preact.JSX.Element {
    const all = sorted.value.length;
    const list = shown.value;
    const filtered = list.length < all;
    const showAll = (): void => {
        words.value = "";
        wanted.value = "any";
        category.value = "any";
        type.value = "any";
        service.value = "any";
    };
    return (
        <>
            <div class="title">
                <h1>
                    Laboratory <span class="count">{filtered ? `${formatCount(list.length)} of ${formatCount(all)}` : formatCount(all)}</span>
                </h1>
                <div class="filters" role="search">
                    <label class="unseen" for="words">
                        Search
                    </label>
                    <input id="words" type="search" placeholder="Search: name, kind, person …" value={words.value} onInput={(event) => (words.value = event.currentTarget.value)} />
                    <Select
                        label="State"
                        hideLabel
                        value={wanted.value}
                        onChange={(value) => (wanted.value = value)}
                        options={[
                            ["any", "any state"],
                            ["free", "free"],
                            ["mine", "mine"],
                            ["held", "in use"],
                            ["working", "working"],
                            ["stopped", "stopped"],
                            ["trouble", "in trouble"],
                        ]}
                    />
                    <Select label="Category" hideLabel value={category.value} onChange={(value) => (category.value = value)} options={[["any", "any category"], ...categories.value.map((one) => [one, one.toLowerCase()] as const)]} />
                    <Select label="Type" hideLabel value={type.value} onChange={(value) => (type.value = value)} options={[["any", "any type"], ...types.value.map((one) => [one, one.toLowerCase()] as const)]} />
                    <Select label="Service" hideLabel value={service.value} onChange={(value) => (service.value = value)} options={[["any", "any service"], ...services.value.map((one) => [one, one] as const)]} />
                    <div class="switch" role="group" aria-label="View">
                        <button type="button" aria-pressed={view.value === "cards"} onClick={() => (view.value = "cards")}>
                            Cards
                        </button>
                        <button type="button" aria-pressed={view.value === "map"} onClick={() => (view.value = "map")}>
                            Map
                        </button>
                    </div>
                </div>
            </div>
            {all === 0 && (
                <Empty>
                    <strong>No robot is connected to the server yet.</strong>
                    <p>
                        A robot appears here at once when its application and its Entity Manager run. To try it, start <code>hello-entity examples/01_hello_entity</code> and <code>axon-entity-manager --application Greeter</code>.
                    </p>
                </Empty>
            )}
            {all > 0 && list.length === 0 && (
                <Empty>
                    None of the {formatCount(all)} robots fits.{" "}
                    <button type="button" onClick={showAll}>
                        Show all
                    </button>
                </Empty>
            )}
            {view.value === "map" && list.length > 0 ? (
                <LabMap seen={list} />
            ) : (
                <Cards list={list.slice(0, most.value)} />
            )}
            {view.value === "cards" && list.length > most.value && (
                <button type="button" onClick={() => (most.value *= 3)}>
                    Show more: {formatCount(list.length - most.value)} are not shown
                </button>
            )}
            <Unready />
        </>
    );
}
