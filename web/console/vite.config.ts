// SPDX-License-Identifier: GPL-2.0-or-later
import { defineConfig } from "vite";

export default defineConfig({
    base: "./",
    // The server permits no inline script, style or data: font (docs/reference/console.md).
    build: { target: "es2022", assetsInlineLimit: 0, modulePreload: { polyfill: false }, reportCompressedSize: false },
    esbuild: { jsx: "automatic", jsxImportSource: "preact", legalComments: "none" },
});
