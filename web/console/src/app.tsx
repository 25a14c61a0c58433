// SPDX-License-Identifier: GPL-2.0-or-later
import { useEffect, useRef } from "preact/hooks";
import { ActivityPage } from "./pages/activity";
import { CollaborationPage } from "./pages/collaboration";
import { EntityPage } from "./pages/entity";
import { LaboratoryPage } from "./pages/laboratory";
import { LoginPage } from "./pages/login";
import { StopPage } from "./pages/stop";
import { Banner } from "./parts/banner";
import { Dock } from "./parts/dock";
import { Header } from "./parts/header";
import { Notices, Questions } from "./parts/notices";
import { route } from "./state/route";
import { client, phase, problem } from "./state/session";
import { chosen, putAway } from "./state/stops";
import { sentence } from "./words/words";

function Current(): preact.JSX.Element {
    const { page, subject } = route.value;
    switch (page) {
        case "entity":
            return <EntityPage key={subject} id={subject} />;
        case "collaboration":
            return <CollaborationPage />;
        case "activity":
            return <ActivityPage />;
        case "stop":
            return <StopPage />;
        default:
            return <LaboratoryPage />;
    }
}

function Connecting(): preact.JSX.Element {
    return (
        <main class="page alone" aria-busy="true">
            <h1>Connecting to the laboratory …</h1>
            {problem.value !== "" && (
                <>
                    <p role="alert">{sentence(problem.value)}</p>
                    <p class="quiet">The page tries again by itself. If this does not end: is axon-server running, and is the port of the console's sessions reachable from here?</p>
                </>
            )}
        </main>
    );
}

export function App(): preact.JSX.Element {
    const main = useRef<HTMLElement>(null);
    const first = useRef(true);
    const { page, subject } = route.value;
    useEffect(() => {
        chosen.value = undefined; // what the button stops is never left over from another page
        putAway();
        if (first.current) first.current = false;
        else main.current?.focus({ preventScroll: true });
        scrollTo(0, 0);
    }, [page, subject]);
    if (phase.value === "login") return <LoginPage />;
    if (client.value === undefined) return <Connecting />;
    return (
        <>
            <a class="skip" href="#main" onClick={(event) => (event.preventDefault(), main.current?.focus())}>
                Skip to the content
            </a>
            <div class="overhead">
                <Header />
                <Banner />
                <Questions />
            </div>
            <main ref={main} id="main" class={`page of-${page}`} tabIndex={-1}>
                <Current />
            </main>
            <Notices />
            <Dock />
        </>
    );
}
