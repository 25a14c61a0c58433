// SPDX-License-Identifier: GPL-2.0-or-later
// Drawings in canvases: what they cost does not depend on what a robot sends.
import type { Pose, Scan } from "@axon/client";
import { formatNumber } from "../words/format";
import { linesBetween, type Point, type View, viewOf } from "./view";

/** A colour of the style sheet, by its name. */
export type Colour = (name: string) => string;

/** Draws into a canvas that is as sharp as the screen. */
export function draw(canvas: HTMLCanvasElement, paint: (pen: CanvasRenderingContext2D, wide: number, high: number, colour: Colour) => void): void {
    const wide = canvas.clientWidth;
    const high = canvas.clientHeight;
    const sharp = devicePixelRatio || 1;
    if (canvas.width !== Math.round(wide * sharp) || canvas.height !== Math.round(high * sharp)) {
        canvas.width = Math.round(wide * sharp);
        canvas.height = Math.round(high * sharp);
    }
    const pen = canvas.getContext("2d");
    if (pen === null || wide === 0) return;
    pen.setTransform(sharp, 0, 0, sharp, 0, 0);
    pen.clearRect(0, 0, wide, high);
    const style = getComputedStyle(canvas);
    paint(pen, wide, high, (name) => style.getPropertyValue(name));
}

export function paintGrid(pen: CanvasRenderingContext2D, view: View, colour: Colour): void {
    const { wide, high, step, scale } = view;
    const left = -view.x(0) / scale;
    const foot = (view.y(0) - high) / scale;
    pen.strokeStyle = colour("--line");
    pen.lineWidth = 1;
    pen.beginPath();
    for (const x of linesBetween(left, left + wide / scale, step)) {
        pen.moveTo(Math.round(view.x(x)) + 0.5, 0);
        pen.lineTo(Math.round(view.x(x)) + 0.5, high);
    }
    for (const y of linesBetween(foot, foot + high / scale, step)) {
        pen.moveTo(0, Math.round(view.y(y)) + 0.5);
        pen.lineTo(wide, Math.round(view.y(y)) + 0.5);
    }
    pen.stroke();
}
export function paintScan(scan: Scan, pen: CanvasRenderingContext2D, wide: number, high: number, colour: Colour): void {
    const angle = (i: number): number => scan.angles[i] ?? scan.startAngle + i * scan.step;
    // As far as something was seen, in whole steps so that the picture does not tremble.
    const reach = scan.maxRange > 0 ? scan.maxRange : Infinity;
    const seen = scan.ranges.reduce((most, range) => (range > most && range < reach ? range : most), 0);
    const limit = [1, 2, 4, 8, 16, 32, 64].find((one) => one >= seen * 1.05) ?? Math.max(seen, 1);
    // The robot looks up. A half circle needs only the upper half.
    const behind = scan.ranges.some((_, i) => Math.cos(angle(i)) < -0.2);
    const scale = Math.min(wide / 2 - 6, behind ? high / 2 - 6 : high - 22) / limit;
    const x0 = wide / 2;
    const y0 = behind ? high / 2 : high - 14;
    pen.strokeStyle = colour("--line");
    pen.fillStyle = colour("--quiet");
    pen.font = "11px system-ui, sans-serif";
    for (let ring = 1; ring <= 4; ++ring) {
        pen.beginPath();
        pen.arc(x0, y0, (limit * ring * scale) / 4, 0, 2 * Math.PI);
        pen.stroke();
        pen.fillText(`${formatNumber((limit * ring) / 4)} m`, x0 + 3, y0 - (limit * ring * scale) / 4 + 12);
    }
    pen.fillStyle = colour("--accent");
    scan.ranges.forEach((range, i) => {
        if (!Number.isFinite(range) || range <= 0 || range > limit) return;
        pen.fillRect(x0 - Math.sin(angle(i)) * range * scale - 1.5, y0 - Math.cos(angle(i)) * range * scale - 1.5, 3, 3);
    });
    pen.fillStyle = colour("--text");
    pen.beginPath();
    pen.moveTo(x0, y0 - 8);
    pen.lineTo(x0 + 5, y0 + 5);
    pen.lineTo(x0 - 5, y0 + 5);
    pen.fill();
}
export function paintTrail(pose: Pose, trail: readonly Point[], pen: CanvasRenderingContext2D, wide: number, high: number, colour: Colour): void {
    const view = viewOf([...trail, pose], undefined, wide, high);
    paintGrid(pen, view, colour);
    pen.fillStyle = colour("--quiet");
    pen.font = "11px system-ui, sans-serif";
    pen.fillText(`One square is ${formatNumber(view.step)} m`, 8, high - 8);
    pen.strokeStyle = colour("--accent");
    pen.lineWidth = 2;
    pen.beginPath();
    trail.forEach(({ x, y }, i) => (i === 0 ? pen.moveTo(view.x(x), view.y(y)) : pen.lineTo(view.x(x), view.y(y))));
    pen.stroke();
    pen.translate(view.x(pose.x), view.y(pose.y));
    pen.rotate(-pose.yaw);
    pen.fillStyle = colour("--text");
    pen.beginPath();
    pen.moveTo(11, 0);
    pen.lineTo(-7, 6);
    pen.lineTo(-7, -6);
    pen.fill();
}
