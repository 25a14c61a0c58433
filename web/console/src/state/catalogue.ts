// SPDX-License-Identifier: GPL-2.0-or-later
// Which entity offers which services, so that people can look for a service. Asked for once for each entity, a few at a time.
import { effect, signal } from "@preact/signals";
import { entities } from "./entities";
import { client } from "./session";

const AT_ONCE = 3;
const AGAIN_MS = 10_000;

/** By UUID: the names of its services. */
export const offered = signal<ReadonlyMap<string, readonly string[]>>(new Map());
const askedAt = new Map<string, number>();
let busy = 0;

function ask(): void {
    const its = client.peek();
    if (its?.connected !== true) return;
    for (const { entity, fresh } of entities.peek().values()) {
        if (busy >= AT_ONCE) return;
        if (!fresh || offered.peek().has(entity.id) || performance.now() - (askedAt.get(entity.id) ?? -Infinity) < AGAIN_MS) continue;
        askedAt.set(entity.id, performance.now());
        ++busy;
        void its
            .services(entity.id)
            .then(
                (services) => (offered.value = new Map(offered.peek()).set(entity.id, services.map(({ name }) => name))),
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
