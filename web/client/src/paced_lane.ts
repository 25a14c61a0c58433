// SPDX-License-Identifier: GPL-2.0-or-later

interface Parcel {
    readonly bytes: number;
    readonly send: () => PromiseLike<unknown>;
}

/**
 * Gives messages to a connection, in order, and only a few at a time: signals on the same connection go before everything that
 * waits here. `send` resolves when the message counts no more: it was written, or the other side has answered it. One that fails
 * is told to `failed`, in a turn of its own. A message larger than `most` goes alone.
 */
export class PacedLane {
    private waiting: Parcel[] = [];
    private readonly forRoom = new Set<() => void>();
    private waitingBytes = 0;
    private onTheWay = 0;
    private pumping = false;
    private ended = false;

    constructor(
        private readonly most: number,
        private readonly failed: (error: unknown) => void,
    ) {}

    /** What waits here; what is on its way is bounded by `most`. */
    backlog(): { messages: number; bytes: number } {
        return { messages: this.waiting.length, bytes: this.waitingBytes };
    }
    post(bytes: number, send: () => PromiseLike<unknown>): void {
        if (this.ended) return;
        this.waitingBytes += bytes;
        this.waiting.push({ bytes, send });
        this.pump();
    }
    /**
     * Calls once, as soon as nothing waits and another message may go, and in the order in which this was asked; what is posted
     * within the call goes at once. Returns what withdraws it.
     */
    onRoom(call: () => void): () => void {
        const own = (): void => call(); // the same function may wait twice
        if (!this.ended) this.forRoom.add(own);
        this.pump();
        return () => void this.forRoom.delete(own);
    }
    /** Nothing is sent and nobody is called any more. */
    end(): void {
        this.ended = true;
        this.waiting = [];
        this.waitingBytes = 0;
        this.forRoom.clear();
    }

    private pump(): void {
        if (this.pumping) return;
        this.pumping = true;
        try {
            while (!this.ended) {
                const next = this.waiting[0];
                if (next !== undefined) {
                    if (this.onTheWay > 0 && this.onTheWay + next.bytes > this.most) return;
                    this.waiting.shift();
                    this.waitingBytes -= next.bytes;
                    this.give(next);
                    continue;
                }
                const [call] = this.forRoom;
                if (call === undefined || this.onTheWay > this.most / 2) return;
                this.forRoom.delete(call);
                call();
            }
        } finally {
            this.pumping = false;
        }
    }
    private give({ bytes, send }: Parcel): void {
        this.onTheWay += bytes;
        const gone = (): void => {
            this.onTheWay -= bytes;
            this.pump();
        };
        const lost = (error: unknown): void => {
            this.onTheWay -= bytes;
            if (!this.ended) this.failed(error);
        };
        try {
            Promise.resolve(send()).then(gone, lost);
        } catch (error) {
            queueMicrotask(() => lost(error));
        }
    }
}
