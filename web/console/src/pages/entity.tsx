// SPDX-License-Identifier: GPL-2.0-or-later
import type { Details, DrillReport, Entity, Service } from "@axon/client";
import { useEffect, useState } from "preact/hooks";
import { Rearm } from "../parts/dock";
import { Jobs } from "../parts/jobs";
import { ServiceForm } from "../parts/service_form";
import { ServerButton } from "../parts/server_button";
import { Age, Empty, StateBadge } from "../parts/small";
import { loadPlots } from "../parts/plot";
import { Streams } from "../parts/streams";
import { entities, type Seen } from "../state/entities";
import { checkOut, type Hold, holds, lastHolds, type Pending, pending } from "../state/holds";
import { journal, refused } from "../state/journal";
import { linkTo } from "../state/route";
import { client } from "../state/session";
import { formatClock, formatMs } from "../words/format";
import { canMove, plainKind, plainState, sentence } from "../words/words";
import { Entries } from "./activity";

function Held({ hold }: { readonly hold: Hold }): preact.JSX.Element {
    const { entity } = hold;
    const seen = entities.value.get(hold.id);
    return (
        <div class="hold mine">
            <p>
                <strong>{hold.orphaned.value ? "The connection to it is lost." : `${entity.name} is yours`}</strong> {seen !== undefined && !hold.orphaned.value && <>for <Age at={seen.heldSince} /></>}
                {hold.orphaned.value && " It stands still, and stays yours for a few seconds."}
            </p>
            <p class="quiet">If this tab closes or loses the server, the robot is stopped at once, unless its task is allowed to go on without you. It stays yours for a few seconds, so that the page can be loaded again; then it is free. While it moves, keep this tab in sight: two seconds out of sight stop it.</p>
            <div class="row">
                <ServerButton onClick={() => void hold.release()}>
                    Release it
                </ServerButton>
                {(hold.busy || (seen !== undefined && canMove(seen.entity))) && (
                    <>
                        <ServerButton title="Stops what runs and goes on with the next task that waits" onClick={() => void hold.checkOut.reset().catch((error: unknown) => refused("The task was not ended", error, entity))}>
                            End the current task
                        </ServerButton>
                        <ServerButton title="Stops what runs and forgets the tasks that wait" onClick={() => void hold.checkOut.clear().catch((error: unknown) => refused("The queue was not emptied", error, entity))}>
                            End all tasks
                        </ServerButton>
                    </>
                )}
            </div>
        </div>
    );
}
function Waits({ entity, wait }: { readonly entity: Entity; readonly wait: Pending }): preact.JSX.Element {
    const holder = entity.holder?.name ?? "its holder";
    return (
        <div class="hold" role="status">
            <p>
                <strong>{wait.how === "take" ? "Checking out …" : wait.asking ? `Asking ${holder} …` : wait.place > 0 ? `You are number ${wait.place} in line.` : "Waiting …"}</strong>
            </p>
            {wait.message !== "" && <p class="quiet">{sentence(wait.message)}</p>}
            <button type="button" onClick={() => wait.abort.abort()}>
                Give up waiting
            </button>
        </div>
    );
}
function Free({ entity }: { readonly entity: Entity }): preact.JSX.Element {
    const [reason, setReason] = useState("");
    const [asking, setAsking] = useState(false);
    const its = client.value;
    if (its === undefined) return <></>;
    if (its.self.role === "observer") return <p class="quiet">You may look at it and stop it. To use it, log in as an operator.</p>;
    if (entity.holder === undefined) {
        const away = entity.state !== "IDLE";
        return (
            <div class="hold">
                <p>Nobody has it. Check it out, and it obeys only you until you release it.</p>
                <ServerButton class="primary big" disabled={away} onClick={() => void checkOut(its, entity, "take")}>
                    Check out {entity.name}
                </ServerButton>
                {away && <p class="quiet">Not possible now: it is {plainState(entity).short}.</p>}
            </div>
        );
    }
    return (
        <div class="hold">
            <p>
                <strong>{entity.holder.name}</strong> has it{entity.waiting > 0 && `, and ${entity.waiting} in line`}.
            </p>
            <div class="row">
                <ServerButton class="primary" onClick={() => void checkOut(its, entity, "wait")}>
                    Wait in line
                </ServerButton>
                <button type="button" aria-expanded={asking} onClick={() => setAsking(!asking)}>
                    Ask {entity.holder.name} for it …
                </button>
            </div>
            {asking && (
                <form
                    class="stack"
                    onSubmit={(event) => {
                        event.preventDefault();
                        setAsking(false);
                        void checkOut(its, entity, "ask", reason);
                    }}
                >
                    <label for="reason">Why you need it</label>
                    <input id="reason" value={reason} maxLength={200} onInput={(event) => setReason(event.currentTarget.value)} placeholder="shown to the holder" />
                    <div class="row">
                        <ServerButton type="submit" class="primary">
                            Ask
                        </ServerButton>
                        {its.self.role === "admin" && (
                            <ServerButton class="danger" title="It is stopped first, and its holder is told" onClick={() => void checkOut(its, entity, "force", reason)}>
                                Take it by force
                            </ServerButton>
                        )}
                    </div>
                </form>
            )}
        </div>
    );
}

function Ownership({ entity }: { readonly entity: Entity }): preact.JSX.Element {
    const hold = holds.value.get(entity.id);
    const wait = pending.value.get(entity.id);
    return (
        <section class="card" aria-label="Who has it">
            <h2>Who has it</h2>
            {hold !== undefined ? <Held hold={hold} /> : wait !== undefined ? <Waits entity={entity} wait={wait} /> : <Free entity={entity} />}
        </section>
    );
}

function Messages({ hold }: { readonly hold: Hold }): preact.JSX.Element {
    const [text, setText] = useState("");
    return (
        <details class="card messages">
            <summary>
                Messages {hold.texts.value.length > 0 && <span class="count">{hold.texts.value.length}</span>}
            </summary>
            <ul>
                {hold.texts.value.map((one, at) => (
                    <li key={at} class={one.mine ? "sent" : ""}>
                        <span class="quiet">
                            {formatClock(one.at)} {one.mine ? "you" : hold.entity.name}
                        </span>{" "}
                        {one.text}
                    </li>
                ))}
            </ul>
            <form
                class="row"
                onSubmit={(event) => {
                    event.preventDefault();
                    if (text.trim() === "") return;
                    hold.sendText(text);
                    setText("");
                }}
            >
                <label class="unseen" for="message">
                    Message to the robot application
                </label>
                <input id="message" value={text} maxLength={4000} onInput={(event) => setText(event.currentTarget.value)} placeholder="a text for the robot application" />
                <ServerButton type="submit">Send</ServerButton>
            </form>
        </details>
    );
}

function Technical({ entity, details }: { readonly entity: Entity; readonly details: Details | undefined }): preact.JSX.Element {
    const [drill, setDrill] = useState<DrillReport | "running">();
    const measure = async (): Promise<void> => {
        setDrill("running");
        try {
            setDrill((await client.value?.drill([entity.id], 10, 60))?.[0]);
        } catch (error) {
            setDrill(undefined);
            refused("The stop was not measured", error, entity);
        }
    };
    const times = drill === undefined || drill === "running" ? [] : (drill.callbackMs.some((one) => one !== undefined) ? drill.callbackMs : drill.managerMs).filter((one) => one !== undefined).sort((a, b) => a - b);
    return (
        <details class="card technical">
            <summary>Technical facts</summary>
            <dl>
                <dt>State</dt>
                <dd>
                    {entity.state}, stop generation {entity.stopGeneration}
                </dd>
                <dt>UUID</dt>
                <dd>
                    <code>{entity.id}</code>
                </dd>
                <dt>Position</dt>
                <dd>
                    x {entity.xMm} mm, y {entity.yMm} mm, z {entity.zMm} mm
                </dd>
                <dt>A stop takes</dt>
                <dd>
                    {entity.stopLatencyMs === undefined ? "not measured by the server yet" : `${formatMs(entity.stopLatencyMs)} from the server, as last measured`}
                    <br />
                    <ServerButton disabled={drill === "running"} onClick={() => void measure()}>
                        Measure from here, without stopping it
                    </ServerButton>
                    {times.length > 0 && (
                        <>
                            {" "}
                            {formatMs(times[Math.floor(times.length / 2)] ?? 0)} in the middle, {formatMs(times.at(-1) ?? 0)} at most, of {times.length} tries
                        </>
                    )}
                    {drill !== undefined && drill !== "running" && times.length === 0 && " no answer"}
                </dd>
                {details?.watchdogs.map(({ hop, timeoutMs, longestGapMs }) => (
                    <>
                        <dt key={hop}>Watchdog {hop}</dt>
                        <dd>
                            longest silence in the last minute {formatMs(longestGapMs)} of {formatMs(timeoutMs)}
                        </dd>
                    </>
                ))}
            </dl>
        </details>
    );
}

function useDetails(seen: Seen | undefined): { readonly details: Details | undefined; readonly trouble: string } {
    const [details, setDetails] = useState<Details>();
    const [trouble, setTrouble] = useState("");
    const its = client.value;
    const { entity, fresh = false } = seen ?? {};
    const id = entity?.id;
    // What services there are may have changed when the entity has.
    const occasion = `${entity?.state} ${entity?.latched} ${entity?.holder?.id}`;
    useEffect(() => {
        if (its === undefined || id === undefined || !fresh) return undefined;
        let wanted = true;
        const timer = setTimeout(() => {
            its.details(id).then(
                (found) => {
                    if (!wanted) return;
                    setDetails(found);
                    setTrouble("");
                },
                (error: unknown) => wanted && setTrouble(error instanceof Error ? error.message : String(error)),
            );
        }, details === undefined ? 0 : 150);
        return () => {
            wanted = false;
            clearTimeout(timer);
        };
    }, [its, id, occasion, fresh]);
    return { details, trouble };
}

export function EntityPage({ id }: { readonly id: string }): preact.JSX.Element {
    const seen = entities.value.get(id);
    const hold = holds.value.get(id);
    const past = lastHolds.value.get(id);
    const { details, trouble } = useDetails(seen);
    // Not when the first sample arrives: that is when a task has just begun, and the heartbeats of this page are fast.
    useEffect(loadPlots, []);
    const [service, setService] = useState("");
    const entity = seen?.entity;
    if (seen === undefined || entity === undefined) {
        return (
            <>
                <h1>{past?.entity.name ?? "This robot"} is not connected</h1>
                <p>It is switched off, or its programs do not run, or it has another address now. This page shows it again as soon as it is back.</p>
                <p>
                    <a href={linkTo("laboratory")}>All robots of the laboratory</a>
                </p>
                {past !== undefined && past.jobs.value.length > 0 && (
                    <section class="card">
                        <h2>Its tasks</h2>
                        <Jobs hold={past} />
                    </section>
                )}
            </>
        );
    }
    const services: readonly Service[] = hold !== undefined && hold.services.value.length > 0 ? hold.services.value : (details?.services ?? []);
    const open = services.find(({ name }) => name === service) ?? services[0];
    const { long } = plainState(entity);
    const own = journal.value.filter((entry) => entry.entity === id);
    return (
        <>
            <div class={`title ${seen.fresh ? "" : "stale"}`}>
                <div>
                    <p class="quiet">
                        <a href={linkTo("laboratory")}>Laboratory</a> › {plainKind(entity)}
                    </p>
                    <h1>{entity.name}</h1>
                    {entity.descr !== "" && <p>{sentence(entity.descr)}</p>}
                </div>
                <div class="state">
                    <StateBadge entity={entity} />
                    <span class="quiet">{entity.latched ? "It does nothing until somebody rearms it." : entity.reason !== "" ? sentence(entity.reason) : hold !== undefined && entity.state === "REG" ? "It waits for your task." : long}</span>
                    {!seen.fresh && (
                        <span class="quiet">
                            as it was <Age at={seen.seenAt} /> ago
                        </span>
                    )}
                </div>
            </div>
            {entity.latched && (
                <div class="banner bad inline" role="status">
                    <strong>{entity.name} was stopped.</strong> Look whether it is safe to move again, then rearm it. <Rearm id={id} />
                </div>
            )}
            {details !== undefined && details.findings.length > 0 && (
                <ul class="findings">
                    {details.findings.map(({ message, fix }, at) => (
                        <li key={at}>
                            <strong>{sentence(message)}</strong> {sentence(fix)}
                        </li>
                    ))}
                </ul>
            )}
            <div class="columns">
                <div class="column side">
                    <Ownership entity={entity} />
                    {past !== undefined && (hold !== undefined || past.jobs.value.length > 0) && (
                        <section class="card" aria-label="Tasks">
                            <h2>Tasks</h2>
                            <Jobs hold={past} />
                        </section>
                    )}
                    {hold !== undefined && <Messages hold={hold} />}
                    <Technical entity={entity} details={details} />
                </div>
                <div class="column">
                    <h2>What it can do</h2>
                    {services.length > 1 && (
                        <div class="tabs" role="tablist" aria-label="Services">
                            {services.map((one) => (
                                <button key={one.name} type="button" role="tab" aria-selected={one === open} tabIndex={one === open ? 0 : -1} onClick={() => setService(one.name)} onKeyDown={(event) => step(event, services, open, setService)}>
                                    {one.name}
                                    {!one.active && <span class="quiet"> (off)</span>}
                                </button>
                            ))}
                        </div>
                    )}
                    {open !== undefined ? (
                        <ServiceForm key={open.name} entity={entity} service={open} hold={hold} />
                    ) : (
                        <Empty>{trouble !== "" ? `It does not say what it can do: ${sentence(trouble)}` : details === undefined ? "Asking it what it can do …" : "It offers no services."}</Empty>
                    )}
                </div>
            </div>
            <h2>What it measures</h2>
            <Streams id={id} />
            <details class="history">
                <summary>
                    History, as this page has seen it <span class="count">{own.length}</span>
                </summary>
                <Entries entries={own.slice(0, 200)} />
            </details>
        </>
    );
}
function step(event: KeyboardEvent, services: readonly Service[], open: Service | undefined, choose: (name: string) => void): void {
    const by = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[event.key];
    if (by === undefined || open === undefined) return;
    event.preventDefault();
    const at = (services.indexOf(open) + by + services.length) % services.length;
    choose(services[at]?.name ?? "");
    const tabs = (event.currentTarget as HTMLElement).parentElement?.children;
    (tabs?.[at] as HTMLElement | undefined)?.focus();
}
