// SPDX-License-Identifier: GPL-2.0-or-later
import { useEffect, useState } from "preact/hooks";
import { holds } from "../state/holds";
import { client, connection, heardAt } from "../state/session";
import { formatClock, formatSpan } from "../words/format";
import { heldMeanwhile, sentence } from "../words/words";

const LOOK_MS = 250;

/** Says that the server does not answer or is not connected, since when, and what that means. */
export function Banner(): preact.JSX.Element | null {
    const since = heardAt.value;
    const its = client.value;
    const [, redraw] = useState(0);
    const shown = since !== undefined;
    useEffect(() => {
        if (!shown) return undefined;
        const timer = setInterval(() => redraw((count) => count + 1), LOOK_MS);
        return () => clearInterval(timer);
    }, [shown]);
    const kind = connection.value?.kind;
    if (since === undefined || its === undefined || kind === undefined || kind === "closed") return null;
    const report = its.connection();
    const mine = [...holds.value.values()].map((hold) => hold.entity.name);
    // What changes by itself is hidden from screen readers, which would read it out again and again.
    if (kind === "connected") {
        return (
            <div class="banner wait" role="alert">
                <strong>The server does not answer</strong>
                <span aria-hidden="true">: nothing for {formatSpan(Math.max(Date.now() - since, 0))}</span>. What you see is from {formatClock(since)}. {heldMeanwhile(mine, true)}
                Stops from this page may arrive late or not at all: use the emergency stop of the robot itself.
            </div>
        );
    }
    return (
        <div class="banner bad" role="alert">
            <strong>No connection to the server</strong> <span aria-hidden="true">for {formatSpan(Math.max(Date.now() - since, 0))}</span>. What you see is from {formatClock(since)}. {heldMeanwhile(mine, false)}
            Stops from this page may not arrive: use the emergency stop of the robot itself.{" "}
            <span class="quiet">
                {sentence(report.reason)} <span aria-hidden="true">Trying again{report.nextTryMs === undefined ? " now" : ""}.</span>
            </span>
        </div>
    );
}
