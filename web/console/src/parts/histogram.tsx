// SPDX-License-Identifier: GPL-2.0-or-later
// How long something takes: how often how long, and the figures in words.
import { formatCount, formatMs } from "../words/format";

/** Milliseconds, the upper edge of each column; what is longer comes into one more. */
const EDGES = [1, 2, 3, 5, 8, 12, 20, 30, 50, 80, 120, 200, 300, 500, 1000] as const;
const HIGH = 72;
const COLUMN = 20;
const UNIT = 18; // beside the last edge

/** The value below which so many of them are. */
export function quantile(sorted: readonly number[], share: number): number {
    return sorted[Math.min(Math.max(Math.ceil(sorted.length * share) - 1, 0), sorted.length - 1)] ?? 0;
}

interface Props {
    readonly title: string;
    readonly about: string;
    readonly values: readonly number[];
    readonly empty: string;
}
export function Histogram({ title, about, values, empty }: Props): preact.JSX.Element {
    const sorted = [...values].sort((a, b) => a - b);
    const counts: number[] = Array.from({ length: EDGES.length + 1 }, () => 0);
    for (const one of values) {
        const at = EDGES.findIndex((edge) => one <= edge);
        const column = at < 0 ? EDGES.length : at;
        counts[column] = (counts[column] ?? 0) + 1;
    }
    const most = Math.max(...counts, 1);
    const wide = counts.length * COLUMN;
    const words = values.length === 0 ? empty : `${formatCount(values.length)} measured: half within ${formatMs(quantile(sorted, 0.5))}, 95 % within ${formatMs(quantile(sorted, 0.95))}, the longest ${formatMs(sorted.at(-1) ?? 0)}.`;
    return (
        <section class="histogram" aria-label={title}>
            <h3>{title}</h3>
            <p class="quiet">{about}</p>
            {values.length > 0 && (
                <svg viewBox={`0 0 ${wide + UNIT} ${HIGH + 16}`} role="img" aria-label={`${title}: ${words}`}>
                    <line x1="0" x2={wide} y1={HIGH + 0.5} y2={HIGH + 0.5} class="base" />
                    {counts.map((count, i) => {
                        const high = count === 0 ? 0 : Math.max((count / most) * (HIGH - 6), 2);
                        return count === 0 ? null : <rect key={i} x={i * COLUMN + 2} y={HIGH - high} width={COLUMN - 4} height={high} rx="2" />;
                    })}
                    {EDGES.map((edge, i) =>
                        i % 2 === 0 ? (
                            <text key={edge} x={(i + 1) * COLUMN} y={HIGH + 13} text-anchor="middle">
                                {edge}
                            </text>
                        ) : null,
                    )}
                    <text x={wide + UNIT} y={HIGH + 13} text-anchor="end">
                        ms
                    </text>
                </svg>
            )}
            <p class="figures">{words}</p>
        </section>
    );
}
