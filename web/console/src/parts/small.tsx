// SPDX-License-Identifier: GPL-2.0-or-later
import type { Entity } from "@axon/client";
import type { ComponentChildren } from "preact";
import { useId } from "preact/hooks";
import { now } from "../state/clock";
import { formatDate, formatSpan } from "../words/format";
import { marks, plainState, type Tone } from "../words/words";

type Element = preact.JSX.Element;

/** "3 min": how long since then. */
export function Age({ at }: { readonly at: number }): Element {
    return (
        <time dateTime={new Date(at).toISOString()} title={formatDate(at)}>
            {formatSpan(now.value - at)}
        </time>
    );
}

export function Badge({ tone, children, title }: { readonly tone: Tone; readonly children: ComponentChildren; readonly title?: string }): Element {
    return (
        <span class={`badge ${tone}`} title={title}>
            <span aria-hidden="true">{marks[tone]}</span> {children}
        </span>
    );
}
/** The token of the state, and what it means. */
export function StateBadge({ entity }: { readonly entity: Entity }): Element {
    const { tone, short, long } = plainState(entity);
    return (
        <Badge tone={tone} title={long}>
            {short} <span class="token">{entity.state}</span>
        </Badge>
    );
}

export function Progress({ value, label }: { readonly value: number | undefined; readonly label: string }): Element {
    const known = value !== undefined && Number.isFinite(value);
    return (
        <div class={`progress ${known ? "" : "unknown"}`} role="progressbar" aria-label={label} aria-valuemin={0} aria-valuemax={100} {...(known ? { "aria-valuenow": Math.round(value * 100) } : {})}>
            <div style={{ width: `${known ? Math.min(Math.max(value, 0), 1) * 100 : 100}%` }} />
        </div>
    );
}

interface SelectProps<Key extends string> {
    readonly label: string;
    readonly value: Key;
    readonly options: readonly (readonly [Key, string])[];
    readonly onChange: (value: Key) => void;
    readonly hideLabel?: boolean;
}
export function Select<Key extends string>({ label, value, options, onChange, hideLabel }: SelectProps<Key>): Element {
    const id = useId();
    return (
        <span class="labelled">
            <label for={id} class={hideLabel === true ? "unseen" : ""}>
                {label}
            </label>
            <select id={id} value={value} onChange={(event) => onChange(event.currentTarget.value as Key)}>
                {options.map(([key, text]) => (
                    <option key={key} value={key}>
                        {text}
                    </option>
                ))}
            </select>
        </span>
    );
}

export function Empty({ children }: { readonly children: ComponentChildren }): Element {
    return <div class="empty">{children}</div>;
}
