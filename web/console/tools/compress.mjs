// SPDX-License-Identifier: GPL-2.0-or-later
// Puts NAME.br and NAME.gz beside each text file of dist/, for the server to send, and fails if the first page has become too large.
import { readdirSync, readFileSync, statSync, writeFileSync } from "node:fs";
import { extname, join } from "node:path";
import { brotliCompressSync, constants, gzipSync } from "node:zlib";

const FIRST_LOAD_MAX = 400 * 1024;
const dist = new URL("../dist", import.meta.url).pathname;
const packed = new Map();
for (const entry of readdirSync(dist, { recursive: true })) {
    const path = join(dist, entry);
    if (!statSync(path).isFile() || ![".html", ".js", ".css", ".svg"].includes(extname(path))) continue;
    const plain = readFileSync(path);
    const gzip = gzipSync(plain, { level: 9 });
    packed.set(entry, gzip.length);
    writeFileSync(`${path}.gz`, gzip);
    writeFileSync(`${path}.br`, brotliCompressSync(plain, { params: { [constants.BROTLI_PARAM_QUALITY]: 11 } }));
}
// What index.html names is loaded before anything is seen.
const first = ["index.html", ...[...readFileSync(join(dist, "index.html"), "utf8").matchAll(/(?:src|href)="\.\/([^"]+)"/g)].map(([, name]) => name)];
const size = first.reduce((sum, name) => sum + (packed.get(name) ?? 0), 0);
console.log(`first load: ${(size / 1024).toFixed(0)} KiB gzipped (${first.length} files); with everything: ${([...packed.values()].reduce((a, b) => a + b, 0) / 1024).toFixed(0)} KiB`);
if (size > FIRST_LOAD_MAX) throw new Error(`the first load may have at most ${FIRST_LOAD_MAX / 1024} KiB`);
