# SPDX-License-Identifier: MIT
from typing import Annotated

from axon_entity import Entity, Range, Task, Unit

entity = Entity("Greeter", category="MACHINE", description="Says hello, and waits.")


@entity.service("Greet", description="Says hello to somebody, every 200 ms.")
def greet(task: Task, Name: str, Times: Annotated[int, Range(1, 1000)] = 3) -> None:
    for done in range(1, Times + 1):
        if not task.wait(0.2):
            return
        task.feedback(f"Hello, {Name}!")
        task.progress(done / Times)


@entity.service("Wait", description="Does nothing for a while.")
def wait(task: Task, Seconds: Annotated[float, Unit("s"), Range(0, 3600)]) -> None:
    task.wait(Seconds)


if __name__ == "__main__":
    entity.run()
