// SPDX-License-Identifier: GPL-2.0-or-later
import { effect, signal } from "@preact/signals";

export type Theme = "auto" | "light" | "dark";
const saved = localStorage.getItem("axon-theme");
export const theme = signal<Theme>(saved === "light" || saved === "dark" ? saved : "auto");
effect(() => {
    document.documentElement.dataset["theme"] = theme.value;
    localStorage.setItem("axon-theme", theme.value);
});
export function nextTheme(): void {
    theme.value = theme.value === "auto" ? "dark" : theme.value === "dark" ? "light" : "auto";
}
