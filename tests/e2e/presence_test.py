#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""What a person at the command line learns about an entity that is not ready, with real processes.

    python3 tests/e2e/presence_test.py --bin build/dev/bin [unittest options]

The robot application is the shuttle of examples/05_collaboration, with a copy of its profiles that a test may change.
"""
import os
import pathlib
import re
import shutil
import subprocess
import sys
import unittest

ROOT = pathlib.Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(ROOT / "tools"))
import stalls  # noqa: E402
from laboratory import Laboratory, keep_if_failed, programs, wait_until  # noqa: E402

BIN = programs()
EXAMPLE = ROOT / "examples" / "05_collaboration"


class PresenceTest(unittest.TestCase):
    serial = 0

    def setUp(self):
        PresenceTest.serial += 1
        self.lab = Laboratory(BIN, application=f"presence-{os.getpid()}-{PresenceTest.serial}")
        self.addCleanup(self.tidy)
        self.folder = self.lab.folder / "example"
        shutil.copytree(EXAMPLE, self.folder)
        self.basic = self.folder / "shuttle" / "basic.xml"
        self.services = self.folder / "shuttle" / "services.xml"

    def tidy(self):
        self.lab.end()
        keep_if_failed(self, self.lab.folder)

    def start_application(self):
        return self.lab.start(f"app-{len(self.lab.processes)}", "shuttle-entity", self.folder, self.folder / "ports.cfg",
                              "--application", self.lab.application)

    def listed(self, *words):
        """The entities of `axon ls` by name."""
        _, lines, _ = self.lab.axon("ls", *words)
        return {entity["name"]: entity for line in lines for entity in line.get("entities", [])}

    def wait_for(self, name, state, part):
        def there():
            entity = self.listed("--all").get(name)
            return entity if entity and entity["state"] == state and part in entity["reason"] else None
        return wait_until(there, f"{name} in {state} because of '{part}'", 20)

    def doctor(self):
        """(exit status, {name: finding})."""
        status, lines, _ = self.lab.axon("doctor")
        return status, {line["name"]: line for line in lines if line.get("event") == "finding"}

    def test_a_misspelt_application_is_seen_by_everybody(self):
        self.lab.start_server()
        self.start_application()
        manager = self.lab.start_manager("x")
        name = self.lab.application + "x"
        # Other tests' applications may be in the same range of ports.
        entity = self.wait_for(name, "UNAV", f'"{self.lab.application}" (port')
        self.assertFalse(entity["ready"])
        self.assertIn("5500 to 8000", entity["reason"])
        self.assertNotIn(name, self.listed())
        self.assertIn(f'no robot application "{name}" is found', manager.text())
        self.assertIn("--application", manager.text())

        status, lines, errors = self.lab.axon("checkout", name)
        self.assertEqual(status, 1, errors)
        self.assertIn(self.lab.application, str(lines) + errors)
        status, findings = self.doctor()
        self.assertEqual(status, 1)
        self.assertEqual(findings[name]["level"], "bad")
        self.assertIn("no robot application", findings[name]["message"])
        said = subprocess.run([BIN / "axon", "ls"], env=self.lab.env, capture_output=True, text=True, check=False).stdout
        self.assertIn("not ready: axon ls --all shows why", said)
        status, _, errors = self.lab.axon("stop", "--all")
        self.assertEqual(status, 0, errors)

    def test_profiles_that_are_broken_from_the_beginning_are_seen_and_mended(self):
        good = self.services.read_text()
        self.services.write_text(good.replace("type=\"SMPL\"", "", 1))
        self.lab.start_server()
        application = self.start_application()
        self.lab.start_manager()
        self.wait_for(self.lab.application, "ERR", "services.xml:3: error")
        self.assertEqual(self.listed(), {})
        wait_until(lambda: "services.xml:3: error" in application.text(), "the application's log says what is wrong")
        status, findings = self.doctor()
        self.assertEqual((status, findings[self.lab.application]["level"]), (1, "bad"))
        self.services.write_text(good)
        self.lab.wait_for_entity("Shuttle")
        self.assertEqual(list(self.listed("--all")), ["Shuttle"], "the same entity under its own name")

    def test_a_profile_that_is_edited_while_the_entity_is_held_arrives_at_the_release(self):
        self.lab.start_server()
        application = self.start_application()
        manager = self.lab.start_manager()
        self.lab.wait_for_entity("Shuttle")
        status, _, errors = self.lab.axon("checkout", "Shuttle")
        self.assertEqual(status, 0, errors)
        self.basic.write_text(re.sub('descr="[^"]*"', 'descr="Edited."', self.basic.read_text()))
        wait_until(lambda: "kept, and uploaded at its release" in application.text(), "the application's log says that it is kept")
        self.assertIn("kept for its release", manager.text())
        self.assertNotEqual(self.listed()["Shuttle"]["descr"], "Edited.")
        status, _, errors = self.lab.axon("release", "Shuttle")
        self.assertEqual(status, 0, errors)
        wait_until(lambda: self.listed().get("Shuttle", {}).get("descr") == "Edited.", "the edited profile")
        wait_until(lambda: "uploaded now, at the release" in application.text(), "the application's log says that it is uploaded")
        self.assertIn("uploaded now, at the release", manager.text())
        self.lab.wait_for_entity("Shuttle")

    def test_a_server_that_is_not_there_is_reported_without_any_application(self):
        if self.lab.behind_routers:
            self.skipTest("an address without a server is the same there")
        manager = self.lab.start("em", "axon-entity-manager", "--application", self.lab.application, "--server", "127.0.0.1:9")
        manager.wait_for("ready ")
        wait_until(lambda: "no session with the entity server at 127.0.0.1:9" in manager.text(), "the log names the server")


if __name__ == "__main__":
    stalls.main()
