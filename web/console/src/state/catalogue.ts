// SPDX-License-Identifier: GPL-2.0-or-later
// Which entity offers which services, so that people can look for a service. Asked for
// when an entity comes, and again every two minutes while the page Laboratory is in sight, a few at a time.
import { effect, signal } from "@preact/signals";
import { isDue } from "./due";
import { entities } from "./entities";
import { page } from "./route";
import { client, reachable } from "./session";

const AT_ONCE = 3;
const LOOK_MS = 5000;

/** By UUID: the names of its services. */
export const offered = signal<ReadonlyMap<string, readonly string[]>>(new Map());
const askedAt = new Map<string, number>();
let busy = 0;

const inSight = (): boolean => page.peek() === "laboratory" && !document.hidden;
function ask(): void {
    const its = client.peek();
    if (its === undefined || !reachable.peek()) return;
    for (const { entity, fresh } of entities.peek().values()) {
        if (busy >= AT_ONCE) return;
        const answered = offered.peek().has(entity.id);
        if (!fresh || (answered && !inSight()) || !isDue(answered, askedAt.get(entity.id), performance.now())) continue;
        askedAt.set(entity.id, performance.now());
        ++busy;
        void its
            .services(entity.id)
            .then(
                (services) => {
                    const names = services.map(({ name }) => name);
                    if (names.join("\n") !== offered.peek().get(entity.id)?.join("\n")) offered.value = new Map(offered.peek()).set(entity.id, names);
                },
                () => undefined,
            )
            .finally(() => {
                --busy;
                ask();
            });
    }
}
effect(() => {
    const there = entities.value;
    const gone = [...offered.peek().keys()].filter((id) => !there.has(id));
    if (gone.length > 0) offered.value = new Map([...offered.peek()].filter(([id]) => there.has(id)));
    for (const id of [...askedAt.keys()]) if (!there.has(id)) askedAt.delete(id);
    ask();
});
setInterval(ask, LOOK_MS);
