#!/usr/bin/python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""What a Python entity sustains: feedback of 100 bytes at 1 kHz, and images of 640 x 480 (rgb8) at 30 Hz.

    PYTHONPATH=build/release/python /usr/bin/python3 bench/python_entity.py --seconds 10

The robot is a process of its own; this program is its Entity Manager (axon_entity.testing) and counts what arrives. "late" is by how much the
robot was behind its schedule, "publish" how long one call took.
Exit status: 1 if something was lost, or the rate was below --least of the wanted one; 2 if it could not be run.
"""
import argparse
import json
import pathlib
import subprocess
import sys
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "tools"))
from laboratory import robot_ports  # noqa: E402

FEEDBACK_HZ, FEEDBACK_BYTES = 1000, 100
IMAGE_HZ, WIDTH, HEIGHT = 30, 640, 480


def percentile(values, part):
    values = sorted(values)
    return values[min(len(values) - 1, int(part * len(values)))]


def robot(ports):
    import numpy
    import axon_entity

    entity = axon_entity.Entity("Bench", category="MACHINE", ports=ports)
    stream = entity.stream("camera")

    def at_pace(task, hz, seconds, act):
        """Calls act(i) on schedule; how long it took, how late each call was and how long it lasted."""
        late, lasted = [], []
        began = time.monotonic()
        for i in range(int(hz * seconds)):
            due = began + i / hz
            if (left := due - time.monotonic()) > 0 and not task.wait(left):
                break
            call = time.monotonic()
            act(i)
            late.append(call - due)
            lasted.append(time.monotonic() - call)
        took = time.monotonic() - began
        return json.dumps({"n": len(late), "hz": len(late) / took, "late_p50_ms": percentile(late, 0.5) * 1e3, "late_p99_ms": percentile(late, 0.99) * 1e3,
                           "late_max_ms": max(late) * 1e3, "publish_p50_ms": percentile(lasted, 0.5) * 1e3, "publish_p99_ms": percentile(lasted, 0.99) * 1e3})

    @entity.service("Feedback")
    def feedback(task: axon_entity.Task, Seconds: float) -> None:
        text = "x" * (FEEDBACK_BYTES - 6)
        said = at_pace(task, FEEDBACK_HZ, Seconds, lambda i: task.feedback(f"{i:06}{text}"))
        entity.info(said)

    @entity.service("Images")
    def images(task: axon_entity.Task, Seconds: float) -> None:
        picture = numpy.zeros((HEIGHT, WIDTH, 3), dtype=numpy.uint8)

        def publish(i):
            picture[:] = i % 256
            stream.publish(picture)

        entity.info(at_pace(task, IMAGE_HZ, Seconds, publish))

    entity.run()


def measure(manager, service, seconds):
    """The robot's figures, and how many have arrived."""
    task = manager.run(service, Seconds=seconds)
    task.expect_granted()
    hz = FEEDBACK_HZ if service == "Feedback" else IMAGE_HZ
    arrived = lost = 0
    first = last = None
    for i in range(int(hz * seconds)):
        if service == "Feedback":
            text = task.expect_feedback()
            lost += text[:6] != f"{i:06}" or len(text) != FEEDBACK_BYTES
        else:
            sample = manager.expect_sample("camera")
            first = sample.sequence if first is None else first
            last = sample.sequence
            lost = last - first - i
            if len(sample.data) < WIDTH * HEIGHT * 3:
                raise AssertionError(f"an image of {len(sample.data)} bytes")
        arrived += 1
    task.expect_succeeded()
    return {**json.loads(manager.expect_text("{")), "arrived": arrived, "lost": int(lost)}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=10, help="how long each is measured (default: 10)")
    parser.add_argument("--least", type=float, default=0.99, help="bound of the rate, as a part of the wanted one (default: 0.99)")
    parser.add_argument("--json", metavar="FILE", help="write the figures to this file")
    parser.add_argument("--robot", type=int, nargs=2, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.robot:
        robot(tuple(arguments.robot))
        return 0
    ports = robot_ports()
    from axon_entity.testing import ScriptedManager
    child = subprocess.Popen([sys.executable, __file__, "--robot", *map(str, ports)])
    ok, figures = True, {}
    try:
        manager = ScriptedManager("Bench", ports=ports)
        deadline = time.monotonic() + 30
        while True:
            try:
                manager.connect()
                break
            except AssertionError as error:
                if child.poll() is not None or time.monotonic() > deadline:
                    print(f"python_entity: {error}", file=sys.stderr)
                    return 2
        for service, hz in (("Feedback", FEEDBACK_HZ), ("Images", IMAGE_HZ)):
            figure = figures[service] = measure(manager, service, arguments.seconds)
            ok = ok and figure["lost"] == 0 and figure["hz"] >= arguments.least * hz
            print(f"{service}: n {figure['arrived']}, lost {figure['lost']}, {figure['hz']:.1f} Hz, late p50 {figure['late_p50_ms']:.2f} p99 "
                  f"{figure['late_p99_ms']:.2f} max {figure['late_max_ms']:.2f} ms, publish p50 {figure['publish_p50_ms']:.3f} p99 "
                  f"{figure['publish_p99_ms']:.3f} ms", flush=True)
        manager.disconnect()
    finally:
        child.terminate()
        child.wait(30)
    if arguments.json:
        pathlib.Path(arguments.json).write_text(json.dumps(figures, indent=1) + "\n")
    return 0 if ok else 1


if __name__ == "__main__":
    sys.exit(main())
