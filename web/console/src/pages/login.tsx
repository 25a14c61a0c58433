// SPDX-License-Identifier: GPL-2.0-or-later
import { useState } from "preact/hooks";
import { login, problem } from "../state/session";

export function LoginPage(): preact.JSX.Element {
    const [trouble, setTrouble] = useState("");
    const [busy, setBusy] = useState(false);
    const submit = async (form: HTMLFormElement): Promise<void> => {
        const data = new FormData(form);
        setBusy(true);
        setTrouble(await login(String(data.get("user") ?? ""), String(data.get("password") ?? "")));
        setBusy(false);
    };
    return (
        <main class="page alone">
            <h1>
                <img src="./icon.svg" alt="" width="36" height="36" /> Axon
            </h1>
            <p>Log in to see the robots of this laboratory.</p>
            {problem.value !== "" && <p role="status">{problem.value}</p>}
            <form
                class="stack"
                onSubmit={(event) => {
                    event.preventDefault();
                    void submit(event.currentTarget);
                }}
            >
                <label for="user">User</label>
                <input id="user" name="user" autocomplete="username" autocapitalize="none" spellcheck={false} required autofocus maxLength={256} />
                <label for="password">Password</label>
                <input id="password" name="password" type="password" autocomplete="current-password" required maxLength={1024} />
                {trouble !== "" && (
                    <p class="bad" role="alert">
                        {trouble}
                    </p>
                )}
                <button type="submit" class="primary" disabled={busy}>
                    {busy ? "Logging in …" : "Log in"}
                </button>
            </form>
            <p class="quiet">No user yet? The administrator of the laboratory adds one: axon-server --users FILE --add-user NAME</p>
        </main>
    );
}
