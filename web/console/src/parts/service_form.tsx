// SPDX-License-Identifier: GPL-2.0-or-later
// A form made from the profile of a service. Nothing here knows any service.
import { acceptValue, type Argument, type Entity, parseValue, Refusal, type Parameter, type Resource, type Service, type Value } from "@axon/client";
import { useId, useState } from "preact/hooks";
import { openFloor } from "../state/floor";
import type { Hold } from "../state/holds";
import { reachable } from "../state/session";
import { fieldText, formatBytes, formatNumber, formatValue, formatValues, plainNumber } from "../words/format";
import { plainLoss, sentence } from "../words/words";
import { NOT_NOW, ServerButton } from "./server_button";
import { Badge, Progress } from "./small";

const LIST_MAX = 100;

interface Read {
    readonly values: readonly Value[];
    /** What is wrong with the text; empty = nothing. */
    readonly wrong: string;
}
/** What a field's text means for a parameter. An empty field means no value. */
export function readField(meta: Parameter, text: string): Read {
    const texts = meta.multiple ? text.split("\n").filter((line) => line.trim() !== "") : text === "" ? [] : [text];
    const numeric = meta.dataType === "INT" || meta.dataType === "DBL";
    try {
        return { values: texts.map((one) => acceptValue(meta, parseValue(meta, numeric ? plainNumber(one) : one))), wrong: "" };
    } catch (error) {
        if (!(error instanceof Refusal)) throw error;
        const limits = limitsOf(meta);
        const what = meta.dataType === "INT" ? "a whole number" : meta.dataType === "DBL" ? "a number" : meta.dataType === "BOOL" ? "yes or no" : "a text";
        return { values: [], wrong: error.code === "TOO_LARGE" ? error.message : `Expected ${what}${limits === "" ? "" : `, ${limits}`}.` };
    }
}
export function limitsOf({ minimum, maximum, units }: Parameter): string {
    const unit = units === "" ? "" : ` ${units}`;
    if (minimum !== undefined && maximum !== undefined) return `${formatNumber(minimum)} to ${formatNumber(maximum)}${unit}`;
    if (minimum !== undefined) return `at least ${formatNumber(minimum)}${unit}`;
    return maximum !== undefined ? `at most ${formatNumber(maximum)}${unit}` : "";
}
const firstText = (meta: Parameter): string => meta.values.map(fieldText).join("\n");
/** A task needs it, and neither the field nor the profile has a value. */
export const isMissing = (meta: Parameter, text: string): boolean => meta.required && meta.values.length === 0 && text.trim() === "";

interface FieldProps {
    readonly meta: Parameter;
    readonly text: string;
    readonly touched: boolean;
    readonly disabled?: boolean;
    readonly onText: (text: string) => void;
}
function Field({ meta, text, touched, onText, disabled }: FieldProps): preact.JSX.Element {
    const id = useId();
    const { wrong } = readField(meta, text);
    const missing = isMissing(meta, text);
    const trouble = wrong !== "" ? wrong : missing && touched ? "This is required." : "";
    const common = {
        id,
        disabled,
        "aria-describedby": `${id}-about`,
        "aria-invalid": trouble !== "" ? ("true" as const) : undefined,
        "aria-required": meta.required ? ("true" as const) : undefined,
    };
    const numeric = meta.dataType === "INT" || meta.dataType === "DBL";
    const span = meta.minimum !== undefined && meta.maximum !== undefined && numeric && !meta.multiple ? { min: meta.minimum, max: meta.maximum } : undefined;
    const read = (event: { readonly currentTarget: { readonly value: string } }): void => onText(event.currentTarget.value);
    const choices: readonly (readonly [string, string])[] =
        meta.choices.length > 0
            ? meta.choices.slice(0, LIST_MAX).map((one) => [fieldText(one), formatValue(one)] as const)
            : meta.dataType === "BOOL" && !meta.multiple
              ? ([
                    ["true", "yes"],
                    ["false", "no"],
                ] as const)
              : [];
    const hints = [limitsOf(meta), meta.multiple ? "one value on each line" : "", meta.savable && meta.kind === "INPUT" ? "kept after the task" : ""].filter((one) => one !== "");
    return (
        <div class={`field ${trouble !== "" ? "wrong" : ""}`}>
            <label for={id}>
                {meta.name}
                {meta.units !== "" && <span class="quiet"> in {meta.units}</span>}
                {meta.required && <span class="required"> required</span>}
            </label>
            {choices.length > 0 && !meta.multiple ? (
                <select {...common} value={text} onChange={read}>
                    {(!meta.required || text === "") && <option value="">{meta.required ? "choose …" : "(not given)"}</option>}
                    {choices.map(([value, shown]) => (
                        <option key={value} value={value}>
                            {shown}
                        </option>
                    ))}
                </select>
            ) : meta.multiple ? (
                <textarea {...common} rows={3} value={text} onInput={read} spellcheck={false} />
            ) : (
                <span class="with-range">
                    <input {...common} value={text} onInput={read} inputMode={meta.dataType === "INT" ? (meta.minimum !== undefined && meta.minimum >= 0 ? "numeric" : "text") : meta.dataType === "DBL" ? "decimal" : "text"} autocomplete="off" spellcheck={false} />
                    {span !== undefined && span.max > span.min && (
                        <input type="range" disabled={disabled} tabIndex={-1} aria-hidden="true" min={span.min} max={span.max} step={meta.dataType === "INT" ? Math.max(Math.round((span.max - span.min) / 200), 1) : (span.max - span.min) / 200} value={wrong === "" && text !== "" ? plainNumber(text) : span.min} onInput={read} />
                    )}
                </span>
            )}
            <span id={`${id}-about`} class="about">
                {trouble !== "" && <strong class="bad">{trouble} </strong>}
                {meta.descr !== "" && <span>{sentence(meta.descr)} </span>}
                {trouble === "" && hints.length > 0 && <span class="quiet">{sentence(hints.join(", "))}</span>}
            </span>
        </div>
    );
}

/** A value that the robot keeps, and takes at any time. */
function Setting({ service, meta, hold }: { readonly service: Service; readonly meta: Parameter; readonly hold: Hold | undefined }): preact.JSX.Element {
    const [text, setText] = useState<string>();
    const [busy, setBusy] = useState(false);
    const now = firstText(meta);
    const shown = text ?? now;
    const read = readField(meta, shown);
    const changed = text !== undefined && text !== now;
    const set = async (): Promise<void> => {
        if (hold === undefined) return;
        setBusy(true);
        if (await hold.set(service.name, { name: meta.name, values: read.values })) setText(undefined);
        setBusy(false);
    };
    return (
        <form
            class="setting"
            onSubmit={(event) => {
                event.preventDefault();
                if (changed && read.wrong === "" && read.values.length > 0) void set();
            }}
        >
            <Field meta={meta} text={shown} touched={changed} disabled={hold === undefined} onText={setText} />
            <ServerButton type="submit" disabled={hold === undefined || busy || !changed || read.wrong !== "" || read.values.length === 0}>
                {busy ? "…" : "Set"}
                <span class="unseen"> {meta.name}</span>
            </ServerButton>
        </form>
    );
}

function ResourceRow({ service, resource, hold }: { readonly service: Service; readonly resource: Resource; readonly hold: Hold | undefined }): preact.JSX.Element {
    const id = useId();
    const [over, setOver] = useState(false);
    const upload = hold?.uploads.value.get(`${service.name}\n${resource.name}`);
    const ready = hold !== undefined && reachable.value && upload?.state !== "sending";
    const take = (file: File | undefined): void => {
        if (file === undefined || hold === undefined || !ready) return;
        void openFloor(file); // if it is a map; the upload says whether it can be read
        void hold.upload(service.name, resource, file);
    };
    return (
        <div
            class={`resource ${over ? "over" : ""}`}
            data-resource={resource.name}
            onDragOver={(event) => {
                event.preventDefault();
                setOver(ready);
            }}
            onDragLeave={() => setOver(false)}
            onDrop={(event) => {
                event.preventDefault();
                setOver(false);
                take(event.dataTransfer?.files[0]);
            }}
        >
            <label for={id}>
                {resource.name} <Badge tone={resource.ready ? "good" : resource.required ? "bad" : "off"}>{resource.ready ? `there${resource.size > 0 ? `, ${formatBytes(resource.size)}` : ""}` : resource.required ? "missing" : "not there"}</Badge>
                {resource.required && <span class="required"> required</span>}
            </label>
            {resource.descr !== "" && <span class="about">{sentence(resource.descr)}</span>}
            <input
                id={id}
                type="file"
                disabled={!ready}
                onChange={(event) => {
                    take(event.currentTarget.files?.[0]);
                    event.currentTarget.value = "";
                }}
            />
            {ready && <span class="about quiet">or drop the file here</span>}
            {upload !== undefined && (
                <div class="upload">
                    <Progress value={upload.total > 0 ? upload.sent / upload.total : 1} label={`Upload of ${upload.file}`} />
                    <span role="status">
                        {upload.file}: {upload.state === "done" ? "uploaded" : upload.state === "failed" ? `not uploaded. ${upload.why}` : `${formatBytes(upload.sent)} of ${formatBytes(upload.total)}`}
                    </span>
                    {upload.sha256 !== "" && (
                        <span class="quiet hash" title="SHA-256 of the file. The robot checks it.">
                            SHA-256 <code>{upload.sha256}</code>
                        </span>
                    )}
                    {upload.state === "sending" && (
                        <button type="button" onClick={() => upload.abort.abort()}>
                            Cancel the upload
                        </button>
                    )}
                </div>
            )}
        </div>
    );
}

interface FormProps {
    readonly entity: Entity;
    readonly service: Service;
    readonly hold: Hold | undefined;
}
export function ServiceForm({ entity, service, hold }: FormProps): preact.JSX.Element {
    const [texts, setTexts] = useState<Readonly<Record<string, string>>>({});
    const [tried, setTried] = useState(false);
    const inputs = service.parameters.filter(({ kind }) => kind === "INPUT");
    const settings = service.parameters.filter(({ kind }) => kind === "CONFIG");
    const outputs = service.parameters.filter(({ kind }) => kind === "OUTPUT" || kind === "FEEDBACK");
    const textOf = (meta: Parameter): string => texts[meta.name] ?? firstText(meta);
    const missing = [
        ...service.parameters.filter((meta) => (meta.kind === "INPUT" || meta.kind === "CONFIG") && isMissing(meta, meta.kind === "INPUT" ? textOf(meta) : "")).map(({ name }) => name),
        ...service.resources.filter(({ required, ready }) => required && !ready).map(({ name }) => `the file ${name}`),
    ];
    const wrong = inputs.filter((meta) => readField(meta, textOf(meta)).wrong !== "").map(({ name }) => name);
    const barrier =
        !reachable.value ? NOT_NOW : hold === undefined ? `Check out ${entity.name} first.` : hold.orphaned.value ? "Not possible while the connection is lost." : entity.latched ? `${entity.name} was stopped. Rearm it first.` : !service.active ? `The robot has switched this off${service.inactiveReason === "" ? "." : `: ${service.inactiveReason}`}` : "";
    const lacks = [missing.length > 0 ? `Still missing: ${missing.join(", ")}.` : "", wrong.length > 0 ? `Not understood: ${wrong.join(", ")}.` : ""].filter((one) => one !== "").join(" ");
    const running = hold !== undefined && hold.busy;
    const submit = (form: HTMLFormElement): void => {
        setTried(true);
        if (barrier !== "" || lacks !== "" || hold === undefined) return form.querySelector<HTMLElement>("[aria-invalid]")?.focus();
        const args: Argument[] = inputs.flatMap((meta) => {
            const { values } = readField(meta, textOf(meta));
            return values.length === 0 ? [] : [{ name: meta.name, values }];
        });
        hold.run(service, args);
        setTried(false);
    };
    return (
        <section class={`card service ${service.active ? "" : "inactive"}`} aria-label={`Service ${service.name}`} data-service={service.name}>
            <div class="head">
                <h3>{service.name}</h3>
                <span class="row">
                    {service.executing && <Badge tone="busy">running</Badge>}
                    {!service.active && <Badge tone="off">switched off</Badge>}
                    {service.kind === "CMPLX" && <span class="chip">in {service.parts.length} parts</span>}
                </span>
            </div>
            {service.descr !== "" && <p>{sentence(service.descr)}</p>}
            {service.notes !== "" && <p class="quiet">{sentence(service.notes)}</p>}
            {service.kind === "CMPLX" && service.parts.length > 0 && <p class="quiet">Does one after the other: {service.parts.join(", ")}.</p>}
            <form
                onSubmit={(event) => {
                    event.preventDefault();
                    submit(event.currentTarget);
                }}
                noValidate
            >
                <div class="fields">
                    {inputs.map((meta) => (
                        <Field key={meta.name} meta={meta} text={textOf(meta)} touched={tried} onText={(text) => setTexts((all) => ({ ...all, [meta.name]: text }))} />
                    ))}
                </div>
                <div class="act">
                    <button type="submit" class="primary" aria-disabled={barrier !== "" || lacks !== ""}>
                        {running ? "Add to the queue" : "Run"} <span class="unseen">{service.name}</span>
                    </button>
                    {inputs.some((meta) => texts[meta.name] !== undefined && texts[meta.name] !== firstText(meta)) && (
                        <button type="button" class="plain" onClick={() => setTexts({})}>
                            Back to the saved values
                        </button>
                    )}
                    <span class={tried && (barrier !== "" || lacks !== "") ? "bad" : "quiet"} role={tried ? "alert" : undefined}>
                        {barrier !== "" ? barrier : lacks}
                    </span>
                </div>
            </form>
            {service.resources.length > 0 && (
                <div class="block">
                    <h4>Files</h4>
                    {service.resources.map((resource) => (
                        <ResourceRow key={resource.name} service={service} resource={resource} hold={hold} />
                    ))}
                </div>
            )}
            {settings.length > 0 && (
                <div class="block">
                    <h4>
                        Settings <span class="quiet">kept by the robot, valid at once</span>
                    </h4>
                    {settings.map((meta) => (
                        <Setting key={meta.name} service={service} meta={meta} hold={hold} />
                    ))}
                </div>
            )}
            <details class="facts">
                <summary>About this service</summary>
                <ul>
                    <li>{plainLoss(service)}</li>
                    <li>{service.pausable ? "It can be paused." : "It cannot be paused."}</li>
                    <li>{service.blocking ? "Other tasks wait until it has ended." : "Other tasks may run beside it."}</li>
                    {outputs.map((meta) => (
                        <li key={meta.name}>
                            {meta.kind === "OUTPUT" ? "Result" : "While it runs"}: {meta.name}
                            {meta.units !== "" && ` in ${meta.units}`}
                            {meta.descr !== "" && `. ${sentence(meta.descr)}`}
                            {meta.values.length > 0 && ` Now ${formatValues(meta.values, meta.units)}.`}
                        </li>
                    ))}
                    <li>
                        Global id: <code>{service.globalId}</code>
                    </li>
                </ul>
            </details>
        </section>
    );
}
