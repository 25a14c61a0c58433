# SPDX-License-Identifier: GPL-2.0-or-later
"""How long a task takes from Python, beside the same from C++, by turns in one run; and what pictures cost.

    AXON_BIN=build/release/bin AXON_TEST_BIN=build/release/tests PYTHONPATH=build/release/python python3 -m pytest -s python/tests/benchmark_test.py
"""
import resource
import subprocess
import time

import pytest

import axon
from support import BIN, ROOT, TEST_BIN
from laboratory import Laboratory, robot_ports  # noqa: E402  (support has set the path)


@pytest.fixture
def two_cameras():
    lab = Laboratory(BIN, environment="embedded")
    lab.start_server()
    profiles = ROOT / "python/tests/camera"
    for number, name in enumerate(("Camera", "Second")):
        folder = lab.folder / name
        folder.mkdir()
        (folder / "basic.xml").write_text((profiles / "basic.xml").read_text().replace('"Camera"', f'"{name}"'))
        (folder / "services.xml").write_bytes((profiles / "services.xml").read_bytes())
        ports = lab.folder / f"{name}.cfg"
        first = robot_ports()[0] + number * 5
        ports.write_text(f"Axon.Ports = {first}-{first + 4}\n")
        its_own = dict(lab.env, XDG_STATE_HOME=str(folder / "state"))
        lab.start(f"camera-{name}", TEST_BIN / "camera-entity", folder, ports, env=its_own)
        lab.start(f"em-{name}", "axon-entity-manager", "--application", "Camera", "--ports-file", ports, *lab.manager_options([]), env=its_own)
        lab.wait_for_entity(name)
    yield lab
    lab.end()


def median(numbers):
    return sorted(numbers)[len(numbers) // 2]


def test_a_task_from_python_takes_at_most_four_times_as_long_as_from_cpp(two_cameras):
    lab = two_cameras
    rounds, each = 10, 100
    native, python = [], []
    cpp = subprocess.Popen([TEST_BIN / "round-trips", lab.at["client"], "Second"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        assert cpp.stdout.readline() == "ready\n"
        with axon.connect(lab.at["client"]) as client, client.checkout("Camera") as robot:
            for number in range(rounds + 1):
                cpp.stdin.write(f"{each}\n")
                cpp.stdin.flush()
                of_cpp = [int(word) for word in cpp.stdout.readline().split()]
                of_python = []
                for _ in range(each):
                    begin = time.perf_counter()
                    robot.run("Nothing")
                    of_python.append((time.perf_counter() - begin) * 1e6)
                if number:  # the first round warms up
                    native += of_cpp
                    python += of_python
    finally:
        cpp.stdin.close()
        cpp.wait(10)
        cpp.stdout.close()
    print(f"\ntask, median of {len(native)}: C++ {median(native):.0f} µs, Python {median(python):.0f} µs, "
          f"ratio {median(python) / median(native):.2f}")
    assert median(python) <= 4 * median(native)


def test_pictures_at_thirty_hertz_cost_little(two_cameras):
    with axon.connect(two_cameras.at["client"]) as client, client.stream("Camera", "eye").watch() as eye:
        eye.take(5)
        before, begin = resource.getrusage(resource.RUSAGE_SELF), time.monotonic()
        samples, bright = [], 0
        for sample in eye:
            samples.append(sample)
            bright += int(sample.data[0, 0, 0])  # each is read as it comes, as a program does
            if len(samples) == 90:
                break
        took = time.monotonic() - begin
        after = resource.getrusage(resource.RUSAGE_SELF)
    used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    print(f"\n640 x 480 pictures: {90 / took:.1f} per second, {100 * used / took:.0f} % of a core")
    assert samples[-1].sequence - samples[0].sequence == 89, "none was dropped"
    assert bright == sum(sample.sequence % 256 for sample in samples)
    assert 90 / took > 28
    assert used / took < 0.3, "of a core"
