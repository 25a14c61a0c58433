#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""Keeps the code in documents equal to the sources that it is quoted from.

    tools/quote.py --check | --write [PAGE…]

A page quotes with a comment before a fenced block:

    <!-- quote: examples/02_client/main.cpp [connect] -->
    ```cpp
    …
    ```

The block is then the region of that name, without its indentation, or the whole file if no region is named. In a source,
a region is what lies between a comment `[NAME]` and the next comment `[end]`, each on a line of its own: `// [connect]`
in C++, `<!-- [connect] -->` in XML, `# [connect]` elsewhere. Such lines are never quoted.

Without a page, all pages of docs/ and examples/ are read. --check prints `page:line: what: how to fix it` and exits with 1
if a block differs or cannot be made; --write replaces the blocks that differ. Exit status 2: called wrongly.
"""
import argparse
import re
import sys
import textwrap
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
QUOTE = re.compile(r"^<!-- quote: (?P<file>\S+?)(?: \[(?P<region>[\w-]+)\])? -->$")
MARKER = re.compile(r"^\s*(?://|#|<!--)\s*\[(?P<name>[\w-]+)\]\s*(?:-->)?\s*$")


class CannotQuote(Exception):
    """What was expected, and how to fix it."""


def lines_of(file, region=None):
    """The lines that a quotation of this file has: of one region, or all but the markers."""
    found, inside, opened = [], region is None, False
    for line in file.read_text(encoding="utf-8").splitlines():
        marker = MARKER.match(line)
        if not marker:
            if inside:
                found.append(line)
            continue
        if region is None:
            continue
        if marker["name"] == region:
            if opened:
                raise CannotQuote(f"{file} has two regions [{region}]: give each a name of its own")
            inside = opened = True
        elif inside:
            if marker["name"] != "end":
                raise CannotQuote(f"{file}: region [{region}] has no end: write a comment [end] after it")
            inside = False
    if region is not None and not opened:
        raise CannotQuote(f"{file} has no region [{region}]: mark it with comments [{region}] and [end]")
    if region is not None and inside:
        raise CannotQuote(f"{file}: region [{region}] has no end: write a comment [end] after it")
    return textwrap.dedent("\n".join(found)).strip("\n").split("\n")


def quoted(text, root=ROOT):
    """(the page with every quotation as it should be, findings as (line number, text))."""
    lines, result, findings = text.split("\n"), [], []
    at = 0
    while at < len(lines):
        line = lines[at]
        result.append(line)
        at += 1
        if not line.startswith("<!-- quote:"):
            continue
        mark = QUOTE.match(line)
        if not mark:
            findings.append((at, "expected <!-- quote: FILE [REGION] --> with a path from the root of the repository"))
            continue
        if at >= len(lines) or not lines[at].startswith("```"):
            findings.append((at, "no fenced block follows: add ``` and the language on the next line"))
            continue
        end = next((i for i in range(at + 1, len(lines)) if lines[i] == "```"), None)
        if end is None:
            findings.append((at, "the block has no end: close it with ```"))
            continue
        file = root / mark["file"]
        try:
            if not file.is_file():
                raise CannotQuote(f"{mark['file']} does not exist: give the path from the root of the repository")
            wanted = lines_of(file, mark["region"])
        except CannotQuote as error:
            findings.append((at, str(error)))
            wanted = lines[at + 1:end]
        if wanted != lines[at + 1:end]:
            findings.append((at, f"differs from {mark['file']}: run tools/quote.py --write"))
        result += [lines[at], *wanted, "```"]
        at = end + 1
    return "\n".join(result), findings


def pages(root=ROOT):
    for folder in ("docs", "examples"):
        yield from sorted((root / folder).rglob("*.md"))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    way = parser.add_mutually_exclusive_group(required=True)
    way.add_argument("--check", action="store_true", help="print what differs")
    way.add_argument("--write", action="store_true", help="replace what differs")
    parser.add_argument("page", nargs="*", type=Path, help="a Markdown page (default: all of docs/ and examples/)")
    options = parser.parse_args()
    status = 0
    for page in options.page or pages():
        if not page.is_file():
            parser.error(f"{page} is no file")
        text = page.read_text(encoding="utf-8")
        right, findings = quoted(text)
        if options.write and right != text:
            page.write_text(right, encoding="utf-8")
            findings = [one for one in findings if not one[1].startswith("differs")]
            print(f"{page}: quotations written")
        for number, what in findings:
            print(f"{page}:{number}: {what}")
            status = 1
    return status


if __name__ == "__main__":
    sys.exit(main())
