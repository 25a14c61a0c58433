#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""Builds @axon/client and runs its tests: the logic by itself, then against real processes.

    python3 web/client/test/web_client_test.py --bin build/dev/bin [--work FOLDER]

FOLDER takes a copy of the sources, what npm installs and what is built, and is used again by the next run. Nothing is written
into the sources.
"""
import os
import pathlib
import shutil
import subprocess
import sys

ROOT = pathlib.Path(__file__).resolve().parents[3]
sys.path.insert(0, str(ROOT / "tools"))
sys.dont_write_bytecode = True
from laboratory import programs  # noqa: E402

MADE = ("node_modules", "dist", "dist-test", "gen")


def copy(work):
    """The sources as they are now; what was made from them stays."""
    for folder in [work / "client", *(path for path in (work / "client").rglob("*") if path.is_dir() and not set(path.relative_to(work / "client").parts) & set(MADE))]:
        for old in folder.glob("*") if folder.exists() else ():
            if old.is_file():
                old.unlink()
    for name in ("package.json", "package-lock.json", ".npmrc"):
        shutil.copy(ROOT / "web" / name, work / name)
    # Every workspace, so that the lock file fits; only the client is built.
    shutil.copytree(ROOT / "web/client", work / "client", dirs_exist_ok=True, ignore=shutil.ignore_patterns(*MADE))


def main():
    bin_folder = programs()
    work = bin_folder.parent / "web"
    if "--work" in sys.argv:
        work = pathlib.Path(sys.argv[sys.argv.index("--work") + 1]).resolve()
    work.mkdir(parents=True, exist_ok=True)
    copy(work)
    lock = (work / "package-lock.json").read_text()
    installed = work / "installed"  # what `npm ci` was given the last time
    if not installed.exists() or installed.read_text() != lock:
        installed.unlink(missing_ok=True)
        subprocess.run(["npm", "ci", "--ignore-scripts", "--no-audit", "--no-fund"], cwd=work, check=True)
        installed.write_text(lock)
    shutil.rmtree(work / "client/dist-test", ignore_errors=True)
    env = dict(os.environ, AXON_ROOT=str(ROOT), AXON_BIN=str(bin_folder))
    for script in ("build", "test", "test:e2e"):
        done = subprocess.run(["npm", "run", "--silent", script], cwd=work / "client", env=env, check=False)
        if done.returncode != 0:
            sys.exit(f"web_client_test: npm run {script} ended with {done.returncode}")


if __name__ == "__main__":
    main()
