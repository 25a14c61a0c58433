// SPDX-License-Identifier: GPL-2.0-or-later
/** The client library: a program of an operator, in a browser or in Node, uses it to use robots. README.md is the way in. */
export { CheckOut, Client, connect, type End, type Options, Run, Task, whileVisible } from "./client.js";
export { type Alarm, type Clock, plainClock, workerClock } from "./clock.js";
export { availabilityOf } from "./core/entities.js";
export * from "./global_types.js";
export type { Random } from "./ids.js";
export { Refusal, type RefusalCode, refusalCodes } from "./refusal.js";
export type { Credentials } from "./session.js";
export type { Connection, ConnectionEvents, Facts, Header, Lane, LeaseNumber, Login, Registration, Status, StopCause, Transport } from "./transport.js";
export { ticketFrom } from "./ticket.js";
export * from "./types.js";
export type { UploadOptions } from "./upload.js";
export { isFinalRun, isFinalTask } from "./wire/content.js";
export { acceptValue, describeValues, parseValue } from "./wire/values.js";
