// SPDX-License-Identifier: GPL-2.0-or-later
// The only file that knows Ice: two lanes to a front-end server, directly or through a Glacier2 router
// (docs/reference/sessions.md, docs/reference/routers.md).
import { Glacier2, Ice } from "ice";
import { Axon } from "../../gen/slice/frontendcomm.js";
import { Axon as Common } from "../../gen/slice/commutil.js";
import { PacedLane } from "../paced_lane.js";
import { Refusal, refusalOf } from "../refusal.js";
import type { Connection, ConnectionEvents, Facts, Header, Lane, Login, Registration, Status, StopCause, Transport } from "../transport.js";
import type { Presence, Role, Sender } from "../types.js";
import { stateInSlice } from "../wire/content.js";
import { type Endpoint, endpointAddress, endpointText, isUsable, parseEndpoint, parseEndpoints, parseTarget, type Target } from "./endpoint.js";

const { CommUtil } = Common;
const { FrontEndComm } = Axon;
type Session = Axon.FrontEndComm.ClientSessionPrx;
type Head = Common.CommUtil.Header;

const CONNECT_MS = 3000;
const LEAVE_MS = 1000;
/** To connect to an endpoint that the server named for the signal lane, and to log in there, each; then the try is given up. */
const SIGNAL_MS = 2000;
/** Signals that are not written yet; beyond that the connection ends. */
const SIGNALS_MAX = 16_384;
/** At most this many bytes of data are on their way at a time, so that a signal on the same connection has only these before it: two chunks of uploads. */
const DATA_BYTES_MAX = 2 * (64 + 1) * 1024;
/** At most this many bytes are in a router at a time, because its queues have no bound. */
const ROUTED_BYTES_MAX = 256 * 1024;
/** A heartbeat through a router that wants an answer gets one within this, or the server behind it is gone. */
const ROUTED_ANSWER_MS = 5000;
/** Questions for a sign of life that are on their way at a time: a server that is far away is asked again before it has answered. */
const QUESTIONS_MAX = 8;

/** What a server or a router takes in one message, less what Ice writes around it. */
const MESSAGE_BYTES_MAX = (4096 - 64) * 1024;
/** The same at a server's port for browsers (docs/reference/console.md, "Limits"). */
const BROWSER_MESSAGE_BYTES_MAX = (512 - 16) * 1024;

const ROLES: readonly Role[] = ["observer", "operator", "admin"];
const PRESENCES: readonly Presence[] = ["joined", "changed", "left"];

function senderOf(sender: Common.CommUtil.Sender): Sender {
    return { id: sender.id, name: sender.name, role: ROLES[sender.role.value] ?? "observer" };
}
function headerOf(head: Head): Header {
    const { epoch, number } = head.held;
    return { entity: head.entity, msgType: head.msgType, held: { epoch, number }, stopGeneration: head.stopGeneration, seq: head.seq, sentAtUs: head.sentAt };
}
function headOf(header: Header): Head {
    const sender = new CommUtil.Sender("", "", CommUtil.Role.Observer);
    const held = new CommUtil.Lease(header.held.epoch, header.held.number);
    return new CommUtil.Header(sender, header.entity, header.msgType, held, header.stopGeneration, header.seq, header.sentAtUs);
}
function registrationOf({ entity, name, category, type }: Common.CommUtil.Registration): Registration {
    return { entity, name, category, type };
}
function statusOf(status: Common.CommUtil.EntityStatus): Status {
    const { entity, latched, stopGeneration, reason, orphaned, waiting, stopLatencyUs } = status;
    const { epoch, number } = status.held;
    return { entity, state: stateInSlice(status.state.value), latched, stopGeneration, holder: senderOf(status.holder), held: { epoch, number }, reason, orphaned, waiting, stopLatencyUs };
}

/** Pushes of the server, on either lane. */
class Callback extends FrontEndComm.ClientCallback {
    constructor(private readonly events: ConnectionEvents) {
        super();
    }
    override newBasicPrflMsg(presence: Common.CommUtil.Presence, registration: Common.CommUtil.Registration, profile: Uint8Array): void {
        this.events.profile(PRESENCES[presence.value] ?? "changed", registrationOf(registration), profile);
    }
    override newStatusMsg(status: Common.CommUtil.EntityStatus): void {
        this.events.status(statusOf(status));
    }
    override newEntityMsg(head: Head, bytes: Uint8Array): void {
        this.events.entityMessage(headerOf(head), bytes);
    }
    override newEntityMsgDataSeq(head: Head, bytes: Uint8Array): void {
        this.events.entityMessage(headerOf(head), bytes);
    }
    override newRefusalMsg(head: Head, code: number, reason: string): void {
        this.events.refused(headerOf(head), refusalOf(code, reason) ?? new Refusal("INTERNAL", reason));
    }
    override newStopAccepted(head: Head, entities: number): void {
        this.events.stopAccepted(headerOf(head), entities);
    }
    override newUpdateMsg(code: number, text: string): void {
        this.events.serverText(code, text);
    }
    override newHeartbeat(): void {
        this.events.heartbeat();
    }
}

/** What Ice threw, in the words of the C++ client. */
function translate(error: unknown, address: string): Refusal {
    if (error instanceof Refusal) return error;
    if (error instanceof CommUtil.RequestRefused) return refusalOf(error.code, error.reason) ?? new Refusal("INTERNAL", error.reason);
    if (error instanceof Glacier2.PermissionDeniedException || error instanceof Glacier2.CannotCreateSessionException) {
        return error.reason === "internal server error"
            ? new Refusal("UNAVAILABLE", "the router answers, but no server behind it does; fix: start axon-server with the endpoints for routers that the router's configuration names")
            : new Refusal("PERMISSION_DENIED", error.reason);
    }
    if (error instanceof Ice.ObjectNotExistException) {
        return new Refusal("MALFORMED", `a program that speaks Ice answers at ${address}, and it is not where clients log in. Is it the port of the Entity Managers, or of the signal lane?`);
    }
    if (error instanceof Ice.InvocationTimeoutException || error instanceof Ice.TimeoutException) return new Refusal("TIMED_OUT", `${address} does not answer in time`);
    if (error instanceof Ice.ConnectionRefusedException) return new Refusal("NOT_CONNECTED", `nothing listens at ${address}`);
    if (error instanceof Ice.DNSException) return new Refusal("NOT_CONNECTED", `there is no host of the name in ${address}`);
    if (error instanceof Ice.ProtocolException) return new Refusal("NOT_CONNECTED", `what listens at ${address} does not speak Ice; is it the port of the web pages?`);
    if (error instanceof Ice.SocketException || error instanceof Ice.ConnectFailedException) return new Refusal("NOT_CONNECTED", `${address} cannot be reached`);
    if (error instanceof Ice.ConnectionLostException || error instanceof Ice.CloseConnectionException) return new Refusal("NOT_CONNECTED", `${address} closed the connection`);
    const text = error instanceof Ice.Exception ? error.ice_id() : error instanceof Error ? error.message : String(error);
    return new Refusal("NOT_CONNECTED", `${address}: ${text}`);
}
function reasonOf(connection: Ice.Connection): string {
    try {
        connection.throwException();
    } catch (error) {
        if (error instanceof Ice.ConnectionManuallyClosedException) return "it was closed here";
        if (error instanceof Ice.CloseConnectionException) return "the server closed it";
        if (error instanceof Ice.ConnectionLostException || error instanceof Ice.SocketException) return "the connection broke";
        if (error instanceof Ice.ConnectionTimeoutException || error instanceof Ice.TimeoutException) return "the connection stood still for too long";
        if (error instanceof Ice.Exception) return error.ice_id();
    }
    return "it was closed";
}

/** One lane: a connection with a session and its adapter, in a communicator of its own. */
class LaneEnd {
    constructor(
        readonly communicator: Ice.Communicator,
        readonly connection: Ice.Connection,
        readonly session: Session,
        readonly callback: Axon.FrontEndComm.ClientCallbackPrx,
        readonly oneway: Session,
        readonly twoway: Session,
    ) {}
    end(): void {
        this.connection.setCloseCallback(() => undefined);
        quietly(this.connection.close(Ice.ConnectionClose.Forcefully));
        quietly(this.communicator.destroy());
    }
}

interface LaneOrder {
    readonly lane: Lane;
    readonly target: Target;
    readonly login: Login;
    /** Of the data lane, for the signal lane through a router. */
    readonly token: string;
    /** Of every request. */
    readonly timeoutMs: number;
    /** To connect, and to log in. */
    readonly openMs: number;
    readonly events: ConnectionEvents;
    readonly closed: (why: string) => void;
}

async function openLane({ lane, target, login, token, timeoutMs, openMs, events, closed }: LaneOrder): Promise<LaneEnd> {
    const properties = Ice.createProperties();
    for (const [key, value] of Object.entries({
        "Ice.RetryIntervals": "-1", // a new connection has no session
        "Ice.MessageSizeMax": lane === "data" ? "4096" : "512",
        "Ice.ACM.Timeout": "60",
        "Ice.ACM.Client.Close": "0",
        "Ice.ACM.Client.Heartbeat": "3",
        "Ice.Override.ConnectTimeout": String(Math.min(CONNECT_MS, openMs)),
        "Ice.Warn.Connections": "0",
        "Ice.Warn.Dispatch": "0",
    })) {
        properties.setProperty(key, value);
    }
    const data = new Ice.InitializationData();
    data.properties = properties;
    const communicator = Ice.initialize(data);
    try {
        const adapter = await communicator.createObjectAdapter("");
        const contract: [string, string] = ["axon-contract", String(CommUtil.ContractNumber)];
        const where = endpointText(target.endpoint);
        let connection: Ice.Connection;
        let session: Session;
        let callback: Axon.FrontEndComm.ClientCallbackPrx;
        const servant = new Callback(events);
        if (target.router === undefined) {
            const proxy = communicator.stringToProxy(`ClientGate:${where}`).ice_invocationTimeout(openMs);
            const gate = FrontEndComm.ClientGatePrx.uncheckedCast(proxy);
            const opened = await gate.open(login.user, login.password, login.displayName, new Map([contract]));
            connection = gate.ice_getCachedConnection();
            connection.setAdapter(adapter);
            callback = FrontEndComm.ClientCallbackPrx.uncheckedCast(adapter.addWithUUID(servant));
            session = FrontEndComm.ClientSessionPrx.uncheckedCast(connection.createProxy(opened.ice_getIdentity()));
        } else {
            const proxy = communicator.stringToProxy(`${target.router}:${where}`).ice_invocationTimeout(openMs);
            const router = Glacier2.RouterPrx.uncheckedCast(proxy);
            const context = new Map([contract, ["axon-name", login.displayName]]);
            if (token !== "") context.set("axon-token", token);
            const opened = await router.createSession(login.user, login.password, context);
            connection = router.ice_getCachedConnection();
            const [category, server, timeout] = await Promise.all([router.getCategoryForClient(), router.getServerProxy(), router.getACMTimeout()]);
            await router.addProxies([opened]);
            connection.setACM(timeout, undefined as unknown as Ice.ACMClose, Ice.ACMHeartbeat.HeartbeatAlways); // undefined = as it is
            connection.setAdapter(adapter);
            const identity = new Ice.Identity("callback", category);
            adapter.add(servant, identity);
            callback = FrontEndComm.ClientCallbackPrx.uncheckedCast(server.ice_identity(identity));
            session = FrontEndComm.ClientSessionPrx.uncheckedCast(connection.createProxy(opened.ice_getIdentity()));
        }
        adapter.activate();
        connection.setCloseCallback((closing: Ice.Connection) => closed(reasonOf(closing)));
        const once = FrontEndComm.ClientSessionPrx.uncheckedCast(session.ice_invocationTimeout(timeoutMs));
        const oneway = FrontEndComm.ClientSessionPrx.uncheckedCast(session.ice_oneway().ice_invocationTimeout(-1));
        const twoway = FrontEndComm.ClientSessionPrx.uncheckedCast(session.ice_invocationTimeout(-1));
        return new LaneEnd(communicator, connection, once, callback, oneway, twoway);
    } catch (error) {
        quietly(communicator.destroy());
        throw translate(error, endpointAddress(target.endpoint));
    }
}

/**
 * Opens the signal lane of a session. Once it is asked for, its end is that of the session, for the server too, which may have
 * attached it although no answer has come; before, only of the try.
 */
async function attach(order: LaneOrder): Promise<LaneEnd> {
    let ended = "";
    let asked = false;
    const lane = await openLane({ ...order, closed: (why) => (asked ? order.closed(why) : void (ended = why)) });
    try {
        if (ended !== "") throw new Refusal("NOT_CONNECTED", ended);
        asked = true;
        await lane.session.attachSignalLane(order.token, lane.callback);
        return lane;
    } catch (error) {
        lane.end();
        const why = translate(error, endpointAddress(order.target.endpoint));
        // A refusal says that it is not attached; after anything else nobody here knows.
        if (asked && !(error instanceof CommUtil.RequestRefused)) order.closed(`the signal lane was lost while it was opened: ${why.message}`);
        throw why;
    }
}

/** Where the signal lane is; undefined if it has to share the lane of data. */
function signalEndpoint(told: string, login: Login, { endpoint, router }: Target): Endpoint | undefined {
    if (router !== undefined) return endpoint;
    if (login.signal === "shared") return undefined;
    if (login.signal !== undefined) return parseEndpoint(login.signal);
    const usable = parseEndpoints(told).filter(isUsable);
    // What is reached through TLS must not go on without it.
    return endpoint.scheme === "wss" ? usable.find(({ scheme }) => scheme === "wss") : (usable.find(({ scheme }) => scheme === endpoint.scheme) ?? usable[0]);
}

class IceConnection implements Connection {
    private readonly lane: PacedLane;
    private unsentSignals = 0;
    private asked = false;
    private questions = 0;
    private over = false;

    constructor(
        readonly facts: Facts,
        private readonly data: LaneEnd,
        private signal: LaneEnd | undefined,
        /** Opens the signal lane; undefined if there is none to be had. */
        private readonly openSignal: (() => Promise<LaneEnd>) | undefined,
        private readonly routed: boolean,
        /**
         * Data counts until the server has answered it, and not only until it is written: what is written to a WebSocket waits in
         * the browser, which may tell nothing of it, and then in the system.
         */
        private readonly answered: boolean,
        private readonly heard: () => void,
        private readonly close: (why: string) => void,
    ) {
        this.lane = new PacedLane(routed ? ROUTED_BYTES_MAX : DATA_BYTES_MAX, (error) => this.fail(translate(error, "the server").message));
    }

    get signalLane(): "own" | "shared" {
        return this.signal === undefined ? "shared" : "own";
    }
    get signalOffered(): boolean {
        return this.openSignal !== undefined;
    }
    async attachSignalLane(): Promise<void> {
        if (this.signal !== undefined || this.openSignal === undefined || this.over) return;
        const lane = await this.openSignal();
        if (this.over) return lane.end();
        this.signal = lane;
    }
    backlog(): { messages: number; bytes: number } {
        return this.lane.backlog();
    }
    onRoom(call: () => void): () => void {
        return this.lane.onRoom(call);
    }
    private post(bytes: number, call: (session: Session) => PromiseLike<void>): void {
        this.lane.post(bytes, () => call(this.answered ? this.data.twoway : this.data.oneway));
    }
    /** A message that cannot be sent ends the connection: nothing may be lost unnoticed. Never within the caller's turn. */
    private watch(send: () => PromiseLike<void>, done: () => unknown): void {
        const fail = (error: unknown): void => {
            done();
            this.fail(translate(error, "the server").message);
        };
        try {
            Promise.resolve(send()).then(done, fail);
        } catch (error) {
            queueMicrotask(() => fail(error));
        }
    }
    private fail(why: string): void {
        if (this.over) return;
        this.close(why);
    }
    private signalOn(lane: Lane, call: (session: Session) => PromiseLike<void>): void {
        if (this.over) return;
        if (this.unsentSignals >= SIGNALS_MAX) return queueMicrotask(() => this.fail("the server does not read its signals"));
        ++this.unsentSignals;
        const end = lane === "signal" ? (this.signal ?? this.data) : this.data;
        this.watch(
            () => call(end.oneway),
            () => --this.unsentSignals,
        );
    }

    toEntity(head: Header, bytes: Uint8Array): void {
        this.post(bytes.length + 200, (session) => session.sendToEntity(headOf(head), bytes));
    }
    toEntityDroppable(head: Header, bytes: Uint8Array): void {
        this.post(bytes.length + 200, (session) => session.sendToEntityDataSeq(headOf(head), bytes));
    }
    request(head: Header, bytes: Uint8Array): void {
        this.post(bytes.length + 200, (session) => session.sendRequest(headOf(head), bytes));
    }
    stop(lane: Lane, head: Header, cause: StopCause): void {
        this.signalOn(lane, (session) => session.sendStopSignal(headOf(head), causeOf(cause)));
    }
    stopSeveral(lane: Lane, head: Header, entities: readonly string[], cause: StopCause): void {
        this.signalOn(lane, (session) => session.sendStopSignals(headOf(head), [...entities], causeOf(cause)));
    }
    reset(head: Header): void {
        this.signalOn("signal", (session) => session.sendResetSignal(headOf(head)));
    }
    clear(head: Header): void {
        this.signalOn("signal", (session) => session.sendClearSignal(headOf(head)));
    }
    keepAlive(count: number): void {
        if (this.routed && !this.asked && !this.over) {
            // A router does not say that the server has died, but for a call that wants an answer. So one heartbeat at a time asks.
            this.asked = true;
            const session = FrontEndComm.ClientSessionPrx.uncheckedCast((this.signal ?? this.data).session.ice_invocationTimeout(ROUTED_ANSWER_MS));
            return this.watch(
                () => session.keepAlive(count),
                () => (this.asked = false),
            );
        }
        this.signalOn("signal", (session) => session.keepAlive(count));
    }
    ask(): void {
        if (this.over || this.questions >= QUESTIONS_MAX) return;
        ++this.questions;
        // A failure says nothing that the end of the connection does not say.
        const done = (): void => void --this.questions;
        const answered = (): void => {
            done();
            if (!this.over) this.heard();
        };
        try {
            (this.signal ?? this.data).twoway.ice_ping().then(answered, done);
        } catch {
            done();
        }
    }
    async leave(): Promise<void> {
        if (this.over) return;
        this.over = true;
        this.lane.end();
        await new Promise<void>((resolve) => {
            const late = setTimeout(resolve, LEAVE_MS);
            this.data.connection.setCloseCallback(() => {
                clearTimeout(late);
                resolve();
            });
            quietly(this.data.oneway.leave()); // the server then closes the connection
        });
        this.end();
    }
    drop(): void {
        if (this.over) return;
        this.over = true;
        this.end();
    }
    private end(): void {
        this.lane.end();
        this.signal?.end();
        this.data.end();
    }
}
const causeOf = (cause: StopCause): Common.CommUtil.StopCause => (cause === "drill" ? CommUtil.StopCause.Drill : CommUtil.StopCause.Requested);
/** Of what may have ended already. */
function quietly(what: PromiseLike<unknown>): void {
    what.then(undefined, () => undefined);
}

/** Opens sessions over Ice: ws and wss in browsers, and tcp, too, in Node. */
export class IceTransport implements Transport {
    async open(login: Login, events: ConnectionEvents): Promise<Connection> {
        const target = parseTarget(login.server);
        const address = endpointAddress(target.endpoint);
        if (!isUsable(target.endpoint)) {
            throw new Refusal(
                "NOT_SUPPORTED",
                target.endpoint.scheme === "tcp"
                    ? `A browser cannot reach ${address}: it needs ws:// or wss://.`
                    : `This program has no WebSocket to reach ${address}; fix: import "@axon/client/node-websocket" before "@axon/client".`,
            );
        }
        let connection: IceConnection | undefined;
        let over = "";
        const closed = (why: string): void => {
            if (over !== "") return;
            over = why;
            connection?.drop();
            if (connection !== undefined) events.closed(why);
        };
        const order = { login, events, timeoutMs: login.timeoutMs, openMs: login.timeoutMs };
        const data = await openLane({ ...order, lane: "data", target, token: "", closed });
        let signal: LaneEnd | undefined;
        try {
            const facts = await data.session.setCallback(data.callback);
            const where = signalEndpoint(facts.signalEndpoint, login, target);
            const certain = where !== undefined && (target.router !== undefined || login.signal !== undefined || where.scheme === "tcp");
            const openSignal = where === undefined ? undefined : (): Promise<LaneEnd> => attach({ ...order, openMs: certain ? login.timeoutMs : Math.min(SIGNAL_MS, login.timeoutMs), lane: "signal", target: { endpoint: where, router: target.router }, token: facts.token, closed });
            // The server may name an endpoint that a browser behind a proxy cannot reach: nobody waits for that one here.
            if (certain) signal = await openSignal?.();
            if (over !== "") throw new Refusal("NOT_CONNECTED", `the connection ended during the log-in: ${over}`);
            connection = new IceConnection(
                {
                    me: senderOf(facts.me),
                    entities: facts.entities,
                    watchdogBusyMs: facts.watchdogBusyMs,
                    watchdogIdleMs: facts.watchdogIdleMs,
                    messageBytesMax: target.router !== undefined || target.endpoint.scheme === "tcp" ? MESSAGE_BYTES_MAX : BROWSER_MESSAGE_BYTES_MAX,
                },
                data,
                signal,
                openSignal,
                target.router !== undefined,
                target.router !== undefined || target.endpoint.scheme !== "tcp",
                () => events.heartbeat(),
                closed,
            );
            return connection;
        } catch (error) {
            over = over === "" ? "it was given up" : over;
            signal?.end();
            data.end();
            throw translate(error, address);
        }
    }
}
