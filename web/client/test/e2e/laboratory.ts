// SPDX-License-Identifier: GPL-2.0-or-later
// Axon's programs as real processes, each ended by its own id: a server, robot applications and their Entity Managers.
import { type ChildProcess, spawn } from "node:child_process";
import { once } from "node:events";
import { mkdirSync, mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join, resolve } from "node:path";

export const ROOT = resolve(process.env["AXON_ROOT"] ?? "../..");
export const BIN = resolve(process.env["AXON_BIN"] ?? join(ROOT, "build/dev/bin"));

/** Fails loudly if the condition does not hold in time. */
export async function eventually<Value>(what: string, look: () => Value | undefined | false, ms = 8000): Promise<Value> {
    for (const end = performance.now() + ms; ; ) {
        const found = look();
        if (found !== undefined && found !== false) return found;
        if (performance.now() > end) throw new Error(`${what}: not within ${ms} ms`);
        await new Promise((wake) => setTimeout(wake, 10));
    }
}

export class Program {
    output = "";
    readonly child: ChildProcess;
    private readonly exited: Promise<unknown>;

    constructor(
        readonly name: string,
        path: string,
        words: readonly string[],
        env: NodeJS.ProcessEnv,
        cwd: string,
    ) {
        this.child = spawn(path, words, { env, cwd, stdio: ["ignore", "pipe", "pipe"] });
        for (const stream of [this.child.stdout, this.child.stderr]) stream?.on("data", (bytes: Buffer) => (this.output += bytes.toString()));
        this.exited = once(this.child, "exit");
        this.exited.catch(() => undefined);
        const abandon = (): void => void this.child.kill("SIGKILL"); // if a test ends without a word
        process.once("exit", abandon);
        this.child.once("exit", () => process.off("exit", abandon));
    }
    async line(begin: string, ms = 15_000): Promise<string> {
        return eventually(
            `${this.name} says '${begin}'`,
            () => {
                const line = this.output.split("\n").find((one) => one.startsWith(begin));
                if (line === undefined && this.child.exitCode !== null) throw new Error(`${this.name} ended with ${this.child.exitCode}: ${this.output}`);
                return line;
            },
            ms,
        );
    }
    async end(signal: NodeJS.Signals = "SIGTERM"): Promise<void> {
        if (this.child.exitCode !== null || this.child.signalCode !== null) return;
        this.child.kill(signal);
        const late = setTimeout(() => this.child.kill("SIGKILL"), 5000);
        await this.exited;
        clearTimeout(late);
    }
}

export class Laboratory {
    readonly folder = mkdtempSync(join(tmpdir(), "axon-web-"));
    readonly portsFile = join(this.folder, "ports.cfg");
    readonly programs: Program[] = [];
    /** client, client-signal, entity, entity-signal: HOST:PORT of each. */
    at: Record<string, string> = {};
    server!: Program;
    private readonly env: NodeJS.ProcessEnv;
    private readonly ports: string;
    private readonly serverOptions: string[] = [];

    constructor(options: { readonly users?: Record<string, string>; readonly globalServices?: string; readonly more?: readonly string[] } = {}) {
        this.env = { ...process.env, XDG_RUNTIME_DIR: this.folder, XDG_STATE_HOME: join(this.folder, "state") };
        for (const name of ["AXON_SERVER", "AXON_AGENT", "AXON_CONFIG", "AXON_CLOCK"]) delete this.env[name];
        const low = 5600 + ((process.pid * 13) % 2200);
        this.ports = `${low}-${low + 30}`;
        writeFileSync(this.portsFile, `Axon.Ports = ${this.ports}\n`);
        const services = options.globalServices ?? join(this.folder, "globalservices");
        if (options.globalServices === undefined) mkdirSync(services);
        this.serverOptions.push("--global-services", services, ...(options.more ?? []));
    }
    /** Of Axon's own folder, unless it is an absolute path. */
    start(name: string, program: string, ...words: string[]): Program {
        const one = new Program(name, resolve(BIN, program), words, this.env, this.folder);
        this.programs.push(one);
        return one;
    }
    /** On free ports, or on those of the server before. */
    async startServer(): Promise<void> {
        const words = [...this.serverOptions];
        for (const [option, key] of [
            ["--client-endpoint", "client"],
            ["--client-signal-endpoint", "client-signal"],
            ["--entity-endpoint", "entity"],
            ["--entity-signal-endpoint", "entity-signal"],
        ] as const) {
            words.push(option, this.at[key] ?? "127.0.0.1:0");
        }
        this.server = this.start("axon-server", "axon-server", ...words);
        const ready = await this.server.line("ready ");
        this.at = Object.fromEntries(ready.split(" ").slice(1).map((word) => [word.slice(0, word.indexOf("=")), word.slice(word.indexOf("=") + 1)]));
    }
    /** A user of the server, before it starts. */
    async addUser(user: string, role: string, password: string): Promise<void> {
        const users = join(this.folder, "users.cfg");
        const child = spawn(join(BIN, "axon-server"), ["--users", users, "--add-user", user, "--user-role", role], { stdio: ["pipe", "ignore", "inherit"] });
        child.stdin?.end(`${password}\n`);
        await once(child, "exit");
        if (!this.serverOptions.includes(users)) this.serverOptions.push("--users", users);
    }
    /** A robot application and its Entity Manager. */
    startEntity(program: string, application: string, words: readonly string[], config = ""): { app: Program; manager: Program } {
        const app = this.start(program, program, ...words);
        const file = join(this.folder, `${application}.cfg`);
        writeFileSync(file, `Axon.LeaseGrace=3\n${config}`, { mode: 0o600 });
        const manager = this.start(`manager of ${program}`, "axon-entity-manager", "--application", application, "--ports", this.ports, "--server", this.at["entity"] ?? "", "--config", file);
        return { app, manager };
    }
    /** Counts, streams, and stands still 30 ms after a stop (tests/foreign/counter.cpp). */
    startCounter(config = ""): { app: Program; manager: Program } {
        const application = `web-${process.pid}-${this.programs.length}`;
        return this.startEntity("foreign-counter", application, [join(ROOT, "tests/foreign/robot"), this.portsFile, application], config);
    }
    async end(): Promise<void> {
        await Promise.all([...this.programs].reverse().map((one) => one.end()));
        rmSync(this.folder, { recursive: true, force: true });
    }
    log(): string {
        return this.programs.map(({ name, output }) => `== ${name}\n${output}`).join("\n");
    }
}
export const read = (path: string): Uint8Array => readFileSync(path);
