#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""The Debian packages: what is in them, and what a bare Debian 12 makes of them.

    python3 tests/install/packages_test.py BUILD [--update] [--packages DIR] [unittest options]

They are made from the programs of BUILD. The system is made once by debootstrap, in BUILD/debian12, and is booted with an
init of its own in namespaces; nothing of it reaches this machine. Where that cannot be done, the tests are skipped with
the reason. --update writes tests/install/packages.txt anew, the list of the files of each package.
--packages takes packages that are there, such as those of tools/make_packages, instead of making them.
SIGTERM ends the test that runs, and with it the system that it booted. Its mounts are in a namespace of this program's own.
"""
import hashlib
import os
import pathlib
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import unittest

from bare_debian import BareDebian, Unavailable, wait_until

INSIDE = "AXON_PACKAGES_TEST_INSIDE"
if os.geteuid() == 0 and INSIDE not in os.environ:
    own = ["unshare", "--mount", "--propagation", "private"]
    if subprocess.run([*own, "true"], stderr=subprocess.DEVNULL, check=False).returncode == 0:
        os.execvpe(own[0], [*own, sys.executable, *sys.argv], {**os.environ, INSIDE: "1"})
ROOT = pathlib.Path(__file__).resolve().parent.parent.parent
BUILD = pathlib.Path(sys.argv.pop(1)).resolve()
UPDATE = "--update" in sys.argv
if UPDATE:
    sys.argv.remove("--update")
MADE = None
if "--packages" in sys.argv:
    at = sys.argv.index("--packages")
    MADE = pathlib.Path(sys.argv[at + 1]).resolve()
    del sys.argv[at:at + 2]
LIST = ROOT / "tests" / "install" / "packages.txt"
SITE = ROOT / "build" / "docs-site"
PAGES = "./usr/share/doc/axon/html/"
NOT_LISTED = (PAGES, "./usr/share/axon/console/")  # pages, whose names change with their content
PACKAGES = ("axon", "axon-doc", "axon-entity-manager", "axon-lab", "axon-server", "axon-tools", "libaxon-client-dev", "libaxon-entity-interfacer-dev",
            "libaxon-entity-interfacer0", "python3-axon", "python3-axon-entity")


def setUpModule():  # noqa: N802
    global FOLDER, DEBS
    FOLDER = pathlib.Path(tempfile.mkdtemp(prefix="axon-packages-"))
    unittest.addModuleCleanup(shutil.rmtree, FOLDER)
    if not MADE and is_outdated(SITE / "index.html"):
        subprocess.run(["/usr/bin/python3", ROOT / "tools" / "make_docs"], check=True)
    DEBS = by_name(MADE) if MADE else make("first")


def is_outdated(first_page):
    newest = max(path.stat().st_mtime for path in (ROOT / "docs").rglob("*.md"))
    return not first_page.exists() or first_page.stat().st_mtime < newest


def make(name):
    """The packages by their names, as tools/make_packages makes them, but packed faster."""
    place = FOLDER / name
    done = subprocess.run(["cpack", "-G", "DEB", "--config", BUILD / "CPackConfig.cmake", "-B", place, "-D", "CPACK_DEBIAN_COMPRESSION_TYPE=gzip"],
                          stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(done.stdout)
    shutil.rmtree(place / "_CPack_Packages")
    return by_name(place)


def by_name(place):
    return {deb.name.split("_")[0]: deb for deb in sorted(place.glob("*.deb"))}


def field(deb, name):
    return subprocess.run(["dpkg-deb", "--field", deb, name], capture_output=True, text=True, check=True).stdout.strip()


def digest(file):
    return hashlib.sha256(file.read_bytes()).hexdigest()


def may_raise_limits():
    """CAP_SYS_RESOURCE, which root of a container or of some virtual machines lacks; an init without it cannot raise hard limits."""
    effective = re.search(r"^CapEff:\s*([0-9a-f]+)", pathlib.Path("/proc/self/status").read_text(), re.MULTILINE).group(1)
    return bool(int(effective, 16) >> 24 & 1)


class Test(unittest.TestCase):
    """After SIGTERM, unittest cleans up what runs, and begins no other test."""

    def run(self, result=None):
        def end(number, _frame):
            signal.signal(number, signal.SIG_IGN)
            result.stop()
            sys.exit("ended by a signal")

        signal.signal(signal.SIGTERM, end)
        return super().run(result)


class Packages(Test):
    def test_have_the_files_that_are_expected(self):
        lines = []
        for name, deb in sorted(DEBS.items()):
            table = subprocess.run(["dpkg-deb", "--contents", deb], capture_output=True, text=True, check=True).stdout
            for line in table.splitlines():
                mode, owner, _, _, _, path = line.split(maxsplit=5)
                self.assertEqual(owner, "root/root", path)
                if not mode.startswith("d") and not path.startswith(NOT_LISTED):
                    lines.append(f"{name} {path.removeprefix('./')}")
        text = "\n".join(lines) + "\n"
        if UPDATE:
            LIST.write_text(text)
        self.maxDiff = None
        self.assertEqual(text.splitlines(), LIST.read_text().splitlines(), "fix: tests/install/packages_test.py BUILD --update, and look at the difference")

    def test_have_the_documentation(self):
        table = subprocess.run(["dpkg-deb", "--contents", DEBS["axon-doc"]], capture_output=True, text=True, check=True).stdout
        for page in ("index.html", "search.html", "searchindex.js", "licences.txt", *(f"docs/{name}.html" for name in ("questions", "tutorials/your-first-robot"))):
            self.assertIn(f" {PAGES}{page}\n", table)

    def test_are_the_expected_ones_of_one_version(self):
        self.assertEqual(sorted(DEBS), sorted(PACKAGES))
        versions = {field(deb, "Version") for deb in DEBS.values()}
        self.assertEqual(len(versions), 1)
        self.assertRegex(versions.pop(), r"^\d+\.\d+\.\d+([~+]git\d+\.[0-9a-f]{7}|~archive(\.[0-9a-f]+)?)?(\.changed)?-1$")

    def test_are_equal_when_they_are_made_again(self):
        again = make("again")
        self.addCleanup(shutil.rmtree, FOLDER / "again")
        for name, deb in DEBS.items():
            self.assertEqual(digest(deb), digest(again[name]), name)

    def test_lintian_finds_no_error(self):
        if not shutil.which("lintian"):
            self.skipTest("lintian is not installed; fix: tools/install_packages package")
        done = subprocess.run([ROOT / "tools/lint_packages", *DEBS.values()], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
        self.assertEqual(done.returncode, 0, done.stdout)


class BareSystem(Test):
    """In this order, on one system: install, use, upgrade, remove, purge."""

    def test_installs_uses_upgrades_and_removes(self):
        (BUILD / "Testing").mkdir(exist_ok=True)
        log = open(BUILD / "Testing" / "bare_debian.log", "w", encoding="utf-8")
        self.addCleanup(log.close)
        packages = FOLDER / "packages"
        packages.mkdir()
        for deb in DEBS.values():
            shutil.copy(deb, packages)
        for part in ("docs/tutorials", "tests/tutorials"):
            shutil.copytree(ROOT / part, packages / "lessons" / part)
        (packages / "lessons/tools").mkdir()
        shutil.copy(ROOT / "tools/laboratory.py", packages / "lessons/tools")
        folder = FOLDER / "system"
        folder.mkdir()
        try:
            system = BareDebian(BUILD / "debian12", folder, log)
            system.packages = packages
            self.addCleanup(system.end)
            system.make()
            self.download(system)
            system.boot()
        except Unavailable as reason:
            self.skipTest(str(reason))
        self.system, self.folder = system, packages
        self.installs()
        self.units_are_sound()
        self.a_robot_is_seen()
        self.the_lessons_go_as_they_are_printed()
        self.upgrade_keeps_what_was_changed()
        self.removal_stops()
        self.what_was_enabled_comes_back()
        self.purge_of_one_keeps_the_other()
        self.purge_leaves_nothing()

    def download(self, system):
        done = system.run_outside("apt-get", "update")
        if done.returncode != 0 or "Failed to fetch" in done.stdout:
            raise Unavailable("apt in the bare system cannot reach its mirror")
        # The compiler is what the lessons about programs of one's own ask for, and IceGrid what its units start.
        done = system.run_outside("sh", "-c", "apt-get install -y --download-only g++ cmake make zeroc-icegrid zeroc-ice-utils /mnt/*.deb")
        self.assertEqual(done.returncode, 0, done.stdout)

    def ok(self, *words, **options):
        done = self.system.run(*words, **options)
        self.assertEqual(done.returncode, 0, f"{' '.join(map(str, words))}:\n{done.stdout}")
        return done.stdout

    def active(self, unit):
        return self.system.run("systemctl", "is-active", unit).stdout.strip()

    def installs(self):
        self.ok("sh", "-c", "apt-get install -y /mnt/*.deb")
        self.assertEqual(self.active("axon-server"), "active", self.system.run("journalctl", "-u", "axon-server", "--no-pager").stdout)
        self.assertEqual(self.ok("systemctl", "is-enabled", "axon-server").strip(), "enabled")
        for program in sorted(line.split("/")[-1] for line in LIST.read_text().splitlines() if " usr/bin/" in line):
            done = self.system.run(program, "--help")
            self.assertEqual(done.returncode, 0, done.stdout)
            self.assertIn(program, done.stdout)
        self.assertIn(f"{PAGES[1:]}docs", self.ok("axon", "docs", "--path", "docs/questions.md"))

    def units_are_sound(self):
        self.ok("apt-get", "install", "-y", "--no-install-recommends", "zeroc-icegrid", "zeroc-ice-utils")
        for unit in ("axon-server.service", "axon-partner@b.service", "axon-entity-manager@Greeter.service", "axon-icegridregistry.service", "axon-icegridnode.service"):
            self.assertEqual(self.ok("systemd-analyze", "verify", unit), "", unit)
            exposure = self.ok("systemd-analyze", "security", "--no-pager", unit)
            level = float(re.search(r"Overall exposure level for \S+: ([\d.]+)", exposure).group(1))
            self.assertLess(level, 3.5, exposure)
        self.ok("apt-get", "purge", "-y", "zeroc-icegrid", "zeroc-ice-utils")  # its own registry and node run since

    def a_robot_is_seen(self):
        """What docs/how-to/install.md says for the first entity."""
        self.ok("systemd-run", "--unit=greeter", "--uid=axon", "hello-entity")
        self.ok("systemctl", "enable", "--now", "axon-entity-manager@Greeter")
        wait_until(lambda: re.search(r"Greeter .*IDLE", self.system.run("axon", "ls").stdout), "axon ls shows the Greeter", 30)
        self.assertIn("succeeded", self.ok("axon", "run", "Greeter", "Greet", "Name=you"))
        self.assertTrue((self.system.root / "var/lib/axon/Greeter").is_dir())
        for unit in ("axon-server", "axon-entity-manager@Greeter"):  # the sandbox lets them have what they ask for
            if not may_raise_limits():
                print("limits of the units are not checked: root of this machine lacks CAP_SYS_RESOURCE", file=sys.stderr)
                break
            said = self.ok("journalctl", "--no-pager", "-u", unit)
            self.assertNotIn("memory is not locked", said)
            process = self.ok("systemctl", "show", "--value", "--property=MainPID", unit).strip()
            self.assertIn("SCHED_RR", self.ok("chrt", "--all-tasks", "--pid", process), f"{unit} has no thread for signals")
        # A password goes into it.
        self.assertEqual(self.ok("stat", "--format=%U:%G %a", "/etc/axon/entitymanager.cfg").strip(), "root:axon 640")
        # A user that root adds can be read by the server.
        self.ok("sh", "-c", "echo secret | axon-server --users /etc/axon/users.cfg --add-user client1 --user-role operator")
        self.ok("runuser", "-u", "axon", "--", "grep", "-q", "^client1 operator", "/etc/axon/users.cfg")

    def the_lessons_go_as_they_are_printed(self):
        self.ok("apt-get", "install", "-y", "g++", "cmake", "make")
        failed = []
        for page in sorted(path.name for path in (self.folder / "lessons/docs/tutorials").glob("*.md")):
            done = self.system.run("python3", "/mnt/lessons/tests/tutorials/page_test.py", f"/mnt/lessons/docs/tutorials/{page}", "--installed", timeout=600)
            if done.returncode != 0:
                failed.append(done.stdout)
        self.assertFalse(failed, "\n".join(failed))

    def upgrade_keeps_what_was_changed(self):
        self.ok("sh", "-c", "echo Axon.DrillPeriod=60 >>/etc/axon/server.cfg")
        newer = self.folder / "newer"
        newer.mkdir()
        for name, deb in DEBS.items():
            self.newer(deb, newer)
        self.ok("sh", "-c", "apt-get install -y --no-install-recommends -o Dpkg::Options::=--force-confold /mnt/newer/*.deb")
        self.assertIn("Axon.DrillPeriod=60", self.ok("cat", "/etc/axon/server.cfg"))
        self.assertIn("of the newer package", self.ok("cat", "/etc/axon/server.cfg.dpkg-dist"))
        self.assertIn("of the newer package", self.ok("cat", "/etc/axon/entitymanager.cfg"))  # nobody had changed it
        self.assertEqual(self.active("axon-server"), "active")
        self.assertEqual(self.active("axon-entity-manager@Greeter"), "active")
        ready = [line for line in self.ok("journalctl", "--no-pager", "-o", "cat", "-u", "axon-entity-manager@Greeter").splitlines() if line.startswith("ready ")]
        self.assertGreaterEqual(len(ready), 2, "it was not started again")
        self.assertEqual(len(set(ready)), 1, "the entity has another identity")
        self.assertIn("client1", self.ok("cat", "/etc/axon/users.cfg"))

    def newer(self, deb, to):
        """The same package with a higher version and another line in its settings."""
        content = FOLDER / f"{deb.stem}.content"
        subprocess.run(["dpkg-deb", "--raw-extract", deb, content], check=True)
        control = content / "DEBIAN/control"
        version = field(deb, "Version")  # also that of the packages that it depends on
        control.write_text(control.read_text().replace(version, f"{version}.1"))
        for settings in content.glob("etc/axon/*.cfg"):
            settings.write_text(settings.read_text() + "# a line of the newer package\n")
        subprocess.run(["dpkg-deb", "--build", "--root-owner-group", "-Znone", content, to], check=True, stdout=subprocess.DEVNULL)
        shutil.rmtree(content)

    def removal_stops(self):
        self.ok("apt-get", "remove", "-y", "axon-server", "axon-entity-manager")
        for unit in ("axon-server", "axon-entity-manager@Greeter"):
            self.assertNotEqual(self.active(unit), "active")
        self.assertNotRegex(self.ok("sh", "-c", "cat /proc/[0-9]*/comm"), "axon-server|axon-entity-man")
        self.assertIn("Axon.DrillPeriod=60", self.ok("cat", "/etc/axon/server.cfg"))
        self.assertTrue((self.system.root / "var/lib/axon/Greeter").is_dir())
        self.ok("getent", "passwd", "axon")

    def what_was_enabled_comes_back(self):
        self.ok("sh", "-c", "apt-get install -y --no-install-recommends /mnt/newer/*.deb")
        for unit in ("axon-server", "axon-entity-manager@Greeter"):
            self.assertEqual(self.active(unit), "active", unit)
        self.assertIn("client1", self.ok("cat", "/etc/axon/users.cfg"))
        # What the administrator has switched off stays off.
        self.ok("systemctl", "disable", "--now", "axon-server")
        self.ok("sh", "-c", "apt-get install -y --reinstall --no-install-recommends /mnt/newer/axon-server_*.deb")
        self.assertNotEqual(self.system.run("systemctl", "is-enabled", "axon-server").stdout.strip(), "enabled")

    def purge_of_one_keeps_the_other(self):
        self.ok("apt-get", "purge", "-y", "axon-server")
        self.assertEqual(self.active("axon-entity-manager@Greeter"), "active")
        self.ok("getent", "passwd", "axon")
        self.assertTrue((self.system.root / "var/lib/axon/Greeter").is_dir())

    def purge_leaves_nothing(self):
        self.ok("systemctl", "stop", "greeter")
        self.ok("apt-get", "purge", "-y", "?name(^axon)", "?name(^libaxon)")
        for left in ("etc/axon", "etc/default/axon-server", "var/lib/axon", "etc/systemd/system/multi-user.target.wants/axon-server.service",
                     "etc/systemd/system/multi-user.target.wants/axon-entity-manager@Greeter.service"):
            self.assertFalse(os.path.lexists(self.system.root / left), left)
        self.assertNotEqual(self.system.run("getent", "passwd", "axon").returncode, 0)


if __name__ == "__main__":
    unittest.main(verbosity=2)
