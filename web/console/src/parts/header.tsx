// SPDX-License-Identifier: GPL-2.0-or-later
import { useState } from "preact/hooks";
import { holds } from "../state/holds";
import { linkTo, type Page, page, route } from "../state/route";
import { client, connection, logout, ownName, reachable, rename, user } from "../state/session";
import { latched } from "../state/entities";
import { formatCount } from "../words/format";
import { ServerButton } from "./server_button";
import { nextTheme, theme } from "./theme";

const roles = { observer: "may look and stop", operator: "may check out robots", admin: "may do everything" } as const;
const themes = { auto: "◐ as the system", dark: "● dark", light: "○ light" } as const;

function Link({ to, children, count }: { readonly to: Page; readonly children: string; readonly count?: number }): preact.JSX.Element {
    const here = page.value === to || (to === "laboratory" && page.value === "entity");
    return (
        <a href={linkTo(to)} aria-current={here ? "page" : undefined}>
            {children}
            {count !== undefined && count > 0 && <span class="count">{formatCount(count)}</span>}
        </a>
    );
}

function Account(): preact.JSX.Element {
    const [editing, setEditing] = useState(false);
    const role = client.value?.self.role ?? "observer";
    if (user.value !== "") {
        return (
            <span class="account">
                <span title={roles[role]}>
                    {user.value} <span class="quiet">({role})</span>
                </span>
                <button type="button" class="plain" onClick={() => void logout()}>
                    Log out
                </button>
            </span>
        );
    }
    if (!editing) {
        return (
            <button type="button" class="plain" title={`Others see this name. You are ${role}: ${roles[role]}.`} onClick={() => setEditing(true)}>
                <span class="unseen">Your name: </span>
                {ownName.value} <span class="quiet">({role})</span>
            </button>
        );
    }
    return (
        <form
            class="account"
            onSubmit={(event) => {
                event.preventDefault();
                const name = new FormData(event.currentTarget).get("name");
                setEditing(false);
                if (typeof name === "string" && name.trim() !== "" && name.trim() !== ownName.value) rename(name);
            }}
        >
            <label class="unseen" for="own-name">
                Your name, as others see it
            </label>
            <input id="own-name" name="name" maxLength={40} defaultValue={ownName.value} autofocus />
            <ServerButton type="submit" title={holds.value.size > 0 ? "What you hold is released" : undefined}>
                {holds.value.size > 0 ? "Change, and release what I hold" : "Change"}
            </ServerButton>
        </form>
    );
}

export function Header(): preact.JSX.Element {
    const report = connection.value;
    const good = reachable.value;
    const kind = report?.silent === true ? "silent" : (report?.kind ?? "none");
    return (
        <header class="top">
            <a class="brand" href={linkTo("laboratory")} aria-label="Axon, to the laboratory">
                <img src="./icon.svg" alt="" width="26" height="26" />
                Axon
            </a>
            <nav aria-label="Pages">
                <Link to="laboratory">Laboratory</Link>
                <Link to="collaboration">Collaboration</Link>
                <Link to="activity">Activity</Link>
                <Link to="stop" count={latched.value.length}>
                    Stop
                </Link>
            </nav>
            <div class="corner">
                <span class={`line ${good ? "good" : "bad"}`} data-connection={kind} title={good ? "Connected to the server" : kind === "silent" ? "The server does not answer" : report?.reason}>
                    <span aria-hidden="true">{good ? "●" : "▲"}</span> {good ? "connected" : kind === "silent" ? "no answer" : "no connection"}
                </span>
                <Account key={route.value.page} />
                <button type="button" class="plain" onClick={nextTheme} aria-label={`Colours: ${themes[theme.value].slice(2)}. Change`} title={`Colours: ${themes[theme.value].slice(2)}`}>
                    {themes[theme.value].slice(0, 1)}
                </button>
            </div>
        </header>
    );
}
