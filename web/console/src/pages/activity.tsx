// SPDX-License-Identifier: GPL-2.0-or-later
import { signal } from "@preact/signals";
import { Measures } from "../parts/measures";
import { Empty } from "../parts/small";
import { type Entry, journal, kinds, type Kind } from "../state/journal";
import { linkTo } from "../state/route";
import { formatClock, formatCount, formatDate } from "../words/format";

const titles: Readonly<Record<Kind, string>> = { state: "States", who: "Who has what", task: "Tasks", stop: "Stops", fault: "Faults", refusal: "Refusals", message: "Messages", connection: "Connection" };
const off = signal<ReadonlySet<Kind>>(new Set());
const words = signal("");
const most = signal(200);

export function Entries({ entries }: { readonly entries: readonly Entry[] }): preact.JSX.Element {
    if (entries.length === 0) return <Empty>Nothing yet.</Empty>;
    return (
        <ol class="entries">
            {entries.map((entry) => (
                <li key={entry.number} class={entry.kind} data-kind={entry.kind}>
                    <time dateTime={new Date(entry.at).toISOString()} title={formatDate(entry.at)}>
                        {formatClock(entry.at)}
                    </time>
                    <span class={`chip ${entry.kind}`}>{titles[entry.kind]}</span>
                    <span class="what">
                        {entry.name !== "" && (entry.entity !== "" ? <a href={linkTo("entity", entry.entity)}>{entry.name}</a> : <strong>{entry.name}</strong>)} {entry.text}
                        {entry.remedy !== "" && <em> {entry.remedy}</em>} {entry.code !== "" && <span class="token">{entry.code}</span>}
                    </span>
                </li>
            ))}
        </ol>
    );
}

function save(entries: readonly Entry[]): void {
    const lines = entries.map((entry) => JSON.stringify({ time: new Date(entry.at).toISOString(), kind: entry.kind, entity: entry.entity, name: entry.name, text: entry.text, code: entry.code }));
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([`${lines.reverse().join("\n")}\n`], { type: "application/x-ndjson" }));
    link.download = `axon-activity-${new Date().toISOString().slice(0, 19).replaceAll(":", "-")}.jsonl`;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}

export function ActivityPage(): preact.JSX.Element {
    const search = words.value.trim().toLowerCase().split(/\s+/);
    const shown = journal.value.filter((entry) => {
        if (off.value.has(entry.kind)) return false;
        const text = `${entry.name} ${entry.text} ${entry.code} ${entry.remedy}`.toLowerCase();
        return search.every((word) => text.includes(word));
    });
    const toggle = (kind: Kind): void => {
        const all = new Set(off.value);
        if (!all.delete(kind)) all.add(kind);
        off.value = all;
    };
    return (
        <>
            <div class="title">
                <h1>
                    Activity <span class="count">{formatCount(shown.length)}</span>
                </h1>
                <div class="filters" role="search">
                    <label class="unseen" for="activity-words">
                        Search
                    </label>
                    <input id="activity-words" type="search" placeholder="Search" value={words.value} onInput={(event) => (words.value = event.currentTarget.value)} />
                    <button type="button" onClick={() => save(shown)} disabled={shown.length === 0}>
                        Save as a file
                    </button>
                </div>
            </div>
            <div class="activity">
                <div class="stack">
                    <p class="quiet">What this page has seen since it was loaded. The log of the server has more.</p>
                    <div class="kinds" role="group" aria-label="Kinds that are shown">
                        {kinds.map((kind) => (
                            <button key={kind} type="button" class={`chip ${kind}`} aria-pressed={!off.value.has(kind)} onClick={() => toggle(kind)}>
                                {titles[kind]}
                            </button>
                        ))}
                    </div>
                    <Entries entries={shown.slice(0, most.value)} />
                    {shown.length > most.value && (
                        <button type="button" onClick={() => (most.value *= 3)}>
                            Show more
                        </button>
                    )}
                </div>
                <Measures />
            </div>
        </>
    );
}
