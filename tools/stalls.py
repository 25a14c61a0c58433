# SPDX-License-Identifier: GPL-2.0-or-later
"""What a test of real processes may owe to the host: on a virtual machine that gets no processor for a quarter of a second
a robot is stopped, as promised, and the test fails rightly and for nothing.

A real-time thread on each processor sleeps for 5 ms again and again and notes when it is woken late; at its priority
nothing of this machine's own makes it so. What failed beside such a stall is run once more, twice at most, and named in
the file AXON_REPEATS. A failure without a stall stands at once."""
import math
import os
import threading
import time
import unittest

LATE_S = 0.1    # less than half of the shortest watchdog of the tests
REPEATS = 2
PRIORITY = 50   # above all of Axon's threads


class Probe:
    """When one of the processors let a thread wait for LATE_S or more that wanted to run: `stalls`, (begin, end) on
    time.monotonic(). Where real-time threads are not permitted nobody else has one either, and beside two compilers an
    ordinary thread that mostly sleeps was woken at most 5 ms late."""

    def __init__(self):
        self.stalls = []
        self._ending = threading.Event()
        self._threads = [threading.Thread(target=self._run, args=(processor,), daemon=True)
                         for processor in os.sched_getaffinity(0)]

    def __enter__(self):
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_):
        self._ending.set()
        for thread in self._threads:
            thread.join()

    def longest(self, begin=-math.inf, end=math.inf):
        """In seconds, of those in that time."""
        return max((to - since for since, to in self.stalls if to > begin and since < end), default=0.0)

    def _run(self, processor):
        os.sched_setaffinity(0, {processor})  # of this thread
        try:
            os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(PRIORITY))
        except PermissionError:
            pass
        while not self._ending.is_set():
            begin = time.monotonic()
            time.sleep(0.005)
            end = time.monotonic()
            if end - begin - 0.005 >= LATE_S:
                self.stalls.append((begin, end))


def note(what, longest):
    line = f"{what}: failed while the host stood still for up to {longest * 1000:.0f} ms. Once more."
    print(line, flush=True)
    if os.environ.get("AXON_REPEATS"):
        with open(os.environ["AXON_REPEATS"], "a", encoding="utf-8") as repeats:
            repeats.write(line + "\n")


class _Result(unittest.TextTestResult):
    def startTest(self, test):
        test.began = time.monotonic()
        super().startTest(test)

    def stopTest(self, test):
        test.ended = time.monotonic()
        super().stopTest(test)


class Runner(unittest.TextTestRunner):
    """Runs those tests once more that failed beside a stall, each by itself."""
    resultclass = _Result
    probe_type = Probe

    def run(self, test):
        with self.probe_type() as probe:
            result = super().run(test)
            for _ in range(REPEATS):
                failed = [case for case, _ in result.failures + result.errors]
                # One that has no end is no test but the failure of a whole class.
                stalls = [probe.longest(case.began, case.ended) if hasattr(case, "ended") else 0.0 for case in failed]
                if not failed or not all(stalls):
                    break
                for case, longest in zip(failed, stalls):
                    note(case.id(), longest)
                result = super().run(unittest.TestSuite(type(case)(case._testMethodName) for case in failed))
        return result


def main():
    """unittest.main() for tests of real processes."""
    unittest.main(verbosity=2, testRunner=Runner)
