// SPDX-License-Identifier: GPL-2.0-or-later
// The Worker of workerClock(): {start: ID, ms: MS} is answered by ID after that time, {stop: ID} ends it.
interface Order {
    readonly start?: number;
    readonly stop?: number;
    readonly ms?: number;
}

const timers = new Map<number, ReturnType<typeof setTimeout>>();
const scope = globalThis as unknown as Pick<Worker, "postMessage" | "addEventListener">;
scope.addEventListener("message", (event) => {
    const { start, stop, ms } = (event as MessageEvent<Order>).data;
    if (stop !== undefined) {
        clearTimeout(timers.get(stop));
        timers.delete(stop);
    }
    if (start === undefined) return;
    clearTimeout(timers.get(start)); // one for each ID
    timers.set(
        start,
        setTimeout(() => {
            timers.delete(start);
            scope.postMessage(start);
        }, ms),
    );
});
