#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""greet.py [SERVER]: lets the entity Greeter say hello. The whole life of a client on one page."""
import sys

import axon


# [all]
def main(server=None):
    with axon.connect(server) as lab:  # otherwise AXON_SERVER, or 127.0.0.1:10410
        greeter = lab.wait_for("Greeter", 10)
        print(f"{greeter.name}: {greeter.descr}")
        with lab.checkout("Greeter") as robot:
            print("checked out")
            task = robot.start("Greet", Name="Ada", Times=2)
            for update in task:
                print(f"{update.state.name} {update.progress:g} {update.feedback}")
            task.result()
        print("released")


if __name__ == "__main__":
    try:
        main(*sys.argv[1:])
    except axon.Refused as refused:  # a code for the program, and a message for the person
        sys.exit(f"{refused.code.name}: {refused.message}")
# [end]
