// SPDX-License-Identifier: GPL-2.0-or-later
import { now } from "../state/clock";
import { holds, type Hold } from "../state/holds";
import { dismiss, notices } from "../state/journal";
import { linkTo, route } from "../state/route";
import { formatSpan } from "../words/format";
import { ServerButton } from "./server_button";

export function Notices(): preact.JSX.Element {
    return (
        <div class="notices" aria-live="polite" aria-relevant="additions">
            {notices.value.map(({ number, tone, text, more, entity }) => (
                <div key={number} class={`notice ${tone}`}>
                    <div>
                        <strong>{text}</strong>
                        {more !== "" && <p>{more}</p>}
                        {entity !== "" && route.value.subject !== entity && (
                            <p>
                                <a href={linkTo("entity", entity)}>Show it</a>
                            </p>
                        )}
                    </div>
                    <button type="button" class="plain" aria-label="Dismiss" onClick={() => dismiss(number)}>
                        ✕
                    </button>
                </div>
            ))}
        </div>
    );
}

function Question({ hold }: { readonly hold: Hold }): preact.JSX.Element | null {
    const question = hold.question.value;
    if (question === undefined) return null;
    const left = question.answerWithinMs - (now.value - hold.askedAt.value);
    return (
        <div class="banner ask" role="alertdialog" aria-label={`Request for ${hold.entity.name}`}>
            <div>
                <strong>
                    {question.by} asks for {hold.entity.name}.
                </strong>{" "}
                {question.reason !== "" && <q>{question.reason}</q>}{" "}
                <span aria-hidden="true">
                    Without an answer in {formatSpan(left)} {question.yield ? "it is handed over." : "the answer is no."}
                </span>
            </div>
            <div class="row">
                <ServerButton class="primary" onClick={() => hold.answer(false)}>
                    Keep it
                </ServerButton>
                <ServerButton onClick={() => hold.answer(true)}>Hand it over (it stops first)</ServerButton>
            </div>
        </div>
    );
}
/** What others ask of this page, on every page. */
export function Questions(): preact.JSX.Element {
    return (
        <>
            {[...holds.value.values()].map((hold) => (
                <Question key={hold.id} hold={hold} />
            ))}
        </>
    );
}
