// SPDX-License-Identifier: GPL-2.0-or-later
// The streams of an entity, each drawn as what it is. Samples arrive as they like; drawing follows the screen.
import type { Picture, Sample } from "@axon/client";
import { useEffect, useRef, useState } from "preact/hooks";
import { client } from "../state/session";
import { formatCount, formatNumber, formatRough } from "../words/format";
import { draw, paintScan, paintTrail } from "./paint";
import { Empty } from "./small";
import { Plot, type Series } from "./plot";

const STREAMS_MAX = 48;
const TRAIL_MAX = 2000;
const HISTORY_MAX = 1200;
const VECTOR_MAX = 12;
const GAP_MS = 3000;

/** What is kept of one stream. It changes in place, and is looked at once for each picture of the screen. */
class Channel {
    last: Sample;
    count = 0;
    dropped = 0;
    readonly series: Series = { times: [], values: [] };
    readonly trail: { x: number; y: number }[] = [];
    private window: number[] = [];

    constructor(first: Sample) {
        this.last = first;
        this.take(first);
    }
    take(sample: Sample): void {
        if (this.count > 0 && sample.sequence > this.last.sequence + 1) this.dropped += sample.sequence - this.last.sequence - 1;
        this.last = sample;
        ++this.count;
        this.window.push(performance.now());
        if (this.window.length > 40) this.window = this.window.slice(-20);
        const { content } = sample;
        if (content.kind === "scalar" || content.kind === "vector") {
            const values = content.kind === "scalar" ? [content.value] : content.values.slice(0, VECTOR_MAX);
            const { times, values: rows } = this.series;
            if (rows.length !== values.length) {
                times.length = 0;
                rows.length = 0;
                for (const _ of values) rows.push([]);
            }
            times.push(Date.now() / 1000);
            values.forEach((value, i) => rows[i]?.push(Number.isFinite(value) ? value : null));
            if (times.length > HISTORY_MAX) {
                times.splice(0, HISTORY_MAX / 4);
                for (const row of rows) row.splice(0, HISTORY_MAX / 4);
            }
        } else if (content.kind === "pose") {
            const before = this.trail.at(-1);
            if (before === undefined || Math.hypot(before.x - content.x, before.y - content.y) > 0.005) this.trail.push({ x: content.x, y: content.y });
            if (this.trail.length > TRAIL_MAX) this.trail.splice(0, TRAIL_MAX / 4);
        }
    }
    get rate(): number {
        const { window } = this;
        const span = (window.at(-1) ?? 0) - (window[0] ?? 0);
        return window.length > 2 && span > 0 ? ((window.length - 1) * 1000) / span : 0;
    }
}

const types: Readonly<Record<string, string>> = { jpeg: "image/jpeg", jpg: "image/jpeg", png: "image/png", webp: "image/webp" };
const PIXELS_MAX = 4096 * 4096;
/** Nothing if this browser cannot show it. */
async function decoded({ width, height, encoding, pixels }: Picture): Promise<ImageBitmap | undefined> {
    const type = types[encoding.toLowerCase()];
    try {
        if (type !== undefined) return await createImageBitmap(new Blob([pixels as Uint8Array<ArrayBuffer>], { type }));
        const bytes = ({ rgb8: 3, bgr8: 3, rgba8: 4, bgra8: 4, mono8: 1 } as Readonly<Record<string, number>>)[encoding];
        if (bytes === undefined || width < 1 || height < 1 || width * height > PIXELS_MAX || pixels.length < width * height * bytes) return undefined;
        const image = new ImageData(width, height);
        const swap = encoding.startsWith("bgr") ? 2 : 0;
        for (let i = 0, from = 0; i < width * height; ++i, from += bytes) {
            image.data[4 * i] = pixels[from + (bytes === 1 ? 0 : swap)] ?? 0;
            image.data[4 * i + 1] = pixels[from + (bytes === 1 ? 0 : 1)] ?? 0;
            image.data[4 * i + 2] = pixels[from + (bytes === 1 ? 0 : 2 - swap)] ?? 0;
            image.data[4 * i + 3] = 255;
        }
        return await createImageBitmap(image);
    } catch {
        return undefined;
    }
}

function Drawing({ channel, label }: { readonly channel: Channel; readonly label: string }): preact.JSX.Element {
    const canvas = useRef<HTMLCanvasElement>(null);
    const [cannot, setCannot] = useState("");
    useEffect(() => {
        let drawn: Sample | undefined;
        let frame = 0;
        let decoding = false;
        const step = (): void => {
            frame = requestAnimationFrame(step);
            const place = canvas.current;
            const { last } = channel;
            if (place === null || last === drawn || decoding) return;
            drawn = last;
            const { content } = last;
            if (content.kind === "scan") draw(place, (pen, wide, high, colour) => paintScan(content, pen, wide, high, colour));
            if (content.kind === "pose") draw(place, (pen, wide, high, colour) => paintTrail(content, channel.trail, pen, wide, high, colour));
            if (content.kind === "picture") {
                decoding = true;
                void decoded(content).then((bitmap) => {
                    decoding = false;
                    setCannot(bitmap === undefined ? `A picture in ${content.encoding.slice(0, 40)} cannot be shown here.` : "");
                    if (bitmap === undefined) return;
                    if (place.width !== bitmap.width || place.height !== bitmap.height) {
                        place.width = bitmap.width;
                        place.height = bitmap.height;
                    }
                    place.getContext("2d")?.drawImage(bitmap, 0, 0);
                    bitmap.close();
                });
            }
        };
        frame = requestAnimationFrame(step);
        return () => cancelAnimationFrame(frame);
    }, [channel]);
    return (
        <>
            <canvas ref={canvas} class={channel.last.content.kind} role="img" aria-label={label} />
            {cannot !== "" && <p class="quiet">{cannot}</p>}
        </>
    );
}

function valueOf({ content }: Sample): string {
    switch (content.kind) {
        case "scalar":
            return `${formatNumber(content.value)}${content.units === "" ? "" : ` ${content.units}`}`;
        case "vector":
            return `${content.values.slice(0, 4).map(formatRough).join(" · ")}${content.values.length > 4 ? " …" : ""}${content.units === "" ? "" : ` ${content.units}`}`;
        case "pose":
            return `x ${formatNumber(Math.round(content.x * 1000) / 1000)} m, y ${formatNumber(Math.round(content.y * 1000) / 1000)} m, ${formatNumber(Math.round((content.yaw * 1800) / Math.PI) / 10)}°`;
        case "scan":
            return `${formatCount(content.ranges.length)} beams, nearest ${formatNumber(Math.round(Math.min(...content.ranges.filter((one) => one > 0), Infinity) * 100) / 100)} m`;
        case "picture":
            return `${content.width} × ${content.height}`;
        default:
            return `${formatCount(content.bytes.length)} bytes: ${[...content.bytes.slice(0, 12)].map((one) => one.toString(16).padStart(2, "0")).join(" ")}${content.bytes.length > 12 ? " …" : ""}`;
    }
}
const icons = { scalar: "number", vector: "numbers", pose: "position", scan: "distances", picture: "camera", raw: "bytes" } as const;

function Tile({ name, channel }: { readonly name: string; readonly channel: Channel }): preact.JSX.Element {
    const { last } = channel;
    const old = performance.now() - last.arrivedAtMs;
    const { kind } = last.content;
    return (
        <section class={`card stream ${old > GAP_MS ? "stale" : ""}`} aria-label={`Stream ${name}`} data-stream={name} data-kind={kind}>
            <div class="head">
                <h3>{name}</h3>
                <span class="quiet">
                    {icons[kind]}
                    {old > GAP_MS ? `, ${formatCount(old / 1000)} s old` : channel.rate > 0 ? `, ${formatNumber(Math.round(channel.rate * 10) / 10)} in a second` : ""}
                    {channel.dropped > 0 && `, ${formatCount(channel.dropped)} left out`}
                </span>
            </div>
            <p class={kind === "scalar" ? "reading" : "values"}>{valueOf(last)}</p>
            {(kind === "scan" || kind === "pose" || kind === "picture") && <Drawing channel={channel} label={`${name}, ${icons[kind]}`} />}
            {(kind === "scalar" || kind === "vector") && <Plot series={channel.series} label={name} />}
        </section>
    );
}

export function Streams({ id }: { readonly id: string }): preact.JSX.Element {
    const channels = useRef(new Map<string, Channel>());
    const [, redraw] = useState(0);
    const [left, setLeft] = useState(0);
    const its = client.value;
    useEffect(() => {
        if (its === undefined) return undefined;
        let changed = false;
        let end: (() => void) | undefined;
        try {
            end = its.watch(id, [], (sample) => {
                const channel = channels.current.get(sample.stream);
                changed = true;
                if (channel !== undefined) channel.take(sample);
                else if (channels.current.size < STREAMS_MAX) channels.current.set(sample.stream, new Channel(sample));
                else setLeft((count) => count + 1);
            });
        } catch {
            // it is not there now
        }
        let rounds = 0;
        const timer = setInterval(() => {
            if (changed || ++rounds % 5 === 0) redraw((count) => count + 1);
            changed = false;
        }, 200);
        return () => {
            end?.();
            clearInterval(timer);
        };
    }, [its, id]);
    if (channels.current.size === 0) return <Empty>Nothing has been sent yet. What the robot measures appears here as soon as it sends it.</Empty>;
    return (
        <>
            <div class="streams">
                {[...channels.current].sort(([a], [b]) => (a < b ? -1 : 1)).map(([name, channel]) => (
                    <Tile key={`${name} ${channel.last.content.kind}`} name={name} channel={channel} />
                ))}
            </div>
            {left > 0 && <p class="quiet">More than {STREAMS_MAX} streams: the others are not shown.</p>}
        </>
    );
}
