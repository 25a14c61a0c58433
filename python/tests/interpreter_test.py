# SPDX-License-Identifier: GPL-2.0-or-later
"""The interpreter and the native threads: who waits for whom, what a blocked interpreter loses, and a clean end."""
import gc
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


def state(process):
    with open(f"/proc/{process.pid}/status", encoding="utf-8") as status:
        return next(line for line in status if line.startswith("State")).split()[1]


def sleeps(child):
    """Whether its main thread was asleep each of five times that somebody looked."""
    seen = []
    wait_until(lambda: seen.append(state(child)) or seen[-5:] == ["S"] * 5, "it waits", 30)


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


def interrupt_while_servers_are_paused(laboratory, child):
    """The program goes on after a line, until it waits for what only the servers could give."""
    laboratory.child.send_signal(signal.SIGSTOP)
    try:
        wait_until(lambda: state(laboratory.child) == "T", "the servers are paused")
        child.stdin.write("\n")
        child.stdin.flush()
        sleeps(child)
        child.send_signal(signal.SIGINT)
        assert child.stdout.readline() == "interrupted\n", child.stderr.read()
    finally:
        laboratory.child.send_signal(signal.SIGCONT)


def test_a_keyboard_interrupt_ends_the_wait_for_room(laboratory, robot):
    child = program(laboratory, """
        task.cancel()
        for _ in task:  # while it runs, silent servers are soon given up
            pass
        try:
            print("ready", flush=True)
            sys.stdin.readline()
            while True:
                robot.send_raw(b"x" * 1_000_000, wait=60)
        except KeyboardInterrupt:
            print("interrupted", flush=True)
        """)
    interrupt_while_servers_are_paused(laboratory, child)
    ends(child)


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


def test_connections_may_be_forgotten(laboratory, robot, client):
    """Also those with callbacks, which know their connection."""
    other = client()
    for callbacks in (False, True, True):
        lab = axon.connect(laboratory.server)
        held = lab.checkout("PeopleBot")
        if callbacks:
            told = threading.Event()
            held.on_text(lambda _, lab=lab: lab.entities())
            lab.on_connection(lambda *_, lab=lab: lab.entities())
            lab.on_entity(lambda *_, lab=lab, told=told: (lab.entities(), told.set()))
            assert told.wait(10)
        del lab, held
        gc.collect()
        wait_until(lambda: not other.find("PeopleBot").holder.id, "released")
    wait_until(lambda: not any(thread.name == "axon-callbacks" for thread in threading.enumerate()), "the threads have ended")


def test_a_child_of_fork_leaves_the_robot_alone(laboratory, robot, client):
    lab = client()
    held = lab.checkout("PeopleBot")
    child = os.fork()
    if child == 0:
        os._exit(0)
    os.waitpid(child, 0)
    held.send_text("still here")
    robot.do("expect_text")


@pytest.mark.parametrize("end", [
    "sys.exit(0)",
    "del lab, robot, task, update; gc.collect(); sys.exit(0)",
    "with lab, robot: sys.exit(0)",
    "watch.close(); lab.close(); sys.exit(0)",
    "for call in calls: refused(call)\n    sys.exit(0)",
    "mine = axon.connect(sys.argv[1]); mine.wait_for('PeopleBot'); mine.on_entity(print); mine.close(); sys.exit(0)",
    "mine = axon.connect(sys.argv[1]); mine.wait_for('PeopleBot'); sys.exit(0)",
])
def test_a_child_of_fork_can_neither_use_nor_end_the_connection(laboratory, robot, client, end):
    child = program(laboratory, f"""
import gc
robot.on_text(lambda text: print(text, flush=True))
watch = robot.scan.watch()
calls = [robot.stop, robot.release, lambda: robot.run("Drive", Distance=1), task.cancel, lambda: task.report, lab.entities,
         lambda: lab.checkout("PeopleBot"), lab.stop, lambda: lab.on_entity(print), lambda: robot.send_text("from the child"),
         lambda: robot.on_text(print), lambda: task.on_update(print), lambda: lab.checkout("PeopleBot", on_waiting=print)]
def refused(call):
    try:
        call()
    except axon.Refused as error:
        assert error.code == axon.RefusalCode.NOT_CONNECTED and f"process {{os.getppid()}}" in error.message, error
        return
    raise AssertionError(call)
child = os.fork()
if child == 0:
    os.dup2(2, 1)
    {end}
_, status = os.waitpid(child, 0)
print("ready", flush=True)
print(status, task.report.state.name, lab.connected, flush=True)
sys.stdin.readline()
""")
    assert child.stdout.readline() == "0 RUNNING True\n", child.stderr.read()
    robot.do("text", text="the parent hears")
    assert child.stdout.readline() == "the parent hears\n"
    other = client()
    other.wait_for("PeopleBot", 5)
    assert other.find("PeopleBot").state == axon.EntityState.BUSY
    child.stdin.write("\n")
    ends(child)
    robot.do("expect_stop")


@pytest.mark.parametrize("ask", ["lab.checkout('PeopleBot')", "lab.checkout_query('1 ROBOT')", "lab.resume(ticket)"])
def test_what_is_granted_after_an_interrupt_is_given_back(laboratory, robot, client, ask):
    """The servers answer when the program waits no more, and it goes on: nobody in it has the robot, so nobody holds it."""
    child = program(laboratory, f"""
        ticket = robot.ticket()
        if "resume" not in {ask!r}:
            robot.release()
        else:
            lab.close()
            lab = axon.connect(sys.argv[1])
        try:
            print("ready", flush=True)
            sys.stdin.readline()
            {ask}
        except KeyboardInterrupt:
            print("interrupted", flush=True)
            sys.stdin.readline()
        print(len(lab.held()))
        """)
    other = client()
    other.wait_for("PeopleBot", 5)
    interrupt_while_servers_are_paused(laboratory, child)

    def taken():
        try:
            return other.checkout("PeopleBot", wait=5)
        except axon.Refused:
            return None
    held = wait_until(taken, "free", 20)
    held.release()
    child.stdin.write("\n")
    out, _ = ends(child)
    assert out == "0\n"


def test_what_nobody_reads_any_more_is_not_kept(laboratory, robot, client):
    robot.on("Drive", *[["progress", number / 100] for number in range(100)], ["succeed"])
    lab = client()
    held = lab.checkout("PeopleBot")
    task = held.start("Drive", Distance=1)
    for _ in task:
        break
    gc.collect()
    assert all(feed.ended for feed in lab._feeds)
    task.result(10)
    called = []
    task.on_update(called.append)
    held.start("Drive", Distance=1).on_update(called.append)  # nobody else has the task
    wait_until(lambda: sum(report.final for report in called) == 2, "told")
    wait_until(lambda: len(lab._callbacks) == 0, "no callback is kept when its task has ended")
    held.on_text(called.append)
    assert len(lab._callbacks) > 0
    held.release()
    wait_until(lambda: len(lab._callbacks) == 0, "no callback is kept when its robot was released")


def test_the_callbacks_of_a_robot_end_when_it_is_lost(laboratory, robot, client):
    lab, other = client(), client(name="client2@lab")
    held = lab.checkout("PeopleBot")
    lost, late = [], []
    held.on_text(lost.append)
    held.on_lost(lost.append)
    other.wait_for("PeopleBot", 5)
    taken = other.checkout("PeopleBot", force=True, reason="mine")
    wait_until(lambda: lost, "told")
    wait_until(lambda: len(lab._callbacks) == 0, "no callback is kept")
    held.on_lost(late.append)
    wait_until(lambda: late, "whoever asks later is told, too")
    assert late[0].message == lost[0].message
    taken.release()
    lab.wait_for("PeopleBot", 5)
    with lab.checkout("PeopleBot") as held:
        held.on_text(lost.append)
        other.checkout("PeopleBot", force=True, reason="mine again")
        wait_until(lambda: not lab.held(), "lost")
    wait_until(lambda: len(lab._callbacks) == 0, "and with on_text alone")


def test_every_object_that_stands_for_a_robot_is_told(laboratory, robot, client):
    lab = client()
    held = lab.checkout("PeopleBot")
    first, second = [], []
    held.on_text(first.append)
    lab.held()[0].on_text(second.append)
    robot.do("text", text="both")
    wait_until(lambda: first == second == ["both"], "told")


def test_whoever_asks_what_is_held_while_a_robot_is_granted_is_told_too(laboratory, robot, client):
    class Grants:
        def __init__(self):
            self.native = lab._native

        def __getattr__(self, name):
            return getattr(self.native, name)

        def check_out(self, *arguments):
            self.native.check_out(*arguments)
            lab.held()[0].on_text(first.append)

    lab = client()
    lab._native = Grants()
    first, second = [], []
    lab.checkout("PeopleBot").on_text(second.append)
    robot.do("text", text="both")
    wait_until(lambda: first == second == ["both"], "told")


def test_an_exit_in_a_callback_ends_no_other_callback(laboratory, robot, client, caplog):
    lab = client()
    held = lab.checkout("PeopleBot")
    texts = []
    held.on_text(lambda text: sys.exit("of the callback"))
    held.on_text(texts.append)
    for text in ("one", "two"):
        robot.do("text", text=text)
    wait_until(lambda: texts == ["one", "two"], "told")
    assert "of the callback" in caplog.text


def test_callbacks_that_do_not_return_keep_a_bounded_number_of_bytes(laboratory, robot, client):
    lab = client()
    lab._callbacks.feed = axon._native.Feed(0, 10_000)
    held = lab.checkout("PeopleBot")
    go_on, texts = threading.Event(), []
    held.on_text(lambda text: (go_on.wait(20), texts.append(text)))
    task = held.start("Drive", Distance=1)
    states = []
    task.on_update(lambda report: states.append(report.state))
    for number in range(100):
        robot.do("text", text=f"{number:02}" + "x" * 998)
    wait_until(lambda: lab.dropped >= 80, "dropped")
    held.stop()
    task.wait(5)
    go_on.set()
    wait_until(lambda: states and states[-1] == axon.TaskState.STOPPED, "what is no data is not dropped")
    assert len(texts) + lab.dropped == 100 and texts[-1].startswith("99")


def test_on_entity_tells_at_once_who_is_there(laboratory, client):
    laboratory.add("PeopleBot")
    lab = client()
    lab.wait_for("PeopleBot", 5)
    told, again = [], []
    lab.on_entity(lambda presence, entity: told.append((presence, entity.name)))
    wait_until(lambda: told == [(axon.Presence.JOINED, "PeopleBot")])
    laboratory.add("Second")
    lab.wait_for("Second", 5)
    wait_until(lambda: (axon.Presence.JOINED, "Second") in told)
    lab.on_entity(lambda presence, entity: again.append((presence, entity.name)))
    wait_until(lambda: sorted(again[:2], key=str) == [(axon.Presence.JOINED, "PeopleBot"), (axon.Presence.JOINED, "Second")])
    assert [name for presence, name in told if presence == axon.Presence.JOINED] == ["PeopleBot", "Second"]
