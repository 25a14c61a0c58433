# SPDX-License-Identifier: GPL-2.0-or-later
"""A bare Debian 12 in a folder, with an init of its own: made by debootstrap, changed in an overlay, booted in namespaces."""
import contextlib
import os
import pathlib
import shutil
import signal
import subprocess
import sys
import uuid

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent.parent.parent / "tools"))
from laboratory import Failed, wait_until  # noqa: E402

INCLUDED = "systemd,systemd-sysv,dbus,iproute2"  # what a bare Debian has and debootstrap's smallest variant lacks
NAMESPACES = ("--mount", "--uts", "--ipc", "--net", "--pid")

# Inside the new namespaces: the devices that programs need, an own view of processes and control groups, and systemd.
BOOT = r"""
set -e
root=$1
mount -t proc proc "$root/proc"
mount -t sysfs -o ro sysfs "$root/sys"
mount -t tmpfs -o mode=755 dev "$root/dev"
for device in null zero full random urandom tty; do
    : >"$root/dev/$device"
    mount --bind "/dev/$device" "$root/dev/$device"
done
mkdir "$root/dev/pts" "$root/dev/shm"
mount -t devpts -o newinstance,ptmxmode=666,mode=620 devpts "$root/dev/pts"
ln -s pts/ptmx "$root/dev/ptmx" # PrivateDevices wants it
ln -s /proc/self/fd "$root/dev/fd"
mount -t tmpfs -o mode=1777 shm "$root/dev/shm"
mount -t tmpfs -o mode=755 run "$root/run"
mount -t tmpfs -o mode=1777 tmp "$root/tmp"
mount --bind "$2" "$root/mnt"
mount -o remount,bind,ro "$root/mnt"
mount -t cgroup2 cgroup2 "$root/sys/fs/cgroup"
cd "$root"
mkdir -p .outside
pivot_root . .outside
umount --lazy /.outside
exec env -i container=axon-test PATH=/usr/sbin:/usr/bin:/sbin:/bin /lib/systemd/systemd --unit=multi-user.target --show-status=no
"""


class Unavailable(Exception):
    """Why there can be none here."""


def debian_sources():
    """The lines "SITE SUITE" of Debian 12 in this machine's own configuration of apt; the first is that of the release."""
    done = subprocess.run(["apt-get", "indextargets", "--format", "$(ORIGIN)|$(SITE)|$(RELEASE)|$(COMPONENT)", "Created-By: Packages"],
                          capture_output=True, text=True, check=False)
    found = {tuple(line.split("|")[1:3]) for line in done.stdout.splitlines() if line.startswith("Debian|") and line.endswith("|main")}
    found = sorted((source for source in found if source[1].startswith("bookworm") and "backports" not in source[1]),
                   key=lambda source: (source[1] != "bookworm", source))
    if not found or found[0][1] != "bookworm":
        raise Unavailable("apt of this machine knows no mirror of Debian 12 (bookworm, main)")
    return found


def proxy():
    """apt's proxy as environment, since debootstrap does not read the configuration of apt."""
    done = subprocess.run(["apt-config", "shell", "proxy", "Acquire::http::Proxy"], capture_output=True, text=True, check=False)
    value = done.stdout.strip().removeprefix("proxy=").strip("'")
    return {"http_proxy": value} if value else {}


class BareDebian:
    """`cache` outlasts the test: it holds the system as debootstrap made it, and the packages that apt has downloaded."""

    def __init__(self, cache, folder, log):
        self.cache, self.folder, self.log = pathlib.Path(cache), pathlib.Path(folder), log
        self.base = self.cache / "system"
        self.root = self.folder / "root"
        self.init = None
        if os.geteuid() != 0:
            raise Unavailable("it takes root to make a system of its own")
        for program in ("debootstrap", "unshare", "nsenter"):
            if not shutil.which(program):
                raise Unavailable(f"{program} is not installed; fix: tools/install_packages package")
        self.sources = debian_sources()

    def make(self):
        if not (self.cache / "complete").exists():
            for left in (self.base, self.cache / "archives"):
                shutil.rmtree(left, ignore_errors=True)
            self.cache.mkdir(parents=True, exist_ok=True)
            done = subprocess.run(["debootstrap", "--variant=minbase", f"--include={INCLUDED}", "bookworm", self.base, self.sources[0][0]],
                                  env={**os.environ, **proxy()}, stdout=self.log, stderr=subprocess.STDOUT, check=False)
            if done.returncode != 0:
                raise Unavailable("debootstrap failed: the mirror cannot be reached, or this machine permits no devices")
            lines = "".join(f"deb {site} {suite} main\n" for site, suite in self.sources)
            (self.base / "etc/apt/sources.list").write_text(lines)
            apt = 'APT::Install-Recommends "false";\nAPT::Sandbox::User "root";\n'
            if proxy():
                apt += f'Acquire::http::Proxy "{proxy()["http_proxy"]}";\n'
            (self.base / "etc/apt/apt.conf.d/90test").write_text(apt)
            shutil.rmtree(self.base / "var/cache/apt/archives")
            (self.base / "var/cache/apt/archives").symlink_to("/archives")
            (self.base / "archives").mkdir()
            (self.cache / "archives/partial").mkdir(parents=True)
            (self.cache / "complete").touch()
        for name in ("changes", "work", "root"):
            (self.folder / name).mkdir()
        # Nothing of it outlasts the test, so dpkg does not wait for the disk (volatile).
        place = f"lowerdir={self.base},upperdir={self.folder}/changes,workdir={self.folder}/work,volatile"
        done = subprocess.run(["mount", "-t", "overlay", "overlay", "-o", place, self.root], capture_output=True, text=True, check=False)
        if done.returncode != 0:
            raise Unavailable(f"there are no overlays here: {done.stderr.strip()}")
        self.mounted = [self.root]
        (self.root / "etc/machine-id").write_text(f"{uuid.uuid4().hex}\n")  # without one, systemd asks for settings
        (self.root / "archives").mkdir(exist_ok=True)
        subprocess.run(["mount", "--bind", self.cache / "archives", self.root / "archives"], check=True)
        self.mounted.append(self.root / "archives")

    def run_outside(self, *words):
        """In the folder, but with this machine's network, and without an init."""
        command = ["unshare", "--mount", "--pid", "--fork", "--kill-child", "sh", "-c",
                   'mount -t proc proc "$0/proc" && cp -L /etc/resolv.conf "$0/etc/resolv.conf" && mount --bind "$1" "$0/mnt" && root=$0 && shift && exec chroot "$root" "$@"',
                   self.root, self.packages, *words]
        done = subprocess.run(command, env={"PATH": "/usr/sbin:/usr/bin:/sbin:/bin", "DEBIAN_FRONTEND": "noninteractive", "LC_ALL": "C.UTF-8"},
                              stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=900, check=False)
        self.log.write(f"$ {' '.join(map(str, words))}\n{done.stdout}\n")
        self.log.flush()
        return done

    def boot(self, seconds=60):
        """Starts systemd. It is the init of its own processes, and has a network with loopback only."""
        mounts = pathlib.Path("/proc/self/mountinfo").read_text().splitlines()
        groups = next((pathlib.Path(line.split()[4]) for line in mounts if " - cgroup2 " in line), None)
        if not groups:
            raise Unavailable("there are no control groups of version 2 here, which systemd needs")
        self.group = groups / f"axon-test-{os.getpid()}"
        self.group.mkdir()
        self.starter = subprocess.Popen(
            ["setpriv", "--pdeathsig", "KILL", "sh", "-c", 'echo $$ >"$0/cgroup.procs" && exec "$@"', self.group, "unshare", *NAMESPACES, "--cgroup", "--propagation", "private", "--fork", "--kill-child",
             "sh", "-c", BOOT, "sh", self.root, self.packages], stdin=subprocess.DEVNULL, stdout=self.log, stderr=subprocess.STDOUT)
        try:
            wait_until(self.has_booted, "systemd runs", seconds)
        except Failed as failure:
            raise Unavailable(f"systemd does not start here: {failure}") from failure

    def has_booted(self):
        if self.starter.poll() is not None:
            raise Unavailable("systemd does not start here: it has ended")
        children = pathlib.Path(f"/proc/{self.starter.pid}/task/{self.starter.pid}/children").read_text().split()
        if not children or pathlib.Path(f"/proc/{children[0]}/comm").read_text().strip() != "systemd":
            return False
        self.init = int(children[0])
        return self.run("systemctl", "is-system-running").stdout.strip() in ("running", "degraded")

    def run(self, *words, user=None, timeout=300):
        """In the booted system; stdout and stderr together."""
        command = ["nsenter", "--target", str(self.init), "--mount", "--uts", "--ipc", "--net", "--pid", "--cgroup", "--root", "--wd",
                   *(["runuser", "-u", user, "--"] if user else []), *map(str, words)]
        done = subprocess.run(command, env={"PATH": "/usr/sbin:/usr/bin:/sbin:/bin", "DEBIAN_FRONTEND": "noninteractive", "LC_ALL": "C.UTF-8", "HOME": "/root"},
                              cwd="/", stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=timeout, check=False)
        self.log.write(f"# {' '.join(map(str, words))}\n{done.stdout}\n")
        self.log.flush()
        return done

    def group_is_gone(self):
        try:
            for inner in sorted((path for path in self.group.rglob("*") if path.is_dir()), reverse=True):
                inner.rmdir()
            self.group.rmdir()
        except OSError:  # something of it still ends
            return False
        return True

    def end(self):
        if getattr(self, "starter", None):
            if self.init:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(self.init, signal.SIGKILL)  # the first of its namespace: the others end with it
            with contextlib.suppress(ProcessLookupError):
                self.starter.kill()
            self.starter.wait()
            wait_until(self.group_is_gone, "all processes of the system have ended", 10)
        for place in reversed(getattr(self, "mounted", [])):
            subprocess.run(["umount", place], check=False)
