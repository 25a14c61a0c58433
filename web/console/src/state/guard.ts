// SPDX-License-Identifier: GPL-2.0-or-later
// Nobody watches a robot through a tab that is out of sight. If such a tab holds a robot that moves, the page warns in its
// title, then stops the robot. If the page fails to do that, the heartbeats end, and the server stops it.
import { note, say } from "./journal";
import { moving, stopUnseen } from "./holds";
import { formatClock } from "../words/format";

const WARN_MS = 2000;
/** How long after the warning the page's own stop may take. */
const BACKSTOP_MS = 1500;

const usualTitle = "Axon";
let hiddenAt: number | undefined;
let stoppedAt: number | undefined;
let ticking: ReturnType<typeof setInterval> | undefined;

const hidden = (): boolean => document.visibilityState !== "visible";

/** For Options.keepRunning. */
export function keepRunning(): boolean {
    if (!hidden() || moving().length === 0) return true;
    hiddenAt ??= performance.now();
    return performance.now() - hiddenAt < WARN_MS + BACKSTOP_MS;
}

function tick(): void {
    const names = moving().map(({ name }) => name);
    if (!hidden() || names.length === 0) {
        hiddenAt = hidden() ? undefined : hiddenAt;
        document.title = usualTitle;
        return;
    }
    hiddenAt ??= performance.now();
    const left = WARN_MS - (performance.now() - hiddenAt);
    document.title = `⚠ ${names.join(", ")} stops in ${Math.max(Math.ceil(left / 1000), 0)} s`;
    if (left > 0) return;
    stoppedAt = Date.now();
    document.title = `■ ${names.join(", ")} stopped`;
    note("stop", undefined, `this tab was out of sight, so ${names.join(", ")} was stopped`);
    stopUnseen();
    hiddenAt = undefined;
    say("bad", `${names.join(", ")} was stopped at ${formatClock(stoppedAt)}, because this tab was out of sight.`, "Keep the tab in sight while a robot of yours moves. Rearm the robot when it is safe to move again.");
}

document.addEventListener("visibilitychange", () => {
    clearInterval(ticking);
    hiddenAt = undefined;
    if (hidden()) {
        tick();
        ticking = setInterval(tick, 250);
    } else {
        document.title = usualTitle;
    }
});
