// SPDX-License-Identifier: GPL-2.0-or-later
// For a phone on the table: everything that can be stopped, and what is stopped already.
import { useState } from "preact/hooks";
import { Rearm } from "../parts/dock";
import { Qr } from "../parts/qr";
import { Age, Empty, StateBadge } from "../parts/small";
import { latched, type Seen, sorted } from "../state/entities";
import { linkTo } from "../state/route";
import { lastReceipts, stop, summary } from "../state/stops";
import { canMove } from "../words/words";

const MOST = 300;

function Row({ seen: { entity, fresh } }: { readonly seen: Seen }): preact.JSX.Element {
    const last = lastReceipts.value.get(entity.id);
    return (
        <li class={fresh ? "" : "stale"}>
            <span class="who">
                <a href={linkTo("entity", entity.id)}>{entity.name}</a> <StateBadge entity={entity} />
                {entity.holder !== undefined && <span class="quiet"> {entity.holder.name}</span>}
                {last !== undefined && (
                    <span class="quiet">
                        {" "}
                        Last stop from here <Age at={last.at} /> ago: {summary(last.receipt).text}.
                    </span>
                )}
                {entity.latched && <Rearm id={entity.id} />}
            </span>
            <button type="button" class="danger" aria-label={`Stop ${entity.name}`} onClick={() => void stop([entity.id], entity.name)}>
                Stop
            </button>
        </li>
    );
}

export function StopPage(): preact.JSX.Element {
    const [all, setAll] = useState(false);
    const address = `${location.origin}${location.pathname}${linkTo("stop")}`;
    const onlyHere = /^(localhost|127\.|\[::1\])/.test(location.hostname);
    const moving = sorted.value.filter(({ entity }) => canMove(entity));
    const others = sorted.value.filter(({ entity }) => !canMove(entity) && !entity.latched);
    return (
        <>
            <h1>Stop</h1>
            <p class="lead">
                Everybody may stop every robot at any time, also one that somebody else uses. The red button at the foot of this page stops everything. A stopped robot does nothing until somebody rearms it.
            </p>
            <div class="beside">
                <div>
                    <h2>
                        Working now <span class="count">{moving.length}</span>
                    </h2>
                    {moving.length === 0 ? (
                        <Empty>No robot is working.</Empty>
                    ) : (
                        <ul class="rows">
                            {moving.map((seen) => (
                                <Row key={seen.entity.id} seen={seen} />
                            ))}
                        </ul>
                    )}
                    <h2>
                        Stopped <span class="count">{latched.value.length}</span>
                    </h2>
                    {latched.value.length === 0 ? (
                        <Empty>None is stopped.</Empty>
                    ) : (
                        <ul class="rows">
                            {latched.value.map((seen) => (
                                <Row key={seen.entity.id} seen={seen} />
                            ))}
                        </ul>
                    )}
                    {others.length > 0 && (
                        <button type="button" aria-expanded={all} onClick={() => setAll(!all)}>
                            {all ? "Hide the others" : `Show the ${others.length === 1 ? "other one" : `${others.length} others`}`}
                        </button>
                    )}
                    {all && (
                        <ul class="rows">
                            {others.slice(0, MOST).map((seen) => (
                                <Row key={seen.entity.id} seen={seen} />
                            ))}
                        </ul>
                    )}
                </div>
                <aside class="card phone">
                    <h2>This page on a phone</h2>
                    <Qr text={address} label={`QR code of ${address}`} />
                    <p class="address">{address}</p>
                    {onlyHere ? (
                        <p class="quiet">This address is that of your own computer, so a phone cannot reach it. The page docs/how-to/console.md says how others reach the console.</p>
                    ) : (
                        <p class="quiet">Keep the phone unlocked. Its stop goes over the network; it is no emergency stop.</p>
                    )}
                </aside>
            </div>
        </>
    );
}
