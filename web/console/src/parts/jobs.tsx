// SPDX-License-Identifier: GPL-2.0-or-later
import { isFinalTask } from "@axon/client";
import { now } from "../state/clock";
import type { Hold, Job } from "../state/holds";
import { refused } from "../state/journal";
import { reachable } from "../state/session";
import { formatClock, formatMs, formatPercent, formatSpan, formatValues } from "../words/format";
import { plainTask, remedyOf, sentence } from "../words/words";
import { ServerButton } from "./server_button";
import { Badge, Empty, Progress } from "./small";

function JobCard({ hold, job }: { readonly hold: Hold; readonly job: Job }): preact.JSX.Element {
    const report = job.report.value;
    const { tone, short, long } = plainTask(report.state);
    const open = !isFinalTask(report.state);
    const service = hold.services.value.find(({ name }) => name === job.service);
    const ask = (what: string, act: () => Promise<void>): void => void act().catch((error: unknown) => refused(`${job.service} was not ${what}`, error, hold.entity));
    const ended = job.endedAt.value;
    return (
        <li class={`job ${tone} ${open && !reachable.value ? "stale" : ""}`} data-task={report.state}>
            <div class="head">
                <strong>{job.service}</strong>
                <Badge tone={tone} title={long}>
                    {short}
                </Badge>
            </div>
            {open && <Progress value={report.progress} label={`Progress of ${job.service}`} />}
            <p class="feedback">
                {open && report.progress !== undefined && <b>{formatPercent(report.progress)}</b>} {report.feedback}
            </p>
            {job.asked !== "" && <p class="quiet">With {job.asked}</p>}
            {report.results.size > 0 && (
                <dl class="results">
                    {[...report.results].map(([name, values]) => (
                        <div key={name}>
                            <dt>{name}</dt>
                            <dd>{formatValues(values, service?.parameters.find((one) => one.name === name)?.units)}</dd>
                        </div>
                    ))}
                </dl>
            )}
            {report.reason !== undefined && (
                <p class="bad">
                    {sentence(report.reason.message)} {remedyOf(report.reason)}
                </p>
            )}
            {report.state === "UNKNOWN" && report.reason === undefined && <p class="bad">{long}</p>}
            <div class="row">
                {open && service?.pausable === true && report.state !== "PAUSED" && report.state !== "QUEUED" && (
                    <ServerButton onClick={() => ask("paused", () => job.task.pause())}>
                        Pause
                    </ServerButton>
                )}
                {report.state === "PAUSED" && (
                    <ServerButton onClick={() => ask("resumed", () => job.task.resume())}>
                        Resume
                    </ServerButton>
                )}
                {open && (
                    <ServerButton onClick={() => ask("cancelled", () => job.task.cancel())}>
                        Cancel
                    </ServerButton>
                )}
                <span class="quiet">
                    {formatClock(job.at)}, {ended === undefined ? formatSpan(now.value - job.at) : formatMs(ended - job.at)}
                </span>
            </div>
        </li>
    );
}

export function Jobs({ hold }: { readonly hold: Hold }): preact.JSX.Element {
    const jobs = hold.jobs.value;
    if (jobs.length === 0) return <Empty>No task yet. Choose a service, fill in its form, and press Run.</Empty>;
    return (
        <ol class="jobs" aria-label="Tasks, newest first">
            {jobs.map((job) => (
                <JobCard key={job.task.id} hold={hold} job={job} />
            ))}
        </ol>
    );
}
