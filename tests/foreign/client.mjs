// SPDX-License-Identifier: GPL-2.0-or-later
// A client of Axon for Node, written from api/ and docs/reference alone. It reaches the server through a Glacier2 router by
// WebSocket, as a browser does, lists the entities, checks one out, runs a task, stops it, rearms and releases, and prints what
// it hears as lines of JSON. node_client_test.py runs it:
//     node client.mjs GENERATED_FOLDER PROTO_FOLDER PORT USER PASSWORD ENTITY
import { randomBytes } from "node:crypto";
import { pathToFileURL } from "node:url";
import WebSocket from "ws";
// Ice looks for these two when it is loaded; a browser has them.
globalThis.WebSocket = WebSocket;
if (globalThis.navigator === undefined) globalThis.navigator = { userAgent: "Node" };
const { Ice, Glacier2 } = (await import("ice")).default;
const protobuf = (await import("protobufjs")).default;

const [generated, protos, port, user, password, wanted] = process.argv.slice(2);
const { Axon } = await import(pathToFileURL(`${generated}/frontendcomm.js`));
const { CommUtil, FrontEndComm } = Axon;
const root = new protobuf.Root();
root.resolvePath = (_, target) => `${protos}/${target}`;
await root.load("axon/messages.proto");
const ToEntity = root.lookupType("axon.proto.ToEntity");
const ToClient = root.lookupType("axon.proto.ToClient");
const say = (what, fields = {}) => console.log(JSON.stringify({ what, ...fields }));

/** What has arrived and nobody has waited for yet, and who waits. */
const arrived = [];
const waiting = [];
function hear(item) {
    const at = waiting.findIndex(({ holds }) => holds(item));
    if (at < 0) arrived.push(item);
    else waiting.splice(at, 1)[0].resolve(item);
}
function wait(holds, seconds = 5) {
    const at = arrived.findIndex(holds);
    if (at >= 0) return Promise.resolve(arrived.splice(at, 1)[0]);
    return new Promise((resolve, reject) => {
        waiting.push({ holds, resolve });
        setTimeout(() => reject(new Error(`not within ${seconds} s: ${holds}`)), seconds * 1000).unref();
    });
}
const told = (arm, holds = () => true) => wait(({ message }) => message?.body === arm && holds(message[arm])).then(({ message }) => message[arm]);

const entities = new Map(); // UUID -> registration, status
const known = (id) => entities.get(id) ?? entities.set(id, {}).get(id);
class Callback extends FrontEndComm.ClientCallback {
    newBasicPrflMsg(presence, registration) {
        if (presence === CommUtil.Presence.Left) entities.delete(registration.entity);
        else known(registration.entity).registration = registration;
        hear({ entity: registration.entity });
    }
    newStatusMsg(status) {
        known(status.entity).status = status;
        hear({ entity: status.entity });
    }
    newEntityMsg(head, bytes) {
        hear({ head, message: ToClient.decode(bytes) });
    }
    newEntityMsgDataSeq(head, bytes) {
        this.newEntityMsg(head, bytes);
    }
    newRefusalMsg(head, code, reason) {
        hear({ head, refused: { code, reason } });
    }
    newStopAccepted(head, count) {
        hear({ head, accepted: count });
    }
    newUpdateMsg() {}
    newHeartbeat() {}
}

/** Opens one lane through the router (docs/reference/routers.md, "Handshake through a router"). */
async function open(context) {
    const settings = new Ice.InitializationData();
    settings.properties = Ice.createProperties();
    settings.properties.setProperty("Ice.RetryIntervals", "-1");
    settings.properties.setProperty("Ice.MessageSizeMax", "4096");
    const communicator = Ice.initialize(settings);
    const router = Glacier2.RouterPrx.uncheckedCast(communicator.stringToProxy(`Axon.Clients/router:ws -h 127.0.0.1 -p ${port}`));
    const proxy = await router.createSession(user, password, new Map(Object.entries({ "axon-contract": String(CommUtil.ContractNumber), ...context })));
    const connection = router.ice_getCachedConnection();
    connection.setCloseCallback(() => hear({ closed: true }));
    const [category, server, timeout] = await Promise.all([router.getCategoryForClient(), router.getServerProxy(), router.getACMTimeout()]);
    await router.addProxies([proxy]);
    connection.setACM(timeout, undefined, Ice.ACMHeartbeat.HeartbeatAlways);
    const adapter = await communicator.createObjectAdapter("");
    connection.setAdapter(adapter);
    const identity = new Ice.Identity("callback", category);
    adapter.add(new Callback(), identity);
    await adapter.activate();
    const session = FrontEndComm.ClientSessionPrx.uncheckedCast(connection.createProxy(proxy.ice_getIdentity()));
    return { communicator, session, callback: FrontEndComm.ClientCallbackPrx.uncheckedCast(server.ice_identity(identity)) };
}

const data = await open({ "axon-name": "node@example" });
const facts = await data.session.setCallback(data.callback);
const signal = await open({ "axon-name": "node@example", "axon-token": facts.token });
await signal.session.attachSignalLane(facts.token, signal.callback);
say("joined", { name: facts.me.name, role: facts.me.role.name, signalEndpoint: facts.signalEndpoint });

// Messages go twoway through a router, signals and beats oneway.
const signals = FrontEndComm.ClientSessionPrx.uncheckedCast(signal.session.ice_oneway().ice_invocationTimeout(-1));
// A router says nothing of a server that has died, but for a call that wants an answer. So one beat at a time asks for one.
const asking = FrontEndComm.ClientSessionPrx.uncheckedCast(signal.session.ice_invocationTimeout(5000));
let beats = 0;
let asked = false;
let leaving = false;
function beat() {
    beats += 1;
    if (asked) return signals.keepAlive(beats);
    asked = true;
    return asking.keepAlive(beats).then(() => (asked = false), (error) => leaving || lost(error));
}
function lost(error) {
    console.error(`the server behind the router is gone: ${error}`);
    process.exit(3);
}
const beating = setInterval(beat, facts.watchdogBusyMs / 5);

let held = new CommUtil.Lease(0, 0);
let generation = 0;
const numbers = { data: 0, signal: 0 };
const head = (entity, msgType, lane = "data") =>
    new CommUtil.Header(new CommUtil.Sender("", "", CommUtil.Role.Observer), entity, msgType, held, generation, ++numbers[lane],
        performance.now() * 1000);
const send = (entity, msgType, body) => data.session.sendToEntity(head(entity, msgType), ToEntity.encode(ToEntity.fromObject(body)).finish());
const sameBytes = (a) => (b) => Buffer.compare(Buffer.from(a), Buffer.from(b)) === 0;

/** Runs a task up to a final state, or until `enough` of an event. */
async function run(entity, to, enough = () => false) {
    const taskId = randomBytes(16);
    await send(entity, "TASK", { task: { taskId, service: "Count", params: [{ name: "To", values: [{ int: to }] }] } });
    return events(taskId, enough);
}
async function events(taskId, enough = () => false) {
    for (;;) {
        const event = await told("task", ({ taskId: id }) => sameBytes(taskId)(id));
        const state = root.lookupEnum("axon.proto.TaskState").valuesById[event.state];
        say("task", { state, progress: event.progress, reason: event.reason?.code ?? 0, results: event.results.map(({ name, values }) => [name, Number(values[0].int)]) });
        if (event.state >= 5 || enough(event)) return { taskId, state };
    }
}

const ready = ([, { registration, status }]) => registration?.name === wanted && status?.state === CommUtil.EntityState.IDLE;
while (![...entities].some(ready)) await wait(({ entity }) => entity, 10);
const [entity] = [...entities].find(ready);
for (const { registration, status } of entities.values()) say("entity", { name: registration.name, category: registration.category, state: status.state.name });

const requestId = randomBytes(16);
await send(entity, "CHECKOUT", { checkOut: { requestId, phase: "TAKE" } });
const grant = await told("checkOut", ({ requestId: id }) => sameBytes(requestId)(id));
held = new CommUtil.Lease(grant.lease.epoch, grant.lease.number);
generation = grant.stopGeneration;
say("checked out", { services: grant.services.services.map(({ name }) => name) });

await run(entity, 10);
const { taskId } = await run(entity, 100000, ({ progress }) => progress > 0);
const stop = head(entity, "", "signal");
signals.sendStopSignal(stop, CommUtil.StopCause.Requested);
say("accepted", { entities: (await wait(({ accepted }) => accepted !== undefined)).accepted });
for (let stage = 0, more = true; stage < 3 || (stage === 3 && more);) { // 3: the callback has returned, 4: it stands, 5: no application
    const receipt = await told("receipt", ({ stopId }) => stopId === `${facts.me.id}:${stop.seq}`);
    ({ stage, standstillFollows: more } = receipt);
    generation = receipt.stopGeneration;
    say("receipt", { stage: root.lookupEnum("axon.proto.StopReceipt.Stage").valuesById[stage] });
}
await events(taskId);
await run(entity, 1);
const rearm = randomBytes(16);
await send(entity, "REARM", { rearm: { requestId: rearm } });
say("rearmed", { refusal: (await told("reply", ({ requestId: id }) => sameBytes(rearm)(id))).refusal?.code ?? 0 });
await run(entity, 1);
await send(entity, "RELEASE", { release: {} });
say("released", { reason: (await told("leaseEnded")).reason.code });

leaving = true;
clearInterval(beating);
signals.leave();
await wait(({ closed }) => closed);
say("left");
await Promise.all([data.communicator.destroy(), signal.communicator.destroy()]);
