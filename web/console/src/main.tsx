// SPDX-License-Identifier: GPL-2.0-or-later
import { render } from "preact";
import { App } from "./app";
import { start } from "./state/session";
import "./styles/base.css";
import "./styles/parts.css";

const place = document.getElementById("app");
if (place !== null) {
    place.replaceChildren();
    render(<App />, place);
}
// A file that misses its place would replace this page, and with it the session.
for (const name of ["dragover", "drop"]) addEventListener(name, (event) => event.preventDefault());
void start();
