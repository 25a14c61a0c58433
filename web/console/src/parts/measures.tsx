// SPDX-License-Identifier: GPL-2.0-or-later
// How fast this laboratory answers, and how near its watchdogs are to stopping a robot.
import type { WatchdogMargin } from "@axon/client";
import { useState } from "preact/hooks";
import { now } from "../state/clock";
import { sorted } from "../state/entities";
import { latencies, type Margins, margins, useMeasures } from "../state/measures";
import { linkTo } from "../state/route";
import { client } from "../state/session";
import { formatMs, formatSpan } from "../words/format";
import { marks, sentence, type Tone } from "../words/words";
import { Histogram } from "./histogram";
import { Empty } from "./small";

const MOST = 12;
const OLD_MS = 15_000;
const share = ({ longestGapMs, timeoutMs }: WatchdogMargin): number => (timeoutMs > 0 ? longestGapMs / timeoutMs : 0);
const worst = (its: Margins | undefined): number => (its === undefined ? -1 : its.trouble !== "" ? 2 : Math.max(...its.watchdogs.map(share), 0));
const toneOf = (part: number): Tone => (part < 0.5 ? "good" : part < 0.8 ? "wait" : "bad");

function Margin({ its }: { readonly its: WatchdogMargin }): preact.JSX.Element {
    const part = share(its);
    const tone = toneOf(part);
    return (
        <li>
            <span class="hop">{sentence(its.hop).replace(/\.$/, "")}</span>
            <span class="track" aria-hidden="true">
                <span class={`bar ${tone}`} style={{ left: "0", width: `${Math.min(Math.max(part, 0.01), 1) * 100}%` }} />
            </span>
            <span class="figures">
                <span aria-hidden="true">{marks[tone]}</span> {formatMs(its.longestGapMs)} of {formatMs(its.timeoutMs)}
            </span>
        </li>
    );
}

function Watchdogs(): preact.JSX.Element {
    const [all, setAll] = useState(false);
    const rows = sorted.value.map(({ entity }) => ({ entity, its: margins.value.get(entity.id) })).sort((a, b) => worst(b.its) - worst(a.its));
    const shown = all ? rows : rows.slice(0, MOST);
    const silent = now.value - (client.value?.connection().heardAt ?? now.value);
    return (
        <>
            <p class="quiet">The longest silence of the last minute, against the time after which the watchdog stops the robot. The nearest come first.</p>
            <p class="quiet">This page last heard the server {silent < 1000 ? "less than a second" : formatSpan(silent)} ago.</p>
            {rows.length === 0 && <Empty>No robot is connected.</Empty>}
            <ul class="margins">
                {shown.map(({ entity, its }) => (
                    <li key={entity.id} data-margins={entity.name}>
                        <a href={linkTo("entity", entity.id)}>{entity.name}</a>
                        {its === undefined && <span class="quiet"> asking …</span>}
                        {its !== undefined && its.trouble !== "" && <span class="bad"> {sentence(its.trouble)}</span>}
                        {its !== undefined && now.value - its.at > OLD_MS && <span class="quiet"> {formatSpan(now.value - its.at)} ago</span>}
                        {its !== undefined && its.trouble === "" && its.watchdogs.length === 0 && <span class="quiet"> no watchdog runs now</span>}
                        <ul>{its?.watchdogs.map((one) => <Margin key={one.hop} its={one} />)}</ul>
                    </li>
                ))}
            </ul>
            {rows.length > MOST && (
                <button type="button" aria-expanded={all} onClick={() => setAll(!all)}>
                    {all ? "Show the nearest only" : `Show all ${rows.length}`}
                </button>
            )}
        </>
    );
}

export function Measures(): preact.JSX.Element {
    useMeasures();
    const { manager, robot, told, confirmed } = latencies.value;
    const wide = matchMedia("(min-width: 1000px)").matches;
    return (
        <div class="measures">
            <details class="card" open={wide}>
                <summary>How fast it is, from here</summary>
                <Histogram title="To a robot and back" about="From this page to the robot's program and back, on the way of a stop. Nothing is stopped." values={robot} empty="Not measured yet." />
                <Histogram title="To an Entity Manager and back" about="The part of it without the robot's program." values={manager} empty="Not measured yet." />
                <Histogram title="Stops, confirmed" about="From the press until the robot's program has carried out the stop." values={confirmed} empty="No robot has been stopped from this page." />
                <Histogram title="Stops, heard by the server" about="From the press until the server's answer is here." values={told} empty="No robot has been stopped from this page." />
            </details>
            <details class="card" open={wide}>
                <summary>Watchdogs</summary>
                <Watchdogs />
            </details>
        </div>
    );
}
