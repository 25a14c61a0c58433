# SPDX-License-Identifier: GPL-2.0-or-later
"""Writes refusals.py from the one list of refusals: make_refusals.py refusals.def refusals.py"""
import re
import sys

HEAD = '''# SPDX-License-Identifier: GPL-2.0-or-later
# Made from refusals.def by make_refusals.py.
"""The codes of refusals."""
import enum
from typing import Dict


class RefusalCode(enum.IntEnum):
    """Why a request was refused. Names and numbers are those of the contracts (docs/reference/refusals.md)."""

'''


def main(source: str, target: str) -> None:
    row = re.compile(r'^AXON_REFUSAL\((\w+), (\w+), (\d+), \d+, "[^"]*", "((?:[^"\\]|\\.)*)", "((?:[^"\\]|\\.)*)"\)$', re.MULTILINE)
    with open(source, encoding="utf-8") as file:
        text = file.read()
    rows = row.findall(text)
    if len(rows) != len(re.findall(r"^AXON_REFUSAL\(", text, re.MULTILINE)):
        sys.exit(f"{source}: a row is not understood; fix: write it as the comment above the list says")
    lines = [HEAD]
    for _, name, number, meaning, _ in rows:
        meaning = re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", meaning)
        lines.append(f"    {name} = {number}\n")
        lines.append(f"    {(meaning[0].upper() + meaning[1:] + '.')!r}\n")
    lines.append("\n\nREMEDIES: Dict[RefusalCode, str] = {\n")
    lines += [f"    RefusalCode.{name}: {remedy!r},\n" for _, name, _, _, remedy in rows if remedy]
    lines.append('}\n"""What to do about a refusal; {entity} and {holder} stand for names."""\n')
    with open(target, "w", encoding="utf-8") as file:
        file.writelines(lines)


if __name__ == "__main__":
    main(*sys.argv[1:])
