#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""One client of cluster_faults.py, in a process of its own. Reads a JSON object from each line, answers each with one:

    {"id": 1, "do": "work", "robot": "robot-1"}   holds it and starts a long task; answered when that runs
    {"id": 2, "do": "use", "robot": "robot-1"}    ends that task, holds it and runs a short one; says why it lost the lease that it
                                                  had, or an empty text if it still has that
    {"id": 3, "do": "drill", "robot": "robot-1"}  tests whether its stop would arrive at the application
    {"id": 4, "do": "take", "robot": "robot-1"}   tries to check it out, and gives it back at once
    {"id": 5, "do": "list", "robot": ""}          says what it has been told of all robots
    {"id": 6, "do": "held", "robot": ""}          says which robots it holds
    {"id": 7, "do": "again", "robot": ""}         leaves, and connects again
    {"id": 1, "code": "", "refused": "", "said": null}  done; or what was refused, and why

Ends with its input. The first argument is its name, the second one a configuration file.
"""
import contextlib
import json
import os
import sys
import threading

import axon

REQUEST_S = 2.0  # a request may take that long, and is tried again
LONG_S = 3600


class Holder:
    def __init__(self, connect):
        self.connect = connect
        self.lab = connect()
        self.tasks = {}  # the long one of each robot
        self.lost = {}  # {robot whose lease has ended since it began to work: why}

    def hold(self, name):
        robot = next((robot for robot in self.lab.held() if robot.name == name), None)
        if not robot:
            robot = self.lab.checkout(name)
            robot.on_lost(lambda why: self.lost.__setitem__(name, f"{why.code.name}: {why.message}"))
        robot.rearm()
        return robot

    def work(self, name):
        task = self.hold(name).start("Wait", Seconds=LONG_S)
        self.lost.pop(name, None)
        self.tasks[name] = task
        for report in task:
            if report.final:
                raise axon.Refused(report.reason.code, report.reason.message)
            if report.state == axon.TaskState.RUNNING:
                return

    def use(self, name):
        task = self.tasks.pop(name, None)
        if task and not task.done:
            try:
                task.cancel()
            except axon.Refused:  # then the short one says more
                self.tasks[name] = task
        self.hold(name).start("Wait", Seconds=0.01).result(REQUEST_S)
        return self.lost.pop(name, "")

    def drill(self, name):
        if None in self.lab.drill(name)[0].callback:
            raise axon.Refused(axon.RefusalCode.TIMED_OUT, "no answer from the application")

    def take(self, name):
        robot = self.lab.checkout(name)
        with contextlib.suppress(axon.Refused):  # it was given, whatever becomes of giving it back
            robot.release()

    def list(self, _):
        return {entity.id: [entity.name, entity.holder.id, entity.state.name] for entity in self.lab.entities(all=True)}

    def held(self, _):
        return [robot.name for robot in self.lab.held()]

    def again(self, _):
        self.lab.close()
        self.tasks.clear()
        self.lab = self.connect()


def main():
    name, config = sys.argv[1:]
    holder, output = Holder(lambda: axon.connect(config=config, name=name, timeout=REQUEST_S)), threading.Lock()

    def answer(**what):
        with output:
            print(json.dumps(what), flush=True)

    def carry_out(request):
        try:
            answer(id=request["id"], code="", refused="", said=getattr(holder, request["do"])(request["robot"]))
        except axon.Refused as error:
            answer(id=request["id"], code=error.code.name, refused=f"{request['do']}: {error}")
        except Exception as error:  # pylint: disable=broad-except
            answer(id=request["id"], code="INTERNAL", refused=f"{request['do']}: {error!r}")

    answer(id=0, code="", refused="")
    for line in sys.stdin:
        threading.Thread(target=carry_out, args=(json.loads(line),), daemon=True).start()
    os._exit(0)  # without the answers that still wait


if __name__ == "__main__":
    main()
