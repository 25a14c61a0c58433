#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""Copies the sources of web/ into a work folder, installs what the lock file names there, and runs npm scripts.

    python3 web/tools/workspace.py --work FOLDER --install-to FOLDER

builds the console and puts its files into the second folder, unless they are already made from these sources. Nothing is
written into the sources.
"""
import argparse
import hashlib
import os
import pathlib
import shutil
import subprocess
import sys

WEB = pathlib.Path(__file__).resolve().parents[1]
MEMBERS = ("client", "console")
MADE = ("node_modules", "dist", "dist-test", "gen")


class Failed(Exception):
    """What went wrong, and what to do about it."""


def sources():
    """Every file that can change what is built, relative to the repository."""
    root = WEB.parent
    for name in ("web/package.json", "web/package-lock.json", "web/.npmrc", "web/tools/workspace.py", "src/common/axon/refusals.def"):
        yield root / name
    for folder in (*(WEB / member for member in MEMBERS), root / "api"):
        for path in sorted(folder.rglob("*")):
            if path.is_file() and not set(path.relative_to(folder).parts) & set(MADE):
                yield path


def digest():
    found = hashlib.sha256()
    for path in sources():
        found.update(f"{path.relative_to(WEB.parent)}\n".encode() + path.read_bytes())
    return found.hexdigest()


def copy(work):
    """The sources as they are now; what was made from them stays."""
    for member in MEMBERS:
        old = work / member
        for path in old.rglob("*") if old.exists() else ():
            if path.is_file() and not set(path.relative_to(old).parts) & set(MADE):
                path.unlink()
        shutil.copytree(WEB / member, old, dirs_exist_ok=True, ignore=shutil.ignore_patterns(*MADE))
    for name in ("package.json", "package-lock.json", ".npmrc"):
        shutil.copy(WEB / name, work / name)


def run(work, member, *words, env=None):
    done = subprocess.run(["npm", "run", "--silent", *words], cwd=work / member,
                          env=dict(os.environ, AXON_ROOT=str(WEB.parent), **(env or {})), check=False)
    if done.returncode != 0:
        raise Failed(f"npm run {' '.join(words)} in web/{member} ended with {done.returncode}")


def prepare(work):
    """Copies the sources and installs packages, if the lock file has changed since the last time."""
    work.mkdir(parents=True, exist_ok=True)
    copy(work)
    lock = (work / "package-lock.json").read_text()
    installed = work / "installed"  # what `npm ci` was given the last time
    if installed.exists() and installed.read_text() == lock:
        return
    installed.unlink(missing_ok=True)
    done = subprocess.run(["npm", "ci", "--ignore-scripts", "--no-audit", "--no-fund"], cwd=work, check=False)
    if done.returncode != 0:
        raise Failed("npm cannot install the packages of web/package-lock.json; fix: let it reach its registry, or build "
                     "without the web console: cmake -DAXON_WEB=OFF")
    installed.write_text(lock)


def build_console(work):
    """Returns the folder of what was built. Does nothing if it is already made from these sources."""
    dist = work / "console" / "dist"
    mark = work / "built"
    now = digest()
    if mark.exists() and mark.read_text() == now and (dist / "index.html").exists():
        return dist
    mark.unlink(missing_ok=True)
    prepare(work)
    run(work, "client", "build")
    run(work, "console", "build")
    mark.write_text(now)
    return dist


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--work", type=pathlib.Path, required=True)
    parser.add_argument("--install-to", type=pathlib.Path, required=True)
    args = parser.parse_args()
    work, to = args.work.resolve(), args.install_to.resolve()
    mark = work / "served"  # what is in `to`
    now = digest()
    if mark.exists() and mark.read_text() == now and (to / "index.html").exists():
        return
    mark.unlink(missing_ok=True)
    dist = build_console(work)
    # index.html last: a server reads the folder again when it changes.
    fresh = to.with_name(to.name + ".new")
    shutil.rmtree(fresh, ignore_errors=True)
    shutil.copytree(dist, fresh)
    shutil.rmtree(to, ignore_errors=True)
    fresh.rename(to)
    mark.write_text(now)


if __name__ == "__main__":
    try:
        main()
    except Failed as why:
        sys.exit(f"web/tools/workspace.py: {why}")
