# SPDX-License-Identifier: MIT
"""Stops: native actions, the Python function and its time bound, and the warning of a robot that has none."""
import fcntl
import os
import pty
import select
import signal
import socket
import sys
import threading
import time
import tty
import warnings

import pytest

from axon_entity import Entity, NoNativeStopWarning, native
from axon_entity import _entity
from axon_entity.testing import Failure, ScriptedManager


@pytest.fixture
def pair():
    ours, theirs = socket.socketpair()
    theirs.settimeout(10)
    yield ours, theirs
    ours.close()
    theirs.close()


def linked(ports, prepare):
    entity = Entity("Stopper", category="MACHINE", ports=ports)
    entity.service("Go")(lambda task: task.wait(3600) and None)
    prepare(entity)
    entity.start()
    manager = ScriptedManager(entity)
    manager.connect()
    return entity, manager


def test_write_bytes_writes_to_a_socket_a_pipe_a_terminal_and_a_file(pair, tmp_path):
    ours, theirs = pair
    native.write_bytes(ours.fileno(), b"STOP\n").carry_out()
    assert theirs.recv(99) == b"STOP\n"
    out, into = os.pipe()
    native.write_bytes(into, b"STOP\n").carry_out()
    assert os.read(out, 99) == b"STOP\n"
    assert not fcntl.fcntl(into, fcntl.F_GETFL) & os.O_NONBLOCK, "the caller's descriptor blocks as before"
    master, line = pty.openpty()
    native.write_bytes(line, b"STOP\n").carry_out()
    assert os.read(master, 99).strip() == b"STOP"
    file = tmp_path / "device"
    file.touch()
    action = native.write_bytes(file, b"0")
    action.carry_out()
    action.carry_out()
    assert file.read_bytes() == b"00"
    assert (action.runs, action.failures) == (2, 0)
    for descriptor in (out, into, master, line):
        os.close(descriptor)


def test_write_bytes_outlives_the_callers_descriptor_and_takes_a_new_one(pair):
    ours, theirs = pair
    action = native.write_bytes(ours.fileno(), b"S")
    ours.close()
    action.carry_out()
    assert theirs.recv(9) == b"S"
    other, their_other = socket.socketpair()
    action.watch(other.fileno())
    assert theirs.recv(9) == b"", "the former connection is closed"
    action.carry_out()
    assert their_other.recv(9) == b"S"
    action.release()
    action.carry_out()
    other.close()
    assert their_other.recv(9) == b"", "nothing more was written"
    their_other.close()


def test_a_device_that_takes_nothing_is_a_failure_within_the_bound():
    out, into = os.pipe()
    os.set_blocking(into, False)
    try:
        while True:
            os.write(into, b"x" * 65536)
    except BlockingIOError:
        pass
    os.set_blocking(into, True)
    action = native.write_bytes(into, b"STOP\n", within=0.05)
    began = time.monotonic()
    with pytest.raises(RuntimeError, match="only 0 of 5 bytes"):
        action.carry_out()
    assert time.monotonic() - began < 2
    assert action.failures == 1
    os.close(out)
    os.close(into)


def test_the_master_of_a_pseudo_terminal_is_written_to_and_not_opened_again():
    master, line = pty.openpty()
    tty.setraw(line)
    native.write_bytes(master, b"STOP\n").carry_out()
    assert select.select([line], [], [], 10)[0]
    assert os.read(line, 99) == b"STOP\n"
    os.close(master)
    os.close(line)


FULL = 2**64 - 2  # of an eventfd: writing to it blocks


def number(value):
    return value.to_bytes(8, sys.byteorder)


def test_a_descriptor_that_blocks_is_a_failure_within_the_bound_and_works_when_the_device_takes_it():
    device = os.eventfd(FULL & 0xFFFFFFFF)
    os.eventfd_write(device, FULL - (FULL & 0xFFFFFFFF))
    action = native.write_bytes(device, number(1), within=0.05)
    began = time.monotonic()
    for _ in range(2):  # the second time it waits for the first one
        with pytest.raises(RuntimeError, match="did not take the bytes in time"):
            action.carry_out()
    assert time.monotonic() - began < 5
    assert os.eventfd_read(device) == FULL
    deadline = time.monotonic() + 10
    while True:
        try:
            action.carry_out()
            break
        except RuntimeError:
            assert time.monotonic() < deadline
    assert os.eventfd_read(device) >= 2, "what was late has arrived, and then what was confirmed"
    os.close(device)


@pytest.mark.parametrize("kind", ["socket"])
def test_an_order_gives_up_as_soon_as_a_stop_waits(ports, pair, kind):
    """At a device that takes nothing until the order has given up."""
    bound_s = 10.0
    if kind == "socket":
        into, order_bytes, stop_bytes = pair[0].fileno(), b"x" * 4096, b"\nSTOP\n"
    else:
        into, order_bytes, stop_bytes = os.eventfd(0), number(FULL), number(1)
    line = native.write_bytes(into, stop_bytes, within=bound_s)
    ended = []

    def read_until_the_stop():
        while True:
            if kind == "socket":
                if pair[1].recv(65536).endswith(stop_bytes):
                    return
            elif os.eventfd_read(into) % 2 == 1:
                return

    def prepare(entity):
        @entity.service("Order")
        def order(task):
            try:
                while task.order(line, order_bytes):
                    pass
                ended.append("gave up")
            except RuntimeError as error:
                ended.append(str(error))
            read_until_the_stop()

    entity, manager = linked(ports, prepare)
    manager.run("Order").expect_granted()
    deadline = time.monotonic() + 10
    while select.select([], [into], [], 0)[1]:  # until an order has to wait
        assert time.monotonic() < deadline
    began = time.monotonic()
    line.carry_out()
    assert time.monotonic() - began < bound_s / 2
    assert ended == ["gave up"]
    manager.disconnect()
    entity.shutdown()


def test_an_order_does_not_wait_for_a_stop_that_the_device_keeps_waiting(ports, pair):
    ours, theirs = pair
    ours.setblocking(False)
    with pytest.raises(BlockingIOError):
        while True:
            ours.send(b"x" * 4096)
    bound_s = 10.0
    line = native.write_bytes(ours.fileno(), b"STOP", within=bound_s)
    begin, ended = threading.Event(), threading.Event()

    def prepare(entity):
        @entity.service("Order")
        def order(task):
            begin.wait(60)
            while task.order(line, b"order"):
                pass
            ended.set()

    entity, manager = linked(ports, prepare)
    manager.run("Order").expect_granted()
    stop = threading.Thread(target=line.carry_out)
    began = time.monotonic()
    stop.start()
    begin.set()
    assert ended.wait(60)
    assert time.monotonic() - began < bound_s / 2
    while stop.is_alive():  # the device takes the bytes after all
        if select.select([theirs], [], [], 0.01)[0]:
            theirs.recv(65536)
    manager.disconnect()
    entity.shutdown()


def test_close_fd_closes_no_other_file_that_has_got_the_number(pair):
    ours, theirs = pair
    action = native.close_fd(ours.fileno())
    other, their_other = socket.socketpair()
    os.dup2(other.fileno(), ours.fileno())  # as if the number were used again
    with pytest.raises(RuntimeError, match=r"another file now.*fix: call action.release\(\)"):
        action.carry_out()
    assert not action.closed
    ours.send(b"x")
    assert their_other.recv(9) == b"x", "the other file is open"
    action.watch(ours.fileno())
    action.carry_out()
    assert their_other.recv(9) == b""
    action.release()
    action.carry_out()
    other.close()
    their_other.close()


def test_a_connection_that_was_opened_again_without_watch_is_a_failed_stop(pair):
    ours, theirs = pair
    action = native.close_fd(ours.fileno())
    action.carry_out()
    again, their_again = socket.socketpair()
    os.dup2(again.fileno(), ours.fileno())
    with pytest.raises(RuntimeError, match="another file now.*action.watch"):
        action.carry_out()
    again.close()
    their_again.close()


def test_close_fd_has_nothing_to_close_when_the_program_has_closed_it(pair):
    ours, theirs = pair
    action = native.close_fd(ours.fileno())
    ours.close()
    action.carry_out()
    assert theirs.recv(9) == b""


def test_a_program_whose_status_another_has_collected_is_a_failed_stop(tmp_path):
    action = native.run_command(["/bin/true"], within=10)
    former = signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # the kernel collects it
    try:
        with pytest.raises(RuntimeError, match="another part of this program has collected its status; fix: do not ignore SIGCHLD"):
            action.carry_out()
    finally:
        signal.signal(signal.SIGCHLD, former)
    action.carry_out()


def test_close_fd_ends_the_connection_and_keeps_the_number(pair):
    ours, theirs = pair
    number = ours.fileno()
    action = native.close_fd(number)
    action.carry_out()
    assert action.closed
    assert theirs.recv(9) == b""
    assert ours.fileno() == number
    with pytest.raises(BrokenPipeError):
        ours.send(b"GO\n")
    assert ours.recv(9) == b""
    action.carry_out()  # again, and nothing else is closed
    with open(os.devnull, "rb") as other:
        assert other.fileno() != number
    again, their_again = socket.socketpair()
    action.watch(again.fileno())
    assert not action.closed
    action.carry_out()
    assert their_again.recv(9) == b""
    for one in (again, their_again):
        one.close()


def test_run_command_runs_a_program_and_judges_its_end(tmp_path):
    stamp = tmp_path / "stamp"
    native.run_command(["touch", stamp]).carry_out()
    assert stamp.exists()
    with pytest.raises(RuntimeError, match="ended with status 3"):
        native.run_command([sys.executable, "-c", "raise SystemExit(3)"], within=10).carry_out()
    slow = native.run_command(["/bin/sh", "-c", f"read line < {tmp_path}/wait; echo >> {tmp_path}/runs"], within=0.02)
    os.mkfifo(tmp_path / "wait")
    for _ in range(2):  # the second time it waits for the first one
        with pytest.raises(RuntimeError, match="has not ended in time"):
            slow.carry_out()
    (tmp_path / "wait").write_text("go\n")
    deadline = time.monotonic() + 10
    while time.monotonic() < deadline:
        try:
            slow.carry_out()
            break
        except RuntimeError:
            pass
    assert (tmp_path / "runs").read_text() == "\n"


@pytest.mark.parametrize("make, error, said", [
    (lambda: native.write_bytes(987654, b"S"), ValueError, "open file descriptor, found 987654"),
    (lambda: native.write_bytes("/nowhere/device", b"S"), ValueError, "No such file"),
    (lambda: native.write_bytes(1, "S"), TypeError, "expected bytes"),
    (lambda: native.write_bytes(1, b""), ValueError, "1 to 4096 bytes"),
    (lambda: native.write_bytes(1, b"S", within=0), ValueError, "0.001 to 10 seconds"),
    (lambda: native.close_fd(True), TypeError, "open file descriptor"),
    (lambda: native.close_fd(987654), ValueError, "open file descriptor"),
    (lambda: native.run_command("stop"), TypeError, "a list of words"),
    (lambda: native.run_command([]), TypeError, "a list of words"),
    (lambda: native.run_command(["/nowhere/program"]), ValueError, "write its whole path"),
    (lambda: native.run_command(["/bin/true", "a\0b"]), ValueError, "NUL"),
])
def test_a_wrong_action_is_refused_where_it_is_made(make, error, said):
    with pytest.raises(error, match=said):
        make()


def test_native_actions_come_first_then_the_function(ports, pair):
    ours, theirs = pair
    seen = []

    def prepare(entity):
        @entity.on_stop(native.write_bytes(ours.fileno(), b"1"), native.write_bytes(ours.fileno(), b"2"))
        def stop(signal):
            seen.append((theirs.recv(9), signal.cause.name))

    entity, manager = linked(ports, prepare)
    manager.stop()
    assert seen == [(b"12", "REQUESTED")]
    manager.disconnect()
    entity.shutdown()
    assert [cause for _, cause in seen][-1] == "SHUTDOWN"


def test_a_function_that_takes_too_long_is_a_failed_stop_and_counts_when_it_returns(ports, pair):
    ours, theirs = pair
    go_on = threading.Event()
    calls = []

    def prepare(entity):
        entity.on_stop(native.write_bytes(ours.fileno(), b"S"), within=0.05)

        @entity.on_stop
        def stop(signal):
            calls.append(signal.cause.name)
            go_on.wait(30)

    entity, manager = linked(ports, prepare)
    task = manager.run("Go")
    task.expect_granted()
    with pytest.raises(Failure, match="has not returned within 50 ms"):
        manager.stop()
    assert theirs.recv(1) == b"S", "the native action was carried out all the same"
    go_on.set()
    task.expect_stopped()
    deadline = time.monotonic() + 10
    while True:  # no task begins before the stop is complete
        try:
            manager.run("Go").expect_granted()
            break
        except Failure:
            assert time.monotonic() < deadline
    assert calls[0] == "REQUESTED"
    manager.disconnect()
    entity.shutdown()


def test_a_function_that_raises_is_a_failed_stop(ports):
    def prepare(entity):
        def stop(signal):
            raise OSError("the line is gone")

        entity.on_stop(stop)

    entity, manager = linked(ports, prepare)
    with pytest.raises(Failure, match="OSError: the line is gone"):
        manager.stop()
    manager.disconnect()
    entity.shutdown()


def test_a_native_action_that_fails_is_a_failed_stop_and_the_others_are_carried_out(ports, pair, tmp_path):
    ours, theirs = pair
    device = tmp_path / "device"
    device.touch()
    broken = native.write_bytes(device, b"S")
    device.unlink()
    entity, manager = linked(ports, lambda entity: entity.on_stop(broken, native.write_bytes(ours.fileno(), b"2")))
    with pytest.raises(Failure, match="No such file"):
        manager.stop()
    assert theirs.recv(1) == b"2"
    device.touch()  # repaired: the stop is called again and completes
    manager.disconnect()
    entity.shutdown()


def test_the_silence_of_the_entity_manager_is_a_native_stop(ports, pair):
    ours, theirs = pair
    entity = Entity("Stopper", category="MACHINE", ports=ports)
    entity.service("Go")(lambda task: task.wait(3600) and None)
    entity.on_stop(native.write_bytes(ours.fileno(), b"S"))
    entity.start()
    manager = ScriptedManager(entity, watchdog=0.2)
    manager.connect()
    manager.run("Go").expect_granted()
    manager.silence()
    assert theirs.recv(1) == b"S"
    manager.expect_link_ended()
    entity.shutdown()


def test_a_robot_that_moves_without_a_native_action_is_warned_of_once(ports, monkeypatch):
    monkeypatch.setattr(_entity, "_warned_of_native_stop", False)

    def warned(category, moves=None, action=False):
        entity = Entity("Stopper", category=category, ports=ports)
        entity.service("Go", moves=moves)(lambda: None)
        if action:
            entity.on_stop(native.run_command(["/bin/true"]))
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            entity.start()
        entity.shutdown()
        return [str(one.message) for one in caught if one.category is NoNativeStopWarning]

    assert warned("MACHINE") == []
    assert warned("ROBOT", moves=False) == []
    assert warned("ROBOT", action=True) == []
    text, = warned("ROBOT")
    assert "entity.on_stop(axon_entity.native.write_bytes" in text and "Go" in text
    assert warned("ROBOT") == [], "once"


def test_a_function_for_stops_must_be_one():
    entity = Entity("Stopper")
    entity.on_stop(lambda signal: None)
    with pytest.raises(ValueError, match="already"):
        entity.on_stop(lambda signal: None)

    async def later(signal):
        pass

    with pytest.raises(TypeError, match="async"):
        Entity("Stopper").on_stop(later)


