// SPDX-License-Identifier: GPL-2.0-or-later
import { useEffect, useState } from "preact/hooks";
import { holds } from "../state/holds";
import { client } from "../state/session";
import { formatClock, formatSpan } from "../words/format";
import { sentence } from "../words/words";

const LOOK_MS = 250;
/** At rest the server sends a sign of life every 2 s. */
const SILENT_MS = 3500;

/** Says that there is no connection, for how long, and what that means. */
export function Banner(): preact.JSX.Element | null {
    const its = client.value;
    const [report, setReport] = useState(its?.connection());
    useEffect(() => {
        if (its === undefined) return undefined;
        const look = (): void => setReport(its.connection());
        const end = its.onConnection(look);
        const timer = setInterval(look, LOOK_MS);
        return () => {
            end();
            clearInterval(timer);
        };
    }, [its]);
    if (report === undefined || report.kind === "closed") return null;
    if (report.kind === "connected") {
        if (report.silentMs < SILENT_MS) return null;
        return (
            <div class="banner wait" role="status">
                <strong>The server has been silent for {formatSpan(report.silentMs)}.</strong> What you see may be old.
            </div>
        );
    }
    const mine = [...holds.value.values()].map((hold) => hold.entity.name);
    return (
        <div class="banner bad" role="alert">
            <strong>No connection to the server</strong> <span aria-hidden="true">for {formatSpan(report.ageMs)}</span>. What you see is from {formatClock(Date.now() - report.ageMs)}.{" "}
            {mine.length > 0 && `The server stops what you hold (${mine.join(", ")}) by itself. `}
            Stops from this page may not arrive: use the emergency stop of the robot itself. <span class="quiet">{sentence(report.reason)} Trying again{report.nextTryMs === undefined ? " now" : ""}.</span>
        </div>
    );
}
