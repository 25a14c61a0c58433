// SPDX-License-Identifier: GPL-2.0-or-later
import type { JSX } from "preact";
import { reachable } from "../state/session";

export const NOT_NOW = "Not possible while the server does not answer.";

/**
 * A button for what only the server can do: it does nothing while the server does not answer, and says why. It stays where the
 * keyboard is, because the server may be back in a moment. The buttons that stop robots are none of these.
 */
export function ServerButton({ onClick, title, ...more }: JSX.ButtonHTMLAttributes<HTMLButtonElement>): JSX.Element {
    const away = !reachable.value;
    return (
        <button
            type="button"
            {...more}
            title={away ? NOT_NOW : title}
            aria-disabled={away ? "true" : more["aria-disabled"]}
            onClick={(event) => {
                // Of a submit button, this is also what the Enter key in a field of its form does.
                if (away) event.preventDefault();
                else onClick?.(event);
            }}
        />
    );
}
