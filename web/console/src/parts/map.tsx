// SPDX-License-Identifier: GPL-2.0-or-later
// Where the entities stand, by the positions in their profiles.
import { formatNumber } from "../words/format";
import type { Seen } from "../state/entities";
import { linkTo } from "../state/route";
import { marks, plainState } from "../words/words";

const WIDE = 1000;
const HIGH = 600;
const EDGE = 70;

/** 1, 2 or 5 times a power of ten, so that about ten lines are seen. */
function stepOf(span: number): number {
    const rough = span / 8;
    const power = 10 ** Math.floor(Math.log10(rough));
    return ([1, 2, 5].find((factor) => factor * power >= rough) ?? 10) * power;
}

export function LabMap({ seen }: { readonly seen: readonly Seen[] }): preact.JSX.Element {
    const xs = seen.map(({ entity }) => entity.xMm / 1000);
    const ys = seen.map(({ entity }) => entity.yMm / 1000);
    const low = { x: Math.min(...xs), y: Math.min(...ys) };
    const span = { x: Math.max(Math.max(...xs) - low.x, 1), y: Math.max(Math.max(...ys) - low.y, 0.6) };
    const scale = Math.min((WIDE - 2 * EDGE) / span.x, (HIGH - 2 * EDGE) / span.y);
    const left = (WIDE - span.x * scale) / 2;
    const foot = (HIGH + span.y * scale) / 2;
    const at = (x: number, y: number): { x: number; y: number } => ({ x: left + (x - low.x) * scale, y: foot - (y - low.y) * scale });
    const step = stepOf(Math.max(WIDE, HIGH) / scale);
    const lines = (from: number, to: number): number[] => Array.from({ length: Math.min(Math.ceil((to - from) / step) + 2, 60) }, (_, i) => (Math.floor(from / step) + i) * step);
    // Several at one place stand beside each other.
    const taken = new Map<string, number>();
    return (
        <figure class="map">
            <svg viewBox={`0 0 ${WIDE} ${HIGH}`} role="group" aria-label="Map of the laboratory">
                <g class="grid" aria-hidden="true">
                    {lines(low.x - left / scale, low.x + (WIDE - left) / scale).map((x) => (
                        <line key={`x${x}`} x1={at(x, 0).x} x2={at(x, 0).x} y1={0} y2={HIGH} />
                    ))}
                    {lines(low.y - (HIGH - foot) / scale, low.y + foot / scale).map((y) => (
                        <line key={`y${y}`} x1={0} x2={WIDE} y1={at(0, y).y} y2={at(0, y).y} />
                    ))}
                </g>
                {seen.map(({ entity, fresh }) => {
                    const { x, y } = at(entity.xMm / 1000, entity.yMm / 1000);
                    const place = `${Math.round(x / 12)} ${Math.round(y / 12)}`;
                    const before = taken.get(place) ?? 0;
                    taken.set(place, before + 1);
                    const { tone, short } = plainState(entity);
                    return (
                        <g key={entity.id} transform={`translate(${x} ${y + before * 26})`}>
                            <a href={linkTo("entity", entity.id)} class={`spot ${tone} ${fresh ? "" : "stale"}`} aria-label={`${entity.name}, ${short}`}>
                                <circle r={entity.type === "MOBILE" ? 11 : 9} />
                                <text x="17" y="5">
                                    {entity.name.slice(0, 24)} {marks[tone]}
                                </text>
                            </a>
                        </g>
                    );
                })}
            </svg>
            <figcaption class="quiet">Positions are those of the profiles, where the robots were set up. One square is {formatNumber(step)} m.</figcaption>
        </figure>
    );
}
