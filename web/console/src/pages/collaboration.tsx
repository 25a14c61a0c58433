// SPDX-License-Identifier: GPL-2.0-or-later
export function CollaborationPage(): preact.JSX.Element {
    return <h1>Collaboration</h1>;
}
