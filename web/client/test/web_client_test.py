#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""Builds @axon/client and runs its tests: the logic by itself, then against real processes.

    python3 web/client/test/web_client_test.py --bin build/dev/bin [--work FOLDER]

FOLDER takes a copy of the sources, what npm installs and what is built, and is used again by the next run. Nothing is written
into the sources.
"""
import pathlib
import shutil
import sys

ROOT = pathlib.Path(__file__).resolve().parents[3]
sys.path[:0] = [str(ROOT / "tools"), str(ROOT / "web" / "tools")]
sys.dont_write_bytecode = True
import workspace  # noqa: E402
from laboratory import programs  # noqa: E402


def main():
    bin_folder = programs()
    work = bin_folder.parent / "web" / "work"
    if "--work" in sys.argv:
        work = pathlib.Path(sys.argv[sys.argv.index("--work") + 1]).resolve()
    workspace.prepare(work)
    shutil.rmtree(work / "client/dist-test", ignore_errors=True)
    for script in ("build", "test", "test:e2e"):
        workspace.run(work, "client", script, env={"AXON_BIN": str(bin_folder)})


if __name__ == "__main__":
    try:
        main()
    except workspace.Failed as why:
        sys.exit(f"web_client_test: {why}")
