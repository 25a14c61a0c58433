# SPDX-License-Identifier: GPL-2.0-or-later
"""An interactive prompt that is connected: `axon shell`, or python3 -m axon.shell [HOST:PORT].

It is IPython with `lab`, a connection, and its calls by their names: checkout("PeopleBot"), stop(), rearm("PeopleBot"),
entities(). The tab key completes the names of entities, services, parameters, choices and units.
"""
from __future__ import annotations

import argparse
import importlib
import os
import re
import sys
from typing import Any, Dict, List, Mapping, Optional, Sequence, Tuple

import axon
from axon.client import Lab, Robot
from axon.values import parameter_words

OF_ENTITIES = r"(?:checkout|checkout_all|wait_for|find|stop|rearm|services|details|drill|stream)"
STRING = r"[\"']([^\"']*)$"


Found = Tuple[str, List[str]]
NOTHING: Found = ("", [])


def completions(line: str, names: Mapping[str, object]) -> Found:
    """What has been typed of a word at the end of `line`, and the words that begin so; `names` are the prompt's variables."""
    call = re.search(r"(\w+)\.(run|start|set|service|upload)\((.*)$", line)
    robot = names.get(call.group(1)) if call else None
    if call and isinstance(robot, Robot):
        return in_call(robot, call.group(2), call.group(3))
    lab = names.get("lab")
    typed = re.search(rf"\b{OF_ENTITIES}\([^()]*?{STRING}", line)
    if typed and isinstance(lab, Lab):
        return begins([entity.name for entity in lab.entities()], typed.group(1))
    return NOTHING


def in_call(robot: Robot, verb: str, rest: str) -> Found:
    """Inside robot.run(…) and its like: `rest` follows the bracket."""
    service_typed = re.match(rf"\s*{STRING}", rest)
    if service_typed:
        return begins([service.name for service in robot.services], service_typed.group(1))
    named = re.match(r"\s*[\"']([^\"']*)[\"']\s*,(.*)$", rest)
    service = next((one for one in robot.services if named and named.group(1) in (one.name, one.global_id)), None)
    if service is None or named is None:
        return NOTHING
    given = named.group(2)
    if verb == "upload":
        typed = re.match(rf"\s*{STRING}", given)
        return begins([resource.name for resource in service.resources], typed.group(1)) if typed else NOTHING
    parameters = {parameter.name: parameter for parameter in service.parameters}
    unit = re.search(rf"(\w+)\s*=\s*(?:axon\.)?Quantity\([^,()]*,\s*{STRING}", given)
    if unit:
        of = parameters.get(unit.group(1))
        return begins([of.units] if of and of.units else [], unit.group(2))
    choice = re.search(rf"(\w+)\s*=\s*{STRING}", given)
    if choice:
        of = parameters.get(choice.group(1))
        return begins([str(one) for one in of.choices] if of else [], choice.group(2))
    word = re.search(r"(?:^|,)\s*(\w*)$", given)
    if not word:
        return NOTHING
    taken = re.findall(r"(\w+)\s*=", given)
    return begins([f"{name}=" for name in parameter_words(service) if name not in taken and name.isidentifier()], word.group(1))


def begins(words: Sequence[str], typed: str) -> Found:
    return typed, sorted({word for word in words if word.startswith(typed)})


def install(shell: Any) -> None:
    """Gives IPython the completions. Its `text` is what follows the last separator, such as a space inside a name."""
    def matcher(completer: Any, text: str) -> List[str]:
        typed, words = completions(completer.text_until_cursor, shell.user_ns)
        return [text + word[len(typed):] for word in words]
    shell.set_custom_completer(matcher, 0)


def variables(lab: Lab) -> Dict[str, Any]:
    """What the prompt knows from the beginning."""
    return {"axon": axon, "lab": lab, "Quantity": axon.Quantity, "Refused": axon.Refused, "checkout": lab.checkout, "stop": lab.stop,
            "rearm": lab.rearm, "entities": lab.entities}


def main(words: Optional[Sequence[str]] = None) -> int:
    parser = argparse.ArgumentParser(prog="axon shell", description="An interactive prompt of Python that is connected to a laboratory.")
    parser.add_argument("server", nargs="?", help="HOST:PORT (AXON_SERVER; default 127.0.0.1:10410)")
    given = parser.parse_args(words)
    try:
        ipython = importlib.import_module("IPython")
        config = importlib.import_module("traitlets.config").Config()
    except ImportError as error:
        print(f"axon shell needs IPython, which is not there ({error}); fix: apt install ipython3", file=sys.stderr)
        return 2
    try:
        lab = axon.connect(given.server)
    except axon.Refused as refused:
        print(refused, file=sys.stderr)
        return 3
    os.environ.pop("AXON_PASSWORD", None)  # not for the programs that are started from the prompt
    with lab:
        there = ", ".join(entity.name for entity in lab.entities()) or "no entity"
        config.Completer.use_jedi = False
        config.TerminalInteractiveShell.banner1 = (
            f"Connected to {lab.server} as {lab.me.name}. There: {there}.\n"
            "robot = checkout(\"NAME\"); robot.run(\"SERVICE\", PARAMETER=VALUE); stop() stops everything. The tab key completes.\n")
        config.InteractiveShellApp.exec_lines = ["import axon.shell as _shell; _shell.install(get_ipython()); del _shell"]
        ipython.start_ipython(argv=[], user_ns=variables(lab), config=config)
    return 0


if __name__ == "__main__":
    sys.exit(main())
