// SPDX-License-Identifier: GPL-2.0-or-later
// Where the entities stand: a canvas with what changes ten times in a second, and above it links that everybody can reach.
import type { Scan } from "@axon/client";
import { useEffect, useRef, useState } from "preact/hooks";
import type { Seen } from "../state/entities";
import { closeFloor, floor, type Floor, openFloor } from "../state/floor";
import { say } from "../state/journal";
import { MAPPED, useLive } from "../state/live";
import { agoOf, isOld, type Live, liveOf } from "../state/live_store";
import { linkTo } from "../state/route";
import { silent } from "../state/session";
import { formatNumber } from "../words/format";
import { marks, plainState } from "../words/words";
import { type Colour, draw, paintGrid } from "./paint";
import { type Box, boxAround, type Point, type View, viewOf } from "./view";

const DRAW_MS = 100;
const LABELS_MS = 250;
const LIVE_MAX = 60;
/** A pose that is further from the position of the profile is in a frame of its own. */
const SAME_FRAME_M = 1;

interface Place {
    readonly x: number;
    readonly y: number;
    readonly yaw: number | undefined;
    readonly live: Live | undefined;
}

function placeOf({ entity }: Seen): Place {
    const x = entity.xMm / 1000;
    const y = entity.yMm / 1000;
    const live = liveOf(entity.id);
    if (live?.pose === undefined || Math.hypot(live.pose.x - x, live.pose.y - y) > SAME_FRAME_M) return { x, y, yaw: undefined, live: undefined };
    return { x: live.pose.x, y: live.pose.y, yaw: live.pose.yaw, live };
}
function paintFloor(pen: CanvasRenderingContext2D, view: View, plan: Floor, colour: Colour): void {
    pen.strokeStyle = colour("--text");
    pen.lineWidth = 2;
    pen.beginPath();
    for (const [x1, y1, x2, y2] of plan.lines) {
        pen.moveTo(view.x(x1), view.y(y1));
        pen.lineTo(view.x(x2), view.y(y2));
    }
    pen.stroke();
    pen.font = "12px system-ui, sans-serif";
    pen.fillStyle = colour("--quiet");
    pen.textAlign = "center";
    for (const { name, x, y } of plan.goals) {
        pen.fillText("+", view.x(x), view.y(y) + 4);
        if (view.scale > 45) pen.fillText(name, view.x(x), view.y(y) + 18);
    }
    pen.textAlign = "start";
}
const reachOf = ({ maxRange }: Scan): number => (maxRange > 0 ? maxRange : Infinity);
const angleOf = (scan: Scan, yaw: number | undefined, i: number): number => (yaw ?? 0) + (scan.angles[i] ?? scan.startAngle + i * scan.step);
const farOf = (scan: Scan, range: number): number => Math.min(Number.isFinite(range) && range > 0 ? range : 0, reachOf(scan));
/** Where the beams end that are drawn now. */
function endsOf({ x, y, yaw, live }: Place, at: number): readonly Point[] {
    return [...(live?.scans.values() ?? [])].flatMap(({ scan, at: then }) =>
        isOld(then, at) ? [] : scan.ranges.map((range, i) => ({ x: x + Math.cos(angleOf(scan, yaw, i)) * farOf(scan, range), y: y + Math.sin(angleOf(scan, yaw, i)) * farOf(scan, range) })),
    );
}
/** What the beams see is free; sonars see in cones. */
function paintFan(pen: CanvasRenderingContext2D, view: View, { x, y, yaw }: Place, scan: Scan, colour: string): void {
    const reach = reachOf(scan);
    const angle = (i: number): number => angleOf(scan, yaw, i);
    const few = scan.ranges.length <= 32;
    pen.fillStyle = colour;
    pen.globalAlpha = few ? 0.22 : 0.13;
    pen.beginPath();
    pen.moveTo(view.x(x), view.y(y));
    scan.ranges.forEach((range, i) => {
        const far = farOf(scan, range);
        if (few) {
            pen.moveTo(view.x(x), view.y(y));
            pen.arc(view.x(x), view.y(y), far * view.scale, -angle(i) - 0.13, -angle(i) + 0.13);
        } else {
            pen.lineTo(view.x(x + Math.cos(angle(i)) * far), view.y(y + Math.sin(angle(i)) * far));
        }
    });
    pen.fill();
    pen.globalAlpha = 1;
    if (few) return;
    scan.ranges.forEach((range, i) => {
        if (Number.isFinite(range) && range > 0 && range < reach * 0.995) pen.fillRect(view.x(x + Math.cos(angle(i)) * range) - 1.25, view.y(y + Math.sin(angle(i)) * range) - 1.25, 2.5, 2.5);
    });
}
function paint(pen: CanvasRenderingContext2D, view: View, seen: readonly Seen[], plan: Floor | undefined, colour: Colour): void {
    paintGrid(pen, view, colour);
    const places = seen.map(placeOf);
    const at = performance.now();
    for (const place of places) {
        for (const { scan, at: then } of place.live?.scans.values() ?? []) if (!isOld(then, at)) paintFan(pen, view, place, scan, colour(scan.ranges.length <= 32 ? "--plot-2" : "--accent"));
    }
    if (plan !== undefined) paintFloor(pen, view, plan, colour);
    places.forEach(({ live }, i) => {
        if (live === undefined || live.trail.length < 2) return;
        pen.strokeStyle = colour(`--plot-${(i % 6) + 1}`);
        pen.lineWidth = 2;
        pen.setLineDash([5, 4]);
        pen.beginPath();
        live.trail.forEach((one, at) => (at === 0 ? pen.moveTo(view.x(one.x), view.y(one.y)) : pen.lineTo(view.x(one.x), view.y(one.y))));
        pen.stroke();
        pen.setLineDash([]);
    });
}

function boxOf(before: Box | undefined, place: Place, at: number): Box {
    // The trail grows at the robot, which is in the box anyway.
    const driven = before ?? place.live?.trail.reduce<Box | undefined>((box, one) => boxAround(box, one, []), undefined);
    return boxAround(driven, place, endsOf(place, at));
}
async function choose(file: File | undefined): Promise<void> {
    if (file === undefined) return;
    const why = await openFloor(file);
    if (why !== undefined) say("bad", `${file.name} is not shown.`, why);
}

export function LabMap({ seen }: { readonly seen: readonly Seen[] }): preact.JSX.Element {
    const box = useRef<HTMLDivElement>(null);
    const canvas = useRef<HTMLCanvasElement>(null);
    const [size, setSize] = useState({ wide: 0, high: 0 });
    const fresh = seen.filter((one) => one.fresh || silent.value);
    useLive(fresh.slice(0, LIVE_MAX).map(({ entity }) => entity.id), MAPPED, LABELS_MS);
    const plan = floor.value;
    const places = seen.map(placeOf);
    const { wide, high } = size;
    const at = performance.now();
    // Without walls, what is seen and driven is in the picture. Walls are around all of that.
    const boxes = useRef<ReadonlyMap<string, Box>>(new Map());
    if (plan !== undefined) boxes.current = new Map();
    else boxes.current = new Map(seen.map(({ entity }, i) => [entity.id, boxOf(boxes.current.get(entity.id), places[i] as Place, at)]));
    const corners = [...boxes.current.values()].flatMap(({ low, high: top }) => [low, top]);
    const view = viewOf([...places, ...corners], plan?.lines, Math.max(wide, 1), Math.max(high, 1));
    const latest = useRef({ seen, view, plan });
    latest.current = { seen, view, plan };
    useEffect(() => {
        const place = box.current;
        if (place === null) return undefined;
        const observer = new ResizeObserver(() => setSize({ wide: place.clientWidth, high: place.clientHeight }));
        observer.observe(place);
        let frame = 0;
        const timer = setInterval(() => {
            cancelAnimationFrame(frame);
            frame = requestAnimationFrame(() => {
                const its = latest.current;
                if (canvas.current !== null) draw(canvas.current, (pen, _wide, _high, colour) => paint(pen, its.view, its.seen, its.plan, colour));
            });
        }, DRAW_MS);
        return () => {
            observer.disconnect();
            clearInterval(timer);
            cancelAnimationFrame(frame);
        };
    }, []);
    // Several at one place stand beside each other.
    const taken = new Map<string, number>();
    return (
        <figure class="map">
            <div
                class="plane"
                ref={box}
                onDragOver={(event) => event.preventDefault()}
                onDrop={(event) => {
                    event.preventDefault();
                    void choose(event.dataTransfer?.files[0]);
                }}
            >
                <canvas ref={canvas} aria-hidden="true" />
                <svg viewBox={`0 0 ${Math.max(wide, 1)} ${Math.max(high, 1)}`} role="group" aria-label="Map of the laboratory">
                    {wide > 0 &&
                        seen.map(({ entity, fresh: current }, i) => {
                            const its = places[i] ?? { x: 0, y: 0, yaw: undefined, live: undefined };
                            const x = view.x(its.x);
                            const y = view.y(its.y);
                            const square = `${Math.round(x / 12)} ${Math.round(y / 12)}`;
                            const before = taken.get(square) ?? 0;
                            taken.set(square, before + 1);
                            const { tone, short } = plainState(entity);
                            const back = x > wide * 0.75;
                            const ago = its.live === undefined ? "" : agoOf(its.live.poseAt, at);
                            return (
                                <g key={entity.id} transform={`translate(${x.toFixed(1)} ${(y + before * (y > high * 0.7 ? -30 : 30)).toFixed(1)})`}>
                                    <a href={linkTo("entity", entity.id)} class={`spot ${tone} ${current && ago === "" ? "" : "stale"}`} data-spot={entity.name} data-live={its.yaw === undefined ? "no" : ago === "" ? "yes" : "old"} aria-label={`${entity.name}, ${short}${ago === "" ? "" : `, where it was ${ago}`}`}>
                                        <circle r={Math.max(entity.type === "MOBILE" ? 11 : 9, Math.min(view.scale * 0.22, 26))} />
                                        {its.yaw !== undefined && <path class="nose" d="M10 0L-6 6L-3 0L-6 -6Z" transform={`rotate(${((-its.yaw * 180) / Math.PI).toFixed(1)})`} />}
                                        <text x={back ? -Math.max(17, view.scale * 0.22 + 6) : Math.max(17, Math.min(view.scale * 0.22, 26) + 6)} y="5" text-anchor={back ? "end" : "start"}>
                                            {entity.name.slice(0, 24)}
                                            <tspan class="mark" dx="5">
                                                {tone === "good" ? short : `${marks[tone]} ${short}`}
                                                {ago !== "" && ` · here ${ago}`}
                                            </tspan>
                                        </text>
                                    </a>
                                </g>
                            );
                        })}
                </svg>
            </div>
            <figcaption class="quiet">
                <span>
                    One square is {formatNumber(view.step)} m. An arrow is a robot that sends where it is; a grey one has not done so for 2 s. The others stand where their profile says. Blue: seen by lasers. Orange: by sonars. Dashed: driven.
                </span>
                <span class="row">
                    <label class="button">
                        {plan === undefined ? "Show walls from a map file" : "Another map file"}
                        <input class="unseen" type="file" onChange={(event) => (void choose(event.currentTarget.files?.[0]), (event.currentTarget.value = ""))} />
                    </label>
                    {plan !== undefined && (
                        <button type="button" onClick={closeFloor}>
                            Without {plan.name}
                        </button>
                    )}
                </span>
            </figcaption>
        </figure>
    );
}
