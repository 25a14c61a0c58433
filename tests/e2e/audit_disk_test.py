#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""What a full disk does to the audit trail, and what it does not do to robots, with real processes: the state folder of the
Entity Manager and both trails are on a disk of 512 KiB (a tmpfs) that the test fills.

    python3 tests/e2e/audit_disk_test.py --bin build/dev/bin [unittest options]

Runs itself in a mount namespace of its own (`unshare`), and is skipped where none can be made.
"""
import os
import pathlib
import shutil
import subprocess
import sys
import unittest

ROOT = pathlib.Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(ROOT / "tools"))
import stalls  # noqa: E402
from laboratory import Laboratory, keep_if_failed, programs, robot_ports, wait_until  # noqa: E402

BIN = programs()
# Without a user namespace where that is permitted: in one, no thread may have a real-time priority.
WAYS = [["unshare", "--mount"], ["unshare", "--user", "--map-root-user", "--mount"]]
INSIDE = "AXON_TEST_OWN_MOUNTS"


class AuditDiskTest(unittest.TestCase):
    def setUp(self):
        self.lab = lab = Laboratory(BIN, application="Greeter", ports="%d-%d" % robot_ports(), environment="embedded")
        self.disk = lab.folder / "disk"
        self.disk.mkdir()
        subprocess.run(["mount", "-t", "tmpfs", "-o", "size=512k,mode=700", "tmpfs", self.disk], check=True)
        self.addCleanup(self.tidy)
        self.trails = self.disk / "audit"
        (lab.folder / "server.cfg").write_text(f"Axon.Audit.Folder={self.trails}\n")
        self.start_server()
        folder = lab.folder / "greeter"
        shutil.copytree(ROOT / "examples" / "01_hello_entity", folder)
        (folder / "ports.cfg").write_text(f"Axon.Ports = {lab.ports}\n")
        lab.start("app", "hello-entity", folder, folder / "ports.cfg")
        (lab.folder / "manager.cfg").write_text("Axon.Audit.Folder=audit\n")
        self.manager = lab.start_manager("", "--state", self.disk / "state", "--config", lab.folder / "manager.cfg")
        self.own_trail = self.disk / "state" / "audit"
        lab.wait_for_entity("Greeter")

    def tidy(self):
        self.lab.end()
        subprocess.run(["umount", "--lazy", self.disk], check=False)
        keep_if_failed(self, self.lab.folder)

    def start_server(self, at=None):
        self.lab.start_server(at, "--config", self.lab.folder / "server.cfg")

    def fill(self):
        """Until not a byte is left."""
        with open(self.disk / "filler", "ab", buffering=0) as filler:
            for size in (65536, 1024, 1):
                try:
                    while filler.write(b"x" * size):
                        pass
                except OSError:
                    continue

    def does(self, *words):
        status, lines, errors = self.lab.axon(*words)
        self.assertEqual(status, 0, f"axon {' '.join(words)}: {lines} {errors}")
        return lines

    def records(self, folder, *words):
        status, lines, errors = self.lab.axon("audit", "show", "--folder", str(folder), *words)
        self.assertEqual(status, 0, f"{lines} {errors}")
        return [line for line in lines if line["event"] == "audit_record"]

    def test_a_full_disk_stops_nothing_that_stops_robots_and_is_reported(self):
        self.fill()
        # The rest of the page of each file is still free: until it is used up as well.
        stops = 0
        for _ in range(60):
            self.does("stop", "Greeter")
            self.does("rearm", "Greeter")
            stops += 1
            if all("cannot be written" in process.text() for process in (self.lab.server, self.manager)):
                break
        for process in (self.lab.server, self.manager):
            text = wait_until(lambda p=process: p.text() if "cannot be written" in p.text() else "", f"{process.name} says so")
            self.assertIn("No space left", text)
            self.assertIn("fix: make room on the disk", text)
        # A log-in, a stop with its receipt, and a rearm.
        self.does("ls")
        self.does("stop", "Greeter")
        self.does("rearm", "Greeter")
        stops += 1

        (self.disk / "filler").unlink()
        for process in (self.lab.server, self.manager):
            wait_until(lambda p=process: "records are written again" in p.text(), f"{process.name} writes again", 15)
        # What was done meanwhile has waited.
        for folder in (self.trails, self.own_trail):
            for kind in ("stop", "rearm"):
                wait_until(lambda f=folder, k=kind: len(self.records(f, "--kind", k)) == stops,
                           f"all {stops} {kind}s are in {folder.name}")
            status, lines, _ = self.lab.axon("audit", "verify", str(folder))
            self.assertEqual(status, 0, lines)

    def test_a_kill_while_the_disk_is_full_leaves_a_whole_trail_and_the_next_life_goes_on(self):
        self.fill()
        for _ in range(60):
            self.does("stop", "Greeter")
            if "cannot be written" in self.lab.server.text():
                break
        self.lab.server.kill()
        status, lines, _ = self.lab.axon("audit", "verify", str(self.trails))
        self.assertEqual(status, 0, lines)
        self.start_server(self.lab.at)  # although the disk is full
        wait_until(lambda: "cannot be written" in self.lab.server.text(), "it says so")
        (self.disk / "filler").unlink()
        wait_until(lambda: len(self.records(self.trails, "--kind", "started")) == 2, "the next life is recorded", 15)
        status, lines, _ = self.lab.axon("audit", "verify", str(self.trails))
        self.assertEqual(status, 0, lines)


if __name__ == "__main__":
    if INSIDE not in os.environ:
        for way in WAYS:
            if subprocess.run([*way, "mount", "-t", "tmpfs", "tmpfs", "/mnt"], capture_output=True, check=False).returncode == 0:
                os.execvpe(way[0], [*way, sys.executable, *sys.argv], {**os.environ, INSIDE: "1"})
        print("skipped: mount namespaces cannot be made")
        sys.exit(77)
    stalls.main()
