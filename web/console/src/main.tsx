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
void start();
