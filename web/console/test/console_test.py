#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""Builds the web console and uses it in Chromium, with real processes.

    python3 web/console/test/console_test.py --bin build/dev/bin [--work FOLDER] [--only TEST | --without TEST] [--pictures FOLDER]

FOLDER takes a copy of the sources, what npm installs and what is built, and is used again by the next run. TEST is
the name of one test of console_test.mjs. With --pictures it takes those of the documentation instead of testing. Ends with 77 if there
is no Chromium.
"""
import os
import pathlib
import shutil
import subprocess
import sys

ROOT = pathlib.Path(__file__).resolve().parents[3]
sys.path[:0] = [str(ROOT / "tools"), str(ROOT / "web" / "tools")]
sys.dont_write_bytecode = True
import workspace  # noqa: E402
from laboratory import programs  # noqa: E402

SKIPPED = 77


def option(name):
    return sys.argv[sys.argv.index(name) + 1] if name in sys.argv else None


def folder(name):
    return pathlib.Path(option(name)).resolve() if option(name) else None


def tests():
    """What node is to run."""
    files = ["test/e2e/console_test.mjs"]
    if option("--only"):
        return [f"--test-name-pattern=^{option('--only')}$", *files]
    files.insert(0, "test/unit/parts_test.mjs")
    return [*([f"--test-name-pattern=^(?!{option('--without')}$)"] if option("--without") else []), *files]


def main():
    bin_folder = programs()
    chromium = os.environ.get("AXON_CHROMIUM") or shutil.which("chromium") or shutil.which("chromium-browser")
    if not chromium:
        print("console_test: skipped, because there is no Chromium; fix: install Debian's chromium, or name one in AXON_CHROMIUM")
        sys.exit(SKIPPED)
    work = folder("--work") or bin_folder.parent / "web" / "work"
    workspace.build_console(work)
    shutil.rmtree(work / "client/dist-test", ignore_errors=True)
    subprocess.run(["npx", "--no-install", "tsc", "-p", "test"], cwd=work / "client", check=True)  # its laboratory
    env = dict(os.environ, AXON_ROOT=str(ROOT), AXON_BIN=str(bin_folder), AXON_CHROMIUM=chromium)
    pictures = folder("--pictures")
    command = ["node", "tools/pictures.mjs", str(pictures)] if pictures else ["node", "--test", "--test-reporter=spec", *tests()]
    sys.exit(subprocess.run(command, cwd=work / "console", env=env, check=False).returncode)


if __name__ == "__main__":
    try:
        main()
    except workspace.Failed as why:
        sys.exit(f"console_test: {why}")
