// SPDX-License-Identifier: GPL-2.0-or-later
// Jobs for several robots: what the server offers, who plays which role, a check in which nothing moves, and the run.
import type { GlobalService, GlobalServices, Proposal, RoleOutlook, Run, RunHistory, RunReport, StepReport } from "@axon/client";
import { isFinalRun } from "@axon/client";
import { signal } from "@preact/signals";
import { useEffect, useState } from "preact/hooks";
import { ServerButton } from "../parts/server_button";
import { Badge, Empty, Progress, Select } from "../parts/small";
import { entities } from "../state/entities";
import { checkOut, holds } from "../state/holds";
import { asRefusal, note, refused } from "../state/journal";
import { linkTo } from "../state/route";
import { client, reachable } from "../state/session";
import { stop } from "../state/stops";
import { formatClock, formatDate, formatMs, formatPercent, formatSpan, formatValues } from "../words/format";
import { marks, plainKind, plainRun, plainTask, remedyOf, sentence, type Tone } from "../words/words";

const failures = { "stop-all": "If a step fails, all of them stop.", "hold-others": "If a step fails, the others are held.", compensate: "If a step fails, they clean up as the job says." } as const;

const AGAIN_MS = 4000;

interface Running {
    readonly run: Run;
    readonly service: GlobalService;
    readonly at: number;
    readonly report: RunReport;
}
/** Runs outlive the page that began them. */
const runs = signal<readonly Running[]>([]);

function follow(run: Run, service: GlobalService): void {
    runs.value = [{ run, service, at: Date.now(), report: run.report() }, ...runs.value].slice(0, 20);
    let state = "";
    run.onUpdate((report) => {
        runs.value = runs.value.map((one) => (one.run === run ? { ...one, report } : one));
        if (report.state === state) return;
        state = report.state;
        note(report.state === "REFUSED" ? "refusal" : "task", undefined, `${service.name}${report.check ? ", check only" : ""}: ${plainRun(report.state).short}${report.reason === undefined ? "" : `. ${sentence(report.reason.message)}`}`, report.reason);
    });
}

/** Robots as rows, steps as bars with their numbers: who works when, and in which order. */
function Chart({ report }: { readonly report: RunReport }): preact.JSX.Element {
    const end = Math.max(report.elapsedMs, ...report.steps.map((step) => step.endedMs ?? step.beganMs ?? 0), 1);
    const bar = (step: StepReport): { left: string; width: string } | undefined => {
        if (step.beganMs === undefined) return undefined;
        const until = step.endedMs ?? end;
        return { left: `${(step.beganMs / end) * 100}%`, width: `${Math.max(((until - step.beganMs) / end) * 100, 0.7)}%` };
    };
    const rows = new Map<string, { readonly name: string; readonly steps: StepReport[] }>();
    for (const step of report.steps) {
        const row = rows.get(step.entity) ?? { name: step.name, steps: [] };
        row.steps.push(step);
        rows.set(step.entity, row);
    }
    return (
        <div class="chart" role="img" aria-label={`Who works when: ${[...rows.values()].map(({ name, steps }) => `${name} ${steps.filter(({ beganMs }) => beganMs !== undefined).length} of ${steps.filter(({ compensation }) => !compensation).length} steps begun`).join(", ")}`}>
            {[...rows].map(([entity, { name, steps }]) => (
                <div key={entity} class="lane">
                    <span class="name">{name}</span>
                    <span class="track">
                        {steps.map((step) => {
                            const place = bar(step);
                            if (place === undefined || step.state === undefined) return null;
                            return (
                                <span key={step.step} class={`bar ${plainTask(step.state).tone}`} style={place} title={`${step.step + 1}: ${step.service}, ${plainTask(step.state).short}`}>
                                    {step.step + 1}
                                </span>
                            );
                        })}
                    </span>
                </div>
            ))}
            <div class="lane axis">
                <span class="name" />
                <span class="ends quiet">
                    <span>0 s</span>
                    <span>{formatSpan(end / 2)}</span>
                    <span>{formatSpan(end)}</span>
                </span>
            </div>
        </div>
    );
}

function Timeline({ report }: { readonly report: RunReport }): preact.JSX.Element {
    return (
        <ol class="timeline" aria-label="Steps of the run">
            {report.steps
                .filter((step) => !step.compensation || step.state !== undefined)
                .map((step) => {
                    const tone: Tone = step.state === undefined ? "off" : plainTask(step.state).tone;
                    return (
                        <li key={`${step.step}`} class={tone}>
                            <span class="label">
                                <b class="number">{step.step + 1}</b>
                                <a href={linkTo("entity", step.entity)}>{step.name}</a> {step.service}
                                {step.compensation && <span class="quiet"> (cleaning up)</span>}
                                {step.tries > 1 && <span class="quiet"> try {step.tries}</span>}
                            </span>
                            <span class="quiet state">
                                <span aria-hidden="true">{marks[tone]}</span> {step.state === undefined ? "waits" : plainTask(step.state).short}
                                {step.beganMs !== undefined && step.endedMs !== undefined && `, ${formatMs(step.endedMs - step.beganMs)}`}
                                {step.endedMs === undefined && step.progress !== undefined && ` ${formatPercent(step.progress)}`}
                                {step.feedback !== "" && step.endedMs === undefined && `: ${step.feedback}`}
                            </span>
                            {(step.results.size > 0 || step.reason !== undefined) && (
                                <span class={step.reason === undefined ? "quiet more" : "bad more"}>
                                    {step.reason !== undefined ? sentence(step.reason.message) : [...step.results].map(([name, values]) => `${name} ${formatValues(values)}`).join(", ")}
                                </span>
                            )}
                        </li>
                    );
                })}
        </ol>
    );
}

function RunCard({ its: { run, at, report, service } }: { readonly its: Running }): preact.JSX.Element {
    const { tone, short, long } = plainRun(report.state);
    const open = !isFinalRun(report.state);
    const ask = (what: string, act: () => Promise<void>): void => void act().catch((error: unknown) => refused(`${service.name} was not ${what}`, error));
    const those = [...new Set([report.master, ...report.steps.map(({ entity }) => entity)])];
    return (
        <section class={`card run ${tone} ${open && !reachable.value ? "stale" : ""}`} data-run={report.state} aria-label={`${report.check ? "Check" : "Run"} of ${service.name}`}>
            <div class="head">
                <h3>
                    {report.check ? "Check of " : ""}
                    {service.name}
                </h3>
                <Badge tone={tone} title={long}>
                    {report.check && report.state === "SUCCEEDED" ? "possible" : short}
                </Badge>
            </div>
            {open && <Progress value={report.progress} label={`Progress of ${service.name}`} />}
            {report.check && report.state === "SUCCEEDED" && <p>It can be run as it is. Nothing has moved.</p>}
            {long !== "" && <p class="quiet">{long}</p>}
            {report.reason !== undefined && (
                <p class="bad">
                    {sentence(report.reason.message)} {remedyOf(report.reason)}
                </p>
            )}
            {report.problems.length > 0 && (
                <ul class="findings">
                    {report.problems.map(({ refusal, entity, step }, i) => (
                        <li key={i}>
                            <strong>
                                {entities.value.get(entity)?.entity.name ?? ""} {step >= 0 && `step ${step + 1}`}
                            </strong>{" "}
                            {sentence(refusal.message)} {remedyOf(refusal)}
                        </li>
                    ))}
                </ul>
            )}
            {!report.check && report.steps.length > 0 && (
                <>
                    <Chart report={report} />
                    <Timeline report={report} />
                </>
            )}
            <div class="row">
                {open && !report.check && (
                    <>
                        <button type="button" class="danger" onClick={() => void stop(those, service.name)}>
                            Stop all of them
                        </button>
                        {report.state === "RUNNING" && (
                            <ServerButton onClick={() => ask("paused", () => run.pause())}>
                                Pause
                            </ServerButton>
                        )}
                        {(report.state === "PAUSED" || report.state === "HELD") && (
                            <ServerButton onClick={() => ask("resumed", () => run.resume())}>
                                {report.state === "HELD" ? "Try the step again" : "Resume"}
                            </ServerButton>
                        )}
                        <ServerButton onClick={() => ask("cancelled", () => run.cancel())}>
                            Cancel
                        </ServerButton>
                    </>
                )}
                <span class="quiet">
                    {formatClock(at)}
                    {report.elapsedMs > 0 && `, ${formatSpan(report.elapsedMs)}`}
                </span>
            </div>
        </section>
    );
}

interface RoleProps {
    readonly outlook: RoleOutlook;
    readonly choice: string;
    readonly choose: (entity: string) => void;
}
function Role({ outlook, choice, choose }: RoleProps): preact.JSX.Element {
    const mine = choice !== "" && holds.value.has(choice);
    const [category = "", type = ""] = outlook.kind.split("/");
    const needs = outlook.wanted.slice(outlook.kind.length).replace(/^ with /, "");
    const name = (id: string): string => entities.value.get(id)?.entity.name ?? id;
    // Those that offer something else entirely are no choice.
    const options: (readonly [string, string])[] = [["", "choose …"]];
    const ids = new Set<string>();
    for (const { entity } of entities.value.values()) {
        const unfit = outlook.unfit.find((one) => one.entity === entity.id);
        if (unfit !== undefined && unfit.distance >= 7) continue;
        ids.add(entity.id);
        options.push([entity.id, `${name(entity.id)}${unfit === undefined ? "" : `: ${unfit.why.message}`}`]);
    }
    if (choice !== "" && !ids.has(choice)) options.push([choice, name(choice)]);
    const why = outlook.unfit.find((one) => one.entity === choice)?.why;
    return (
        <div class="role">
            <Select label={`Role ${outlook.role + 1}: ${plainKind({ category, type })}`} value={choice} options={options} onChange={choose} />
            <span>{choice === "" ? <Badge tone="bad">nobody yet</Badge> : mine ? <Badge tone="good">yours</Badge> : <Badge tone="wait">not checked out</Badge>}</span>
            {needs !== "" && <span class="quiet">It has to offer {needs}.</span>}
            {why !== undefined && (
                <span class="quiet">
                    {name(choice)} {sentence(why.message)} {remedyOf(why)}
                </span>
            )}
            {choice === "" &&
                outlook.unfit.slice(0, 3).map((one) => (
                    <span key={one.entity} class="quiet">
                        {one.name} {one.why.message}.
                    </span>
                ))}
        </div>
    );
}

function Plan({ service }: { readonly service: GlobalService }): preact.JSX.Element {
    const its = client.value;
    const [proposal, setProposal] = useState<Proposal>();
    const [choices, setChoices] = useState<ReadonlyMap<number, string>>(new Map());
    const [busy, setBusy] = useState(false);
    const [round, setRound] = useState(0);
    const occasion = `${round} ${[...entities.value.values()].map(({ entity }) => `${entity.id} ${entity.holder?.id} ${entity.latched} ${entity.state}`).join()}`;
    // Robots switch services on and off without a word to those who do not hold them.
    useEffect(() => {
        const timer = setInterval(() => document.visibilityState === "visible" && setRound((count) => count + 1), AGAIN_MS);
        return () => clearInterval(timer);
    }, []);
    const answers = reachable.value;
    useEffect(() => {
        if (its === undefined || !answers) return undefined;
        let wanted = true;
        const timer = setTimeout(
            () =>
                void its.propose(service).then(
                    (found) => wanted && setProposal(found),
                    (error: unknown) => wanted && proposal === undefined && refused(`${service.name} cannot be planned now`, error),
                ),
            proposal === undefined ? 0 : 400,
        );
        return () => {
            wanted = false;
            clearTimeout(timer);
        };
    }, [its, service, occasion, answers]);
    if (its === undefined || proposal === undefined) return <p class="quiet">Asking the robots what they can do …</p>;
    const choiceOf = (role: RoleOutlook): string => choices.get(role.role) ?? role.entity;
    const chosen = proposal.roles.map((role) => ({ role: role.role, id: choiceOf(role) }));
    const open = chosen.filter(({ id }) => id === "" || !holds.value.has(id));
    const unbound = chosen.filter(({ id }) => id === "").length;
    const twice = new Set(chosen.map(({ id }) => id)).size < chosen.length && unbound === 0;
    const barrier = unbound > 0 ? `${unbound === 1 ? "One role has" : `${unbound} roles have`} no robot.` : twice ? "Every role needs a robot of its own." : open.length > 0 ? "Check out all of them first." : "";
    const take = async (): Promise<void> => {
        setBusy(true);
        for (const { id } of open) {
            const entity = entities.peek().get(id)?.entity;
            if (entity !== undefined && (await checkOut(its, entity, "take")) === undefined) break;
        }
        setBusy(false);
    };
    const begin = (check: boolean): void => {
        const bindings = new Map(chosen.map(({ role, id }) => [role, id]));
        const master = chosen[0]?.id ?? "";
        try {
            follow(check ? its.checkGlobal(service, bindings, master) : its.runGlobal(service, bindings, master), service);
        } catch (error) {
            refused(`${service.name} was not begun`, error);
        }
    };
    return (
        <div class="plan">
            {proposal.roles.map((role) => (
                <Role key={role.role} outlook={role} choice={choiceOf(role)} choose={(id) => setChoices(new Map(choices).set(role.role, id))} />
            ))}
            {proposal.nobodyOffers.length > 0 && <p class="bad">No robot that is connected offers: {proposal.nobodyOffers.join(", ")}.</p>}
            <div class="act">
                {open.length > 0 && unbound === 0 && !twice && (
                    <ServerButton class="primary" disabled={busy} onClick={() => void take()}>
                        Check out {open.length === chosen.length ? `all ${chosen.length}` : `the other ${open.length}`}
                    </ServerButton>
                )}
                <ServerButton disabled={barrier !== ""} onClick={() => begin(true)}>
                    Check, nothing moves
                </ServerButton>
                <ServerButton class={barrier === "" ? "primary" : ""} disabled={barrier !== ""} onClick={() => begin(false)}>
                    Run {service.name}
                </ServerButton>
                <span class="quiet">{barrier}</span>
            </div>
        </div>
    );
}

function Steps({ service }: { readonly service: GlobalService }): preact.JSX.Element {
    const stages = [...new Set(service.steps.map(({ preced }) => preced))].sort((a, b) => a - b);
    return (
        <ol class="steps">
            {stages.map((preced, at) => (
                <li key={preced}>
                    <b>{at + 1}</b>
                    {service.steps
                        .filter((step) => step.preced === preced)
                        .map((step, i) => (
                            <span key={i} class="chip">
                                role {step.role + 1}: {step.serviceGlobalId}
                                {step.parameters.map(({ name, values }) => ` ${name}=${values.join(",")}`).join("")}
                                {step.sources.map(({ parameter, step: from, output }) => ` ${parameter} from ${from}.${output}`).join("")}
                            </span>
                        ))}
                </li>
            ))}
        </ol>
    );
}

function History(): preact.JSX.Element {
    const [history, setHistory] = useState<RunHistory>();
    const [busy, setBusy] = useState(false);
    const load = async (): Promise<void> => {
        setBusy(true);
        try {
            setHistory(await client.value?.runHistory([], 20));
        } catch (error) {
            refused("The past runs were not found", error);
        }
        setBusy(false);
    };
    return (
        <details class="card" onToggle={(event) => event.currentTarget.open && history === undefined && void load()}>
            <summary>Past runs</summary>
            {history === undefined ? (
                <p class="quiet">Asking the robots …</p>
            ) : history.runs.length === 0 ? (
                <Empty>There were none.</Empty>
            ) : (
                <ol class="rows">
                    {history.runs.slice(0, 100).map((one) => (
                        <li key={one.id}>
                            <span class="who">
                                <strong>{one.service.name}</strong> <Badge tone={plainRun(one.state).tone}>{plainRun(one.state).short}</Badge> {one.participants.map(({ name }) => name).join(", ")}
                                <span class="quiet">
                                    by {one.by}, {formatDate(one.askedAt.getTime())}, {formatSpan(one.durationMs)}
                                </span>
                                {one.reason !== undefined && <span class="bad">{sentence(one.reason.message)}</span>}
                            </span>
                        </li>
                    ))}
                </ol>
            )}
            {history !== undefined && history.silent.length > 0 && <p class="quiet">Not heard of: {history.silent.map(({ name }) => name).join(", ")}.</p>}
            <ServerButton disabled={busy} onClick={() => void load()}>
                Ask again
            </ServerButton>
        </details>
    );
}

export function CollaborationPage(): preact.JSX.Element {
    const its = client.value;
    const [found, setFound] = useState<GlobalServices>();
    const [trouble, setTrouble] = useState("");
    const [open, setOpen] = useState("");
    const load = (): void => {
        its?.globalServices().then(
            (services) => {
                setFound(services);
                setTrouble("");
            },
            (error: unknown) => setTrouble(sentence(asRefusal(error).message)),
        );
    };
    const answers = reachable.value;
    useEffect(() => {
        if (answers) load();
    }, [its, answers]);
    const bad = found?.files.filter((file) => file.findings.length > 0) ?? [];
    return (
        <>
            <div class="title">
                <div>
                    <h1>Collaboration</h1>
                    <p class="quiet">Jobs in which several robots work together.</p>
                </div>
                <ServerButton onClick={load}>
                    Look again
                </ServerButton>
            </div>
            {trouble !== "" && <p class="bad">{trouble}</p>}
            {found === undefined && trouble === "" && <p class="quiet">Asking the server which jobs there are …</p>}
            {runs.value.length > 0 && (
                <section class="stack" aria-label="Runs of this page">
                    {runs.value.map((one) => (
                        <RunCard key={one.run.id} its={one} />
                    ))}
                </section>
            )}
            {found !== undefined && found.services.length === 0 && <Empty>The server offers no jobs. An administrator puts their files into its folder of global services (docs/how-to/first-global-service.md).</Empty>}
            <ul class="jobs-list">
                {found?.services.map((service) => {
                    const key = `${service.file} ${service.name}`;
                    const roles = new Set(service.steps.map(({ role }) => role)).size;
                    return (
                        <li key={key} class="card" data-global={service.name}>
                            <div class="head">
                                <h2>{service.name}</h2>
                                <button type="button" aria-expanded={open === key} onClick={() => setOpen(open === key ? "" : key)}>
                                    {open === key ? "Close" : "Plan it"}
                                    <span class="unseen"> {service.name}</span>
                                </button>
                            </div>
                            {service.descr !== "" && <p>{sentence(service.descr)}</p>}
                            <p class="quiet">
                                {roles} robots, {service.steps.length} steps. {failures[service.onFailure]}
                            </p>
                            {open === key && (
                                <>
                                    <Plan service={service} />
                                    <details class="facts">
                                        <summary>Its steps</summary>
                                        <Steps service={service} />
                                        <p class="quiet">From the file {service.file}</p>
                                    </details>
                                </>
                            )}
                        </li>
                    );
                })}
            </ul>
            {bad.length > 0 && (
                <details class="card">
                    <summary>Files with findings: {bad.length}</summary>
                    <ul class="findings">
                        {bad.map(({ name, findings }) => (
                            <li key={name}>
                                <strong>{name}</strong> {findings.slice(0, 8).join(" ")}
                            </li>
                        ))}
                    </ul>
                </details>
            )}
            <History />
        </>
    );
}
