#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""draw.py [FOLDER_OF_DRAWINGS [SERVER]]: sets, uploads and watches what the entity Plotter takes and gives."""
import pathlib
import sys

import axon
from axon import Quantity


# [describe]
def describe(service):
    for parameter in service.parameters:
        choices = "".join(f" [{choice}]" for choice in parameter.choices)
        print(f"  {parameter.name}: {parameter.kind.name} {parameter.data_type.name} {parameter.units}{choices}")
    for missing in service.missing:
        print(f"  missing: {missing}")
# [end]


def show(what, call):
    """Prints how it went: a refusal is what this program wants to show."""
    try:
        result = call()
        print(f"{what}: OK")
        return result
    except axon.Refused as refused:
        print(f"{what}: {refused.code.name}, {refused.message}")
        return None


def main(drawings=".", server=None):
    drawings = pathlib.Path(drawings)
    with axon.connect(server) as lab:
        lab.wait_for("Plotter", 10)
        with lab.checkout("Plotter") as plotter:
            describe(plotter.service("Draw"))
            # [set]
            show("Speed 2000", lambda: plotter.set("Draw", Speed=2000))
            show("Speed 50 cm/s", lambda: plotter.set("Draw", Speed=Quantity(50, "cm/s")))
            show("Speed 400", lambda: plotter.set("Draw", Speed=Quantity(400, "mm/s")))
            # [end]
            # [upload]
            show("without a drawing", lambda: plotter.run("Draw", Size=100))
            show("broken.txt", lambda: plotter.upload("Draw", "Drawing", drawings / "broken.txt"))
            show("house.txt", lambda: plotter.upload("Draw", "Drawing", drawings / "house.txt"))
            # [end]
            # [choices]
            show("in green", lambda: plotter.run("Draw", Size=100, Color="green"))
            show("in red", lambda: plotter.run("Draw", Size=100, Color="red"))
            # [end]
            # [watch]
            with plotter.stream("pen", limit=1000).watch() as pen:
                drawn = show("in blue", lambda: plotter.run("Draw", Size=100, Color="blue"))
                way = [sample.data for sample in pen.take(20)]  # x and y, as NumPy arrays
            print(f"Length {drawn.Length}, more than 20 samples: {'yes' if len(way) >= 20 else 'no'}")
            # [end]


if __name__ == "__main__":
    try:
        main(*sys.argv[1:])
    except axon.Refused as refused:
        sys.exit(f"{refused.code.name}: {refused.message}")
