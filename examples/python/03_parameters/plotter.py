# SPDX-License-Identifier: MIT
"""plotter.py [PORTS_FILE]: a simulated plotter."""
import math
import pathlib
import sys
from typing import Annotated, Literal, Optional

from axon_entity import Config, Entity, Misconfiguration, Output, Parameter, Range, Resource, Task, Unit

PERIOD_S = 0.02
Millimetres = Annotated[float, Unit("mm")]


def read_drawing(file: pathlib.Path) -> list[tuple[float, float]]:
    """Raises ValueError with a text for the person who has written the file."""
    points = []
    for number, line in enumerate(file.read_text(encoding="utf-8").splitlines(), 1):
        try:
            x, y = map(float, line.split())
        except ValueError:
            raise ValueError(f"line {number}: expected two numbers from 0 to 1, such as 0.5 1") from None
        points.append((x, y))
    if len(points) < 2:
        raise ValueError("expected two points or more")
    return points


def main(ports_file: Optional[str] = None) -> None:
    plotter = Entity("Plotter", category="MACHINE", description="Draws lines from a file with a pen.", ports_file=ports_file)

    # [parameter]
    @plotter.on_parameter
    def decide(service: str, parameter: Parameter) -> Optional[str]:
        return "the red pen is empty" if parameter.name == "Color" and parameter.values == ["red"] else None
    # [end]

    # [config]
    @plotter.on_config
    def set_config(service: str, parameter: Parameter) -> None:
        print(parameter.name, "is", *parameter.values, parameter.units, flush=True)
    # [end]

    # [upload]
    @plotter.on_upload
    def look_at(service: str, resource: str, file: pathlib.Path) -> Optional[str]:
        try:
            read_drawing(file)
        except ValueError as error:
            return str(error)
        return None
    # [end]

    # [draw]
    pen = plotter.stream("pen")

    @plotter.service("Draw", feedback={"Drawn": Millimetres})
    def draw(task: Task, Size: Annotated[float, Unit("mm"), Range(10, 500)],
             Drawing: Annotated[pathlib.Path, Resource(savable=True)],
             Color: Literal["black", "blue", "red"] = "black",
             Speed: Annotated[float, Unit("mm/s"), Range(10, 800), Config()] = 200.0) -> Annotated[float, Output("Length"), Unit("mm")]:
        """Draws the lines of the drawing."""
        points = read_drawing(Drawing)
        drawn_mm = 0.0
        for number, (start, end) in enumerate(zip(points, points[1:]), 1):
            line_mm = math.dist(start, end) * Size
            done_mm = 0.0
            while done_mm < line_mm:
                if not task.wait(PERIOD_S):
                    return drawn_mm
                done_mm = min(line_mm, done_mm + task["Speed"] * PERIOD_S)  # as it is now
                part = done_mm / line_mm
                pen.publish([(a + (b - a) * part) * Size for a, b in zip(start, end)], units="mm")
            drawn_mm += line_mm
            task.report("Drawn", drawn_mm)
            task.progress(number / (len(points) - 1))
        return drawn_mm
    # [end]

    plotter.run()


if __name__ == "__main__":
    try:
        main(*sys.argv[1:2])
    except Misconfiguration as error:
        sys.exit(str(error))
