// SPDX-License-Identifier: GPL-2.0-or-later
// The stop: at the foot of every page, always in sight. What it stops stands on it.
import type { Receipt } from "@axon/client";
import { useEffect, useRef } from "preact/hooks";
import { entities } from "../state/entities";
import { holds, rearm } from "../state/holds";
import { client } from "../state/session";
import { chosen, describe, type Order, order, press, type Scope, scope, summary, these } from "../state/stops";
import { formatClock, formatMs } from "../words/format";
import { marks } from "../words/words";
import { ServerButton } from "./server_button";

function Stage({ name, at }: { readonly name: string; readonly at: number | undefined }): preact.JSX.Element {
    return (
        <li class={at === undefined ? "open" : "done"}>
            {name} <b>{at === undefined ? "…" : formatMs(at)}</b>
        </li>
    );
}

export function Rearm({ id }: { readonly id: string }): preact.JSX.Element | null {
    const its = client.value;
    const entity = entities.value.get(id)?.entity;
    if (its === undefined || entity === undefined || !entity.latched) return null;
    if (!holds.value.has(id) && its.self.role !== "admin") {
        return <span class="quiet">{entity.holder === undefined ? "Whoever checks it out next, or an administrator, can rearm it." : `${entity.holder.name} or an administrator can rearm it.`}</span>;
    }
    return (
        <ServerButton onClick={() => void rearm(its, entity)}>
            Rearm {entity.name}
        </ServerButton>
    );
}

function Line({ receipt }: { readonly receipt: Receipt }): preact.JSX.Element {
    const { tone, text } = summary(receipt);
    return (
        <li class={`receipt ${tone}`}>
            <span>
                <span aria-hidden="true">{marks[tone === "wait" ? "wait" : tone]}</span> <strong>{receipt.name}</strong> {text}
            </span>
            <ol class="stages" aria-label="Stages of the receipt">
                <Stage name="server" at={receipt.serverMs} />
                <Stage name="manager" at={receipt.managerMs} />
                {!receipt.noApplication && <Stage name="robot told" at={receipt.callbackReturnedMs} />}
                {receipt.standstillFollows || receipt.standstillMs !== undefined ? <Stage name="standstill" at={receipt.standstillMs} /> : null}
            </ol>
            <Rearm id={receipt.entity} />
        </li>
    );
}

/** A press counts when it begins. Keys and screen readers click without one; a click soon after the end of a press belongs to it. */
const CLICK_MS = 1000;
let pressedAt = -Infinity;
let releasedAt = -Infinity;
function StopButton({ which }: { readonly which: Scope }): preact.JSX.Element {
    const begin = (event: Event): void => {
        pressedAt = performance.now();
        press(which, event.timeStamp);
    };
    const release = (): void => {
        if (pressedAt > releasedAt) releasedAt = performance.now();
    };
    return (
        <button type="button" class="stop" onPointerDown={(event) => event.button === 0 && begin(event)} onPointerUp={release} onClick={(event) => performance.now() - Math.max(pressedAt, releasedAt) > CLICK_MS && begin(event)}>
            <b>STOP</b> <span>{describe(which)}</span>
        </button>
    );
}

/** Those that are not confirmed come first. */
const rank = (receipt: Receipt): number => ({ bad: 0, wait: 1, good: 2 })[summary(receipt).tone];
const MOST = 60;

function Receipts({ its }: { readonly its: Order }): preact.JSX.Element {
    const confirmed = its.receipts.filter((one) => one.confirmed).length;
    const all = its.receipts.length;
    const shown = [...its.receipts].sort((a, b) => rank(a) - rank(b)).slice(0, MOST);
    return (
        <section class="receipts" aria-label="Receipt of the stop">
            <div class="head">
                <h2>
                    Stop of {its.what} <span class="quiet">at {formatClock(its.at)}</span>
                </h2>
                <button type="button" class="plain" aria-label="Close the receipt" onClick={() => (order.value = undefined)}>
                    ✕
                </button>
            </div>
            <p role="status" class={its.trouble !== "" || (its.done && confirmed < all) ? "bad" : ""}>
                {its.trouble !== "" ? `${its.trouble} ` : ""}
                {all > 0 && (confirmed === all ? `Confirmed by ${all === 1 ? "it" : `all ${all}`}.` : `Confirmed by ${confirmed} of ${all}${its.done ? ". Go and look at the others" : " so far"}.`)}
                {all === 0 && its.trouble === "" && (its.done ? "There was nothing to stop." : "On its way …")}
            </p>
            <ul>
                {shown.map((receipt) => (
                    <Line key={receipt.entity} receipt={receipt} />
                ))}
            </ul>
            {all > MOST && <p class="quiet">And {all - MOST} more, all further than these.</p>}
        </section>
    );
}

export function Dock(): preact.JSX.Element {
    const place = useRef<HTMLDivElement>(null);
    const is = scope.value;
    const choices: Scope[] = [];
    if (these.value.length > 0) choices.push("these");
    if (holds.value.size > 0 && !(these.value.length === 1 && holds.value.size === 1 && holds.value.has(these.value[0] ?? ""))) choices.push("held");
    choices.push("all");
    const its = order.value;
    // What is at the end of a page must not lie behind the dock.
    useEffect(() => {
        const dock = place.current;
        if (dock === null) return undefined;
        const observer = new ResizeObserver(() => document.documentElement.style.setProperty("--dock", `${dock.offsetHeight}px`));
        observer.observe(dock);
        return () => observer.disconnect();
    }, []);
    return (
        <div class="dock" ref={place} role="region" aria-label="Stop">
            {its !== undefined && <Receipts its={its} />}
            <div class="controls">
                {choices.length > 1 && (
                    <div class="scopes" role="group" aria-label="What the stop button stops">
                        {choices.map((one) => (
                            <button key={one} type="button" aria-pressed={one === is} onClick={() => (chosen.value = one)}>
                                {one === "all" ? "Everything" : describe(one, true)}
                            </button>
                        ))}
                    </div>
                )}
                <span class="hint quiet">
                    <kbd>Esc</kbd> <kbd>Esc</kbd> does the same. This is no emergency stop.
                </span>
                <StopButton which={is} />
            </div>
        </div>
    );
}
