// SPDX-License-Identifier: GPL-2.0-or-later
// Numbers, times and values as the person's own browser writes them.
import type { Value } from "@axon/client";

const languages = typeof navigator === "undefined" ? ["en"] : navigator.languages;
const number = new Intl.NumberFormat(languages, { maximumSignificantDigits: 6 });
const rough = new Intl.NumberFormat(languages, { maximumSignificantDigits: 4 });
const whole = new Intl.NumberFormat(languages, { maximumFractionDigits: 0 });
const percents = new Intl.NumberFormat(languages, { style: "percent", maximumFractionDigits: 0 });
const clock = new Intl.DateTimeFormat(languages, { hour: "2-digit", minute: "2-digit", second: "2-digit" });
const day = new Intl.DateTimeFormat(languages, { dateStyle: "medium", timeStyle: "medium" });
const decimal = number.formatToParts(1.5).find(({ type }) => type === "decimal")?.value ?? ".";

export const formatNumber = (value: number): string => (Number.isFinite(value) ? number.format(value) : String(value));
/** For what changes as one reads it. */
export const formatRough = (value: number): string => (Number.isFinite(value) ? rough.format(value) : String(value));
export const formatCount = (value: number): string => whole.format(value);
export const formatPercent = (value: number): string => percents.format(Math.min(Math.max(value, 0), 1));
export const formatClock = (ms: number): string => clock.format(ms);
export const formatDate = (ms: number): string => day.format(ms);

export function formatMs(ms: number): string {
    return ms < 10 ? `${formatNumber(Math.round(ms * 10) / 10)} ms` : ms < 10_000 ? `${formatCount(ms)} ms` : formatSpan(ms);
}
/** A span of time, as coarse as a person would say it. */
export function formatSpan(ms: number): string {
    const seconds = Math.max(Math.floor(ms / 1000), 0);
    if (seconds < 1) return "a moment";
    if (seconds < 60) return `${seconds} s`;
    if (seconds < 3600) return `${Math.floor(seconds / 60)} min`;
    const hours = Math.floor(seconds / 3600);
    return hours < 48 ? `${hours} h ${Math.floor((seconds % 3600) / 60)} min` : `${Math.floor(hours / 24)} days`;
}
export function formatBytes(bytes: number): string {
    if (bytes < 1000) return `${bytes} bytes`;
    return bytes < 1e6 ? `${formatNumber(Math.round(bytes / 100) / 10)} kB` : `${formatNumber(Math.round(bytes / 1e5) / 10)} MB`;
}
export function formatValue(value: Value): string {
    switch (typeof value) {
        case "bigint":
            return value.toLocaleString(languages as string[]);
        case "number":
            return formatNumber(value);
        case "boolean":
            return value ? "yes" : "no";
        default:
            return value;
    }
}
export function formatValues(values: readonly Value[], units = ""): string {
    const shown = values.slice(0, 32).map(formatValue).join(", ") + (values.length > 32 ? ` … (${values.length} values)` : "");
    return units === "" || shown === "" ? shown : `${shown} ${units}`;
}
/** A value as an input field shows it, and as parseValue() reads it. */
export const fieldText = (value: Value): string => String(value);

/** What a person has typed as a number, as parseValue() reads it: "1,5" is 1.5 where that is how people write it. */
export function plainNumber(text: string): string {
    const trimmed = text.trim().replace(/[\s  ]/g, "");
    return decimal === "," && /^[+-]?\d*,\d+$/.test(trimmed) ? trimmed.replace(",", ".") : trimmed;
}
