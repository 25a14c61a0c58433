// SPDX-License-Identifier: GPL-2.0-or-later
import { useEffect, useRef } from "preact/hooks";
import type uPlot from "uplot";
import { formatNumber } from "../words/format";

/** Seconds since 1970, and a row for each line. It grows in place. */
export interface Series {
    readonly times: number[];
    readonly values: (number | null)[][];
}
const DRAW_MS = 100;
const HIGH = 190;
const load = async (): Promise<typeof uPlot> => (await Promise.all([import("uplot"), import("uplot/dist/uPlot.min.css")]))[0].default;
export function loadPlots(): void {
    load().catch(() => undefined);
}

/** Of numbers over time. The library for it is loaded when it is wanted first. */
export function Plot({ series, label }: { readonly series: Series; readonly label: string }): preact.JSX.Element {
    const place = useRef<HTMLDivElement>(null);
    useEffect(() => {
        let plot: uPlot | undefined;
        let lines = 0;
        let ended = false;
        let timer: ReturnType<typeof setInterval> | undefined;
        void load().then((Plotter) => {
            const make = (): void => {
                const box = place.current;
                if (box === null) return;
                plot?.destroy();
                lines = series.values.length;
                const style = getComputedStyle(box);
                const colour = (name: string): string => style.getPropertyValue(name).trim();
                const axis = { stroke: colour("--quiet"), grid: { stroke: colour("--line"), width: 1 }, ticks: { show: false }, font: "11px system-ui, sans-serif" };
                plot = new Plotter(
                    {
                        width: box.clientWidth,
                        height: HIGH,
                        legend: { show: false },
                        cursor: { drag: { x: false, y: false } },
                        scales: { x: { time: true } },
                        series: [{}, ...Array.from({ length: lines }, (_, i) => ({ stroke: colour(`--plot-${(i % 6) + 1}`), width: 1.5, points: { show: false } }))],
                        axes: [
                            { ...axis, size: 24, values: (_: uPlot, ticks: number[]) => ticks.map((one) => new Date(one * 1000).toLocaleTimeString([], { minute: "2-digit", second: "2-digit" })) },
                            { ...axis, size: 52, values: (_: uPlot, ticks: number[]) => ticks.map(formatNumber) },
                        ],
                    },
                    [[], ...Array.from({ length: lines }, () => [])],
                    box,
                );
            };
            const step = (): void => {
                const box = place.current;
                if (ended || box === null || series.values.length === 0) return;
                if (plot === undefined || lines !== series.values.length) make();
                if (plot !== undefined && Math.abs(plot.width - box.clientWidth) > 1) plot.setSize({ width: box.clientWidth, height: HIGH });
                plot?.setData([series.times, ...series.values] as uPlot.AlignedData);
            };
            if (ended) return;
            step();
            timer = setInterval(() => requestAnimationFrame(step), DRAW_MS * 2);
        });
        return () => {
            ended = true;
            clearInterval(timer);
            plot?.destroy();
        };
    }, [series]);
    return <div class="plot" ref={place} role="img" aria-label={`${label} over time`} />;
}
