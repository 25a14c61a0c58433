# SPDX-License-Identifier: MIT
"""What needs a process of its own: signals, the end of the interpreter, forks, and a blocked interpreter."""
import concurrent.futures
import os
import pathlib
import select
import signal
import socket
import subprocess
import sys
import textwrap
import time

import pytest

from axon_entity.testing import ScriptedManager

EXAMPLES = pathlib.Path(__file__).resolve().parents[3] / "examples" / "python"
BEGIN = """
    import ctypes, os, signal, sys, threading, time, warnings
    import axon_entity
    from axon_entity import native
    pause = time.sleep
    DEVICE = int(sys.argv[1])
    entity = axon_entity.Entity("Process", category="MACHINE", ports=(int(sys.argv[2]), int(sys.argv[3])))
    block = ctypes.PyDLL(None)  # its calls keep the interpreter lock

    def say(text):
        os.write(DEVICE, text.encode() + b"\\n")
"""


class Robot:
    """A Python robot in a process of its own, and its device."""

    def __init__(self, ports, text):
        self.device, theirs = socket.socketpair()
        program = textwrap.dedent(BEGIN) + textwrap.dedent(text)
        self.child = subprocess.Popen([sys.executable, "-c", program, str(theirs.fileno()), str(ports[0]), str(ports[1])],
                                      pass_fds=[theirs.fileno()], stderr=subprocess.PIPE, text=True)
        theirs.close()
        self.manager = None

    def link(self, ports, application="Process", **options):
        self.manager = ScriptedManager(application, ports=ports, **options)
        deadline = time.monotonic() + 20
        while True:
            try:
                self.manager.connect()
                return self.manager
            except AssertionError:
                assert self.child.poll() is None and time.monotonic() < deadline, self.child.stderr.read()

    def line(self, seconds=20.0):
        """The next line that the device got; "" at the end of the connection."""
        got = b""
        deadline = time.monotonic() + seconds
        while not got.endswith(b"\n"):
            left = deadline - time.monotonic()
            assert left > 0 and select.select([self.device], [], [], left)[0], f"the device got only {got!r}"
            byte = self.device.recv(1)
            if not byte:
                break
            got += byte
        return got.decode().strip()

    def end(self):
        """Exit status and standard error."""
        errors = self.child.communicate(timeout=60)[1]
        return self.child.returncode, errors

    def tidy(self):
        if self.child.poll() is None:
            self.child.kill()
            self.child.communicate()
        self.device.close()


@pytest.fixture
def start(ports):
    robots = []

    def make(text):
        robots.append(Robot(ports, text))
        return robots[-1]

    yield make
    for robot in robots:
        robot.tidy()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_run_after_a_stop_and_the_program_goes_on(start, number):
    robot = start("""
        entity.on_stop(lambda signal: say("stop " + signal.cause.name))
        @entity.service("Go")
        def go(task):
            task.wait(3600)
        entity.start()
        say("started")
        entity.run()
        say("after run")
    """)
    assert robot.line() == "started"
    deadline = time.monotonic() + 20
    while True:  # from run() on, and not before, the signal is the entity's
        robot.child.send_signal(number) if _in_run(robot) else None
        if select.select([robot.device], [], [], 0.1)[0]:
            break
        assert time.monotonic() < deadline
    assert robot.line() == "stop SHUTDOWN"
    assert robot.line() == "after run"
    status, errors = robot.end()
    assert (status, errors.count("Traceback")) == (0, 0), errors


def _in_run(robot):
    """Whether the process catches SIGTERM: Python does not, run() does."""
    for line in open(f"/proc/{robot.child.pid}/status"):
        if line.startswith("SigCgt:"):
            return bool(int(line.split()[1], 16) >> (signal.SIGTERM - 1) & 1)
    return False


def test_a_stop_reaches_the_device_of_a_blocked_interpreter(start, ports):
    robot = start("""
        entity.on_stop(native.write_bytes(DEVICE, b"STOP\\n"))
        @entity.service("Block")
        def go():
            say("blocked")
            block.usleep(3000000)
            say("free")
        entity.run()
    """)
    manager = robot.link(ports)
    manager.run("Block").expect_granted()
    assert robot.line() == "blocked"
    began = time.monotonic()
    manager.stop()
    took = time.monotonic() - began
    assert robot.line() == "STOP"
    assert took < 1, "and it is confirmed while the interpreter is blocked"
    assert robot.line() == "free"


def test_the_watchdog_stops_the_device_of_a_blocked_interpreter(start, ports):
    robot = start("""
        entity.on_stop(native.write_bytes(DEVICE, b"STOP\\n"))
        @entity.service("Block")
        def go():
            say("blocked")
            block.usleep(3000000)
            say("free")
        entity.run()
    """)
    manager = robot.link(ports, watchdog=0.25)
    manager.run("Block").expect_granted()
    assert robot.line() == "blocked"
    manager.silence()
    assert robot.line() == "STOP"
    assert robot.line() == "free"


def test_a_signal_stops_the_device_of_a_blocked_interpreter(start, ports):
    robot = start("""
        entity.on_stop(native.write_bytes(DEVICE, b"STOP\\n"))
        @entity.service("Block")
        def go():
            say("blocked")
            block.usleep(3000000)
            say("free")
        entity.run()
    """)
    robot.link(ports).run("Block").expect_granted()
    assert robot.line() == "blocked"
    robot.child.send_signal(signal.SIGTERM)
    assert robot.line() == "STOP"
    assert robot.line() == "free"
    assert robot.end()[0] == 0


def test_a_python_function_that_cannot_run_is_a_failed_stop_and_the_native_action_is_not(start, ports):
    robot = start("""
        entity.on_stop(native.write_bytes(DEVICE, b"STOP\\n"), within=0.1)
        entity.on_stop(lambda signal: say("function"))
        @entity.service("Block")
        def go():
            say("blocked")
            block.usleep(2000000)
            say("free")
        entity.run()
    """)
    manager = robot.link(ports)
    manager.run("Block").expect_granted()
    assert robot.line() == "blocked"
    with pytest.raises(AssertionError, match="has not returned within 100 ms"):
        manager.stop()
    lines = []
    while not {"function", "free"} <= set(lines):  # the function may be the first to get the interpreter
        lines.append(robot.line())
    assert lines[:2] == ["STOP", "STOP"], "it is repeated, because the function did not return"


def test_an_endless_loop_in_python_delays_no_stop_and_is_interrupted_by_a_shutdown(start, ports):
    robot = start("""
        entity.on_stop(native.write_bytes(DEVICE, b"STOP\\n"))
        @entity.service("Loop")
        def go():
            say("loops")
            while True:
                pass
        entity.run()
    """)
    manager = robot.link(ports)
    manager.run("Loop").expect_granted()
    assert robot.line() == "loops"
    manager.stop()
    assert robot.line() == "STOP"
    robot.child.send_signal(signal.SIGINT)
    status, errors = robot.end()
    assert status == 0, errors
    assert "is interrupted; fix: return when task.cancelled is true" in errors


def test_the_end_of_the_program_is_a_shutdown(start, ports):
    robot = start("""
        entity.on_stop(lambda signal: say("stop " + signal.cause.name))
        entity.service("Go")(lambda task: task.wait(3600) and None)
        entity.start()
        say("started")
        while not entity.linked:
            pause(0.01)
        pause(0.1)
    """)
    robot.line()
    robot.link(ports)
    assert robot.line() == "stop SHUTDOWN"
    status, errors = robot.end()
    assert (status, "Traceback" in errors) == (0, False), errors


def test_a_handler_that_nothing_ends_does_not_keep_the_program_alive_for_ever(start, ports):
    robot = start("""
        from axon_entity import _entity
        _entity.FORCE_EXIT_AFTER_S = 1.0
        @entity.service("Block")
        def go():
            say("blocked")
            ctypes.CDLL(None).pause()
        entity.start()
        while not entity.linked:
            pause(0.01)
        signal.sigwait({signal.SIGUSR1})
    """.replace("entity.start()", "signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGUSR1})\n        entity.start()"))
    robot.link(ports).run("Block").expect_granted()
    assert robot.line() == "blocked"
    robot.child.send_signal(signal.SIGUSR1)
    status, errors = robot.end()
    assert status == 1
    assert "the program is ended (status 1)" in errors


@pytest.mark.parametrize("where", ["handler", "on_stop"])
@pytest.mark.parametrize("serve", ["entity.run()", "with entity: signal.sigwait({signal.SIGTERM})"])
@pytest.mark.parametrize("call", ["ctypes.CDLL(None).pause()", "block.pause()"], ids=["interpreter_free", "interpreter_kept"])
def test_the_end_of_run_and_of_with_is_forced_when_c_code_does_not_return(start, ports, where, serve, call):
    if serve != "entity.run()" and call == "block.pause()":
        pytest.skip("the signal reaches a program without run() only through the interpreter")
    robot = start(f"""
        from axon_entity import _entity
        _entity.FORCE_EXIT_AFTER_S = 1.0
        _entity.FORCE_EXIT_WITHOUT_INTERPRETER_AFTER_S = 2.0
        entity.on_stop(native.write_bytes(DEVICE, b"STOP\\n"))
        def for_ever():
            say("blocked")
            {call}
        if {where == "on_stop"}:
            entity.on_stop(lambda signal: for_ever())
        @entity.service("Block")
        def go():
            for_ever()
        if {serve.startswith("with")}:
            signal.pthread_sigmask(signal.SIG_BLOCK, {{signal.SIGTERM}})
        {serve}
        say("not reached")
    """)
    manager = robot.link(ports)
    deadline = time.monotonic() + 20
    while serve == "entity.run()" and not _in_run(robot):
        assert time.monotonic() < deadline
    if where == "handler":
        manager.run("Block").expect_granted()
        assert robot.line() == "blocked"
    robot.child.send_signal(signal.SIGTERM)
    assert robot.line() == "STOP"
    status, errors = robot.end()
    assert status == 1, errors
    assert "the program is ended (status 1)" in errors


def test_a_fork_with_a_logger_ends_though_its_threads_are_not_there(start):
    robot = start("""
        import gc, logging
        entity = axon_entity.Entity("Process", category="MACHINE", ports=(int(sys.argv[2]), int(sys.argv[3])), logger=logging.getLogger("robot"))
        entity.start()
        while not any(thread.name == "axon-log" for thread in threading.enumerate()):
            pause(0.01)
        pause(0.2)  # the thread waits for log lines
        warnings.simplefilter("ignore")
        child = os.fork()
        if child == 0:
            signal.alarm(10)
            del entity
            gc.collect()
            sys.exit(0)
        say("status %d" % os.waitpid(child, 0)[1])
    """)
    assert robot.line(30) == "status 0"
    assert robot.end()[0] == 0


def test_a_fork_is_warned_of_and_the_copy_is_refused(start):
    robot = start("""
        entity.service("Go")(lambda: None)
        entity.start()
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            child = os.fork()
        if child == 0:
            for use in (lambda: entity.info("x"), lambda: entity.port, entity.start, entity.shutdown, lambda: entity.stream("s")):
                try:
                    use()
                    say("not refused")
                except axon_entity.ForkedError as error:
                    assert "multiprocessing.get_context('spawn')" in str(error)
            say("refused")
            sys.exit(0)  # with its atexit functions
        say("status %d" % os.waitpid(child, 0)[1])
        say("warned: %s" % ("spawn" in str(caught[0].message)))
    """)
    assert robot.line() == "refused"
    assert robot.line() == "status 0"
    assert robot.line() == "warned: True"
    status, errors = robot.end()
    assert (status, "Traceback" in errors) == (0, False), errors


def test_a_handler_of_another_signal_runs_while_run_waits(start):
    robot = start("""
        signal.signal(signal.SIGUSR1, lambda number, frame: (say("heard"), entity.quit()))
        entity.start()
        say("started")
        entity.run()
        say("ended")
    """)
    assert robot.line() == "started"
    robot.child.send_signal(signal.SIGUSR1)
    assert robot.line() == "heard"
    assert robot.line() == "ended"
    assert robot.end()[0] == 0


def test_a_guard_stops_the_device_of_a_killed_program(start):
    robot = start("""
        guard = axon_entity.DeviceGuard("device", stop=b"GUARD\\n")
        assert guard.watch(DEVICE)
        assert guard.beat()
        say("guarded")
        while True:
            guard.beat()
            pause(0.01)
    """)
    assert robot.line() == "guarded"
    robot.child.kill()
    assert robot.line() == "GUARD"


def test_a_guard_stops_the_device_of_a_killed_program_of_which_a_fork_lives_on(start):
    robot = start("""
        guard = axon_entity.DeviceGuard("device", stop=b"GUARD\\n", silence=10)
        assert guard.watch(DEVICE)
        child = os.fork()
        if child == 0:
            signal.pause()
        say(f"{guard.pid} {child}")
        while True:
            guard.beat()
            pause(0.01)
    """)
    guard, child = (os.pidfd_open(int(pid)) for pid in robot.line().split())
    try:
        robot.child.kill()
        assert robot.line(5) == "GUARD", "long before it has been silent for 10 s"
        assert select.select([guard], [], [], 5)[0], "the guard ends"
        assert not select.select([child], [], [], 0)[0], "and the fork lives"
    finally:
        signal.pidfd_send_signal(child, signal.SIGKILL)
        os.close(guard)
        os.close(child)


@pytest.mark.parametrize("end", ["sys.exit(0)", "del guard; gc.collect(); sys.exit(0)", "[refused(use) for use in uses]; sys.exit(0)"])
def test_a_fork_can_neither_use_nor_end_the_guard(start, end):
    robot = start(f"""
        import gc
        guard = axon_entity.DeviceGuard("device", stop=b"GUARD\\n", silence=10)
        assert guard.watch(DEVICE)
        uses = [guard.beat, guard.release, lambda: guard.watch(DEVICE), lambda: guard.stopped, lambda: guard.pid]
        def refused(use):
            try:
                use()
            except axon_entity.ForkedError:
                return
            os._exit(1)
        child = os.fork()
        if child == 0:
            {end}
        while (ended := os.waitpid(child, os.WNOHANG)) == (0, 0):
            guard.beat()
            pause(0.01)
        say("status %d" % ended[1])
        say("guarded: %s" % guard.beat())
        signal.pause()
    """)
    assert robot.line() == "status 0"
    assert robot.line() == "guarded: True"
    robot.child.kill()
    assert robot.line() == "GUARD"


def test_a_fork_gives_no_orders(start, ports):
    robot = start("""
        line, closes = native.write_bytes(DEVICE, b"STOP\\n"), native.close_fd(os.dup(DEVICE))
        stream = entity.stream("Where")
        entity.on_stop(line)
        @entity.service("Go")
        def go(task, Count: int = 1):
            warnings.simplefilter("ignore")
            child = os.fork()
            if child == 0:
                for use in (lambda: task.order(line, b"ORDER\\n"), lambda: task.wait(1), task.wait_while_paused, lambda: task["Count"],
                            lambda: task.units("Count"), lambda: task.cancelled, lambda: task.stop_cause, lambda: task.paused,
                            lambda: task.progress(0.5), lambda: task.feedback("x"), lambda: stream.wanted,
                            line.carry_out, lambda: line.watch(DEVICE), line.release, lambda: line.runs, lambda: line.failures,
                            closes.carry_out, lambda: closes.watch(DEVICE), closes.release, lambda: closes.closed):
                    try:
                        use()
                    except axon_entity.ForkedError:
                        continue
                    os._exit(1)
                os._exit(0)
            say("status %d" % os.waitpid(child, 0)[1])
        entity.run()
    """)
    robot.link(ports).run("Go").expect_succeeded()
    assert robot.line() == "status 0"


def test_a_start_that_fails_leaves_no_folder(start, tmp_path):
    robot = start(f"""
        import tempfile
        tempfile.tempdir = {str(tmp_path)!r}
        entity.service("Go")(lambda: None)
        entity.start()
        taken = axon_entity.Entity("Taken", category="MACHINE", ports=(entity.port, entity.port))
        taken.service("Go")(lambda: None)
        try:
            taken.start()
        except axon_entity.Misconfiguration as error:
            say("fix: " if "fix: " in str(error) else str(error))
        say(str(len(os.listdir(tempfile.tempdir))))
        entity.shutdown()
        say(str(len(os.listdir(tempfile.tempdir))))
    """)
    assert robot.line() == "fix:"
    assert robot.line() == "1"
    assert robot.line() == "0"


def turntable(start, ports, tmp_path, lost):
    """The example 06_device on the test's own line to a motor, with a device thread that finds the motor lost as `lost` says."""
    (tmp_path / "ports.cfg").write_text(f"Axon.Ports = {ports[0]}-{ports[1]}\n")
    robot = start(f"""
        import runpy, socket, types
        answers = iter({lost!r})

        class DeviceThread:
            angle_deg = 0.0
            lost = property(lambda self: next(answers, True))
            def __init__(self, line): pass
            def __enter__(self): return self
            def __exit__(self, *_): pass
            def stop(self): pass

        sys.modules["simulated_motor"] = types.SimpleNamespace(start_motor=lambda: socket.socket(fileno=DEVICE))
        sys.modules["device_thread"] = types.SimpleNamespace(DeviceThread=DeviceThread)
        sys.argv[1:] = [{str(tmp_path / "ports.cfg")!r}]
        runpy.run_path({str(EXAMPLES / "06_device" / "turntable.py")!r}, run_name="__main__")
    """)
    return robot, robot.link(ports, "Turntable")


def test_the_turntable_of_the_examples_orders_nothing_from_a_lost_motor(start, ports, tmp_path):
    robot, manager = turntable(start, ports, tmp_path, [])
    ending = manager.run("Turn", Angle=90.0).expect_failed()
    assert "check its cable" in ending.reason
    assert not select.select([robot.device], [], [], 0)[0], "no order came before it"


def test_the_turntable_of_the_examples_is_told_to_stand_still_before_its_loss_is_reported(start, ports, tmp_path):
    robot, manager = turntable(start, ports, tmp_path, [False, False, True])
    ending = manager.run("Turn", Angle=90.0).expect_failed()
    assert "check its cable" in ending.reason
    assert select.select([robot.device], [], [], 0)[0]
    assert robot.device.recv(4096) == b"SPEED 90\nSPEED 0\n"


def test_the_motor_of_the_examples_answers_when_it_has_been_started(tmp_path, monkeypatch):
    """However long its process takes to start: a device thread gives a motor up that does not answer for 0.5 s."""
    begin, slow = tmp_path / "begin", tmp_path / "slow_python"
    os.mkfifo(begin)
    slow.write_text(f'#!/bin/sh\nread _ < {begin}\nexec {sys.executable} "$@"\n')
    slow.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(slow))
    monkeypatch.syspath_prepend(EXAMPLES / "06_device")
    import simulated_motor
    with concurrent.futures.ThreadPoolExecutor() as threads:
        starts = threads.submit(simulated_motor.start_motor)
        with begin.open("w") as begins:  # its process is there
            with pytest.raises(concurrent.futures.TimeoutError):
                starts.result(0.5)
            begins.write("\n")
        with starts.result(20) as line:
            assert not select.select([line], [], [], 0)[0], "no answer is left over"
            line.send(b"WHERE\n")
            assert line.recv(4096).startswith(b"AT 0.0 0.0")


@pytest.mark.parametrize("program", ["03_parameters/plotter.py", "04_stop/cart.py", "05_collaboration/shuttle.py", "05_collaboration/arm.py",
                                     "05_collaboration/planner.py", "06_device/turntable.py"])
def test_an_example_that_cannot_read_its_ports_says_so_in_one_line(program, tmp_path):
    words = [EXAMPLES.parent / "05_collaboration"] if program.startswith("05") else []
    done = subprocess.run([sys.executable, EXAMPLES / program, *words, tmp_path / "none.cfg"], capture_output=True, text=True, timeout=60)
    assert done.returncode == 1
    line, = done.stderr.splitlines()
    assert f"{tmp_path / 'none.cfg'}: cannot be read" in line and "fix: " in line
