# SPDX-License-Identifier: GPL-2.0-or-later
"""The interpreter and the native threads: who waits for whom, what a blocked interpreter loses, and a clean end."""
import os
import signal
import subprocess
import sys
import textwrap
import threading
import time

import pytest

import axon
from support import wait_until

BEGIN = """
import ctypes, os, sys, threading, time
import axon
lab = axon.connect(sys.argv[1], {options})
robot = lab.checkout("PeopleBot")
task = robot.start("Drive", Distance=1)
for update in task:
    if update.state == axon.TaskState.RUNNING:
        break

def aside(call):
    begun = threading.Event()
    def work():
        begun.set()
        try:
            call()
        except axon.Refused:  # the connection was closed
            pass
    threading.Thread(target=work, daemon=True).start()
    begun.wait()
"""


def program(laboratory, text, options="", begin=BEGIN):
    """A Python program of its own that holds the robot, whose task runs. It has printed "ready"."""
    child = subprocess.Popen([sys.executable, "-c", begin.format(options=options) + textwrap.dedent(text), laboratory.server],
                             stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert child.stdout.readline() == "ready\n", child.stderr.read()
    return child


def ends(child, status=0, seconds=20):
    out, errors = child.communicate(timeout=seconds)
    assert child.returncode == status, errors
    return out, errors


@pytest.fixture
def robot(laboratory):
    entity = laboratory.add()
    entity.on("Drive", ["never"])
    return entity


# PyDLL keeps the GIL while the function runs, as a module in C does that was written badly.
BLOCK = """
print("ready", flush=True)
ctypes.PyDLL(None).usleep({microseconds})
print(task.report.state.name, flush=True)
os._exit(0)
"""


def test_native_code_that_keeps_the_interpreter_loses_its_robots(laboratory, robot):
    child = program(laboratory, BLOCK.format(microseconds=6_000_000))
    begin = time.monotonic()
    assert robot.do("expect_stop")["cause"] == "CLIENT_LOST"
    assert time.monotonic() - begin < 5, "while it was blocked"
    assert child.poll() is None
    out, _ = ends(child)
    assert out != "RUNNING\n"


@pytest.mark.parametrize("said", ["keep_running=None", "keep_running=30.0"])
def test_a_program_that_said_so_keeps_them(laboratory, robot, said):
    child = program(laboratory, BLOCK.format(microseconds=5_000_000), said)
    assert ends(child)[0] == "RUNNING\n"
    assert robot.do("expect_stop")["cause"] == "CLIENT_LOST", "it has ended without a good-bye, and not before"


def test_a_busy_interpreter_keeps_its_robots(laboratory, robot):
    child = program(laboratory, """
        print("ready", flush=True)
        end = time.monotonic() + 5
        while time.monotonic() < end:
            sum(range(1000))
        print(task.report.state.name)
        """)
    assert ends(child)[0] == "RUNNING\n"


END = """
print("ready", flush=True)
{end}
"""


@pytest.mark.parametrize("end", [
    "",
    "raise SystemExit(0)",
    "robot.on_text(print); robot.on_lost(print); lab.on_entity(lambda *_: None)",
    "aside(lambda: robot.scan.next(60))",
    "aside(task.wait)",
    "aside(lambda: lab.wait_for('Nobody', 60))",
    "for _ in range(8): aside(lambda: [lab.entities() for _ in iter(int, 1)])\nlab.drill('PeopleBot', count=3)",
    "watch = robot.scan.watch(); del lab, robot, task",
    "import gc; robot.me = robot; lab.me2 = lab; watch = robot.scan.watch(); watch.me = watch",
])
def test_the_interpreter_ends_cleanly_with_a_live_connection(laboratory, robot, end):
    child = program(laboratory, END.format(end=end))
    begin = time.monotonic()
    _, errors = ends(child)
    assert errors == ""
    assert time.monotonic() - begin < 10
    with axon.connect(laboratory.server) as other:
        wait_until(lambda: not other.find("PeopleBot").holder.id, "released")
        other.checkout("PeopleBot")
    robot.do("expect_stop")


WAITS = """
def work():
    {wait}
try:
    print("ready", flush=True)
    work()
except KeyboardInterrupt:
    print("interrupted", flush=True)
"""


def sleeps(child):
    """Whether its main thread was asleep each of five times that somebody looked."""
    def state():
        with open(f"/proc/{child.pid}/status", encoding="utf-8") as status:
            return next(line for line in status if line.startswith("State")).split()[1]
    seen = []
    wait_until(lambda: seen.append(state()) or seen[-5:] == ["S"] * 5, "it waits")


@pytest.mark.parametrize("wait", [
    "task.wait()",
    "task.result()",
    "[update for update in task]",
    "robot.scan.next(60)",
    "[sample for sample in robot.scan]",
    "lab.wait_for('Nobody', 60)",
    "[event for event in lab.events()]",
    "lab.drill('PeopleBot', count=600, period=0.1)",
    "axon.connect(sys.argv[1], name='other').checkout('PeopleBot', wait=60)",
])
def test_a_keyboard_interrupt_ends_every_wait(laboratory, robot, wait):
    child = program(laboratory, WAITS.format(wait=wait))
    sleeps(child)
    begin = time.monotonic()
    child.send_signal(signal.SIGINT)
    assert child.stdout.readline() == "interrupted\n", child.stderr.read()
    assert time.monotonic() - begin < 2
    ends(child)
    robot.do("expect_stop")


def test_an_interrupted_run_cancels_its_task(laboratory, robot, client):
    child = program(laboratory, """
        task.cancel()
        try:
            print("ready", flush=True)
            robot.run("Drive", Distance=2)
        except KeyboardInterrupt:
            sys.stdin.readline()
        """)
    robot.do("expect_task")
    robot.do("expect_task")
    other = client()
    wait_until(lambda: other.find("PeopleBot").state == axon.EntityState.BUSY)
    child.send_signal(signal.SIGINT)
    wait_until(lambda: other.find("PeopleBot").state == axon.EntityState.REG, "cancelled while the program goes on")
    assert child.poll() is None
    child.stdin.write("\n")
    ends(child)


def test_the_interpreter_may_be_blocked_while_news_arrive(laboratory, robot, client):
    """Threads of the client library wait for no lock of Python: what came meanwhile is there afterwards."""
    import ctypes
    lab = client(keep_running=None)
    held = lab.checkout("PeopleBot")
    texts = []
    held.on_text(texts.append)
    block = threading.Thread(target=lambda: ctypes.PyDLL(None).usleep(1_000_000))
    for number in range(20):
        robot.do("text", text=str(number))
    block.start()
    block.join()
    wait_until(lambda: len(texts) == 20)


def test_connections_may_be_forgotten(laboratory, robot):
    for _ in range(5):
        lab = axon.connect(laboratory.server)
        held = lab.checkout("PeopleBot")
        del lab, held
        import gc
        gc.collect()


def test_a_child_of_fork_leaves_the_robot_alone(laboratory, robot, client):
    lab = client()
    held = lab.checkout("PeopleBot")
    child = os.fork()
    if child == 0:
        os._exit(0)
    os.waitpid(child, 0)
    held.send_text("still here")
    robot.do("expect_text")
