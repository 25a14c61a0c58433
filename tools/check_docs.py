#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""Checks that what the documentation and the comments point to exists.

In every Markdown page: relative links with the heading they name, and paths in `backticks` that look like paths of this
repository. Fenced code blocks are not read.
In every source, comments and texts alike: pages (`safety.md`, `docs/reference/ports.md`) and other paths under docs/, headings
(`safety.md, "Watchdogs"`), numbered sections (`ARCHITECTURE.md, section 2`; of the thesis and of RFCs they are not followed)
and decisions (`ADR 0007`).
Prints `file:line: what: how to fix it` and exits with 1 when something is missing, with 0 when not, with 2 when it was
called wrongly.
"""
import argparse
import os
import re
import sys
from itertools import product
from pathlib import Path
from urllib.parse import unquote

SKIPPED_FOLDERS = {".git", ".cache", "build", "node_modules", "__pycache__", "dist", "dist-test", "gen"}
# A path begins with one of these folders, or is one of these files.
FOLDERS = {"api", "bench", "cmake", "deploy", "docs", "examples", "faults", "lab", "robots", "simulation", "src", "tests", "tools", "web", "LICENSES", ".ci"}
FILES = {"README.md", "ARCHITECTURE.md", "CONTRIBUTING.md", "CHANGELOG.md", "CMakeLists.txt", "CMakePresets.json",
         ".clang-format", ".clang-tidy", "demo", "check", "./demo", "./check"}
LINK = re.compile(r"!?\[[^\]]*\]\(\s*<?([^)>\s]+)>?(?:\s+\"[^\"]*\")?\s*\)")
CODE = re.compile(r"`([^`\n]+)`")

SOURCES = {".cpp", ".hpp", ".proto", ".ice", ".py", ".mjs", ".ts", ".xsd", ".cmake", ".sh"}
UNREAD = {"tools/checks_test.py",  # points to what is missing, on purpose
          "tools/docs_site/contracts.py", "tools/docs_site/stage.py"}  # name pages of the site
# A comment that goes on in the next line is read as one text.
CONTINUED = re.compile(r"\n[ \t]*(?:///?<?|#|\*(?!/))?[ \t]*")
PATH = re.compile(r"(?<![\w./-])(?:(?:\.\./)*[\w-]+/)*[\w-]+\.md\b|(?<![\w./-])docs/[\w./-]*\w")
HEADING = re.compile(r'([\w./-]+\.md),\s+"([^"]+)"')
SECTION = re.compile(r"([\w./-]+),\s+(?:chapter|section)s?\s+(\d+)", re.IGNORECASE)
DECISION = re.compile(r"\bADR\s+(\d+)")


def pages(root):
    for folder, folders, names in os.walk(root):
        folders[:] = sorted(f for f in folders if f not in SKIPPED_FOLDERS)
        for name in sorted(names):
            if name.endswith(".md"):
                yield Path(folder) / name


def sources(root):
    for folder, folders, names in os.walk(root):
        folders[:] = sorted(f for f in folders if f not in SKIPPED_FOLDERS)
        for name in sorted(names):
            file = Path(folder) / name
            if file.relative_to(root).as_posix() in UNREAD:
                continue
            if file.suffix in SOURCES or name == "CMakeLists.txt":
                yield file, file.read_text(encoding="utf-8")
            elif not file.suffix:  # a script
                with file.open("rb") as opened:
                    if opened.read(2) == b"#!":
                        yield file, file.read_text(encoding="utf-8")


def prose(text):
    """(number, line) of each line outside fenced blocks."""
    fence = None
    for number, line in enumerate(text.splitlines(), 1):
        mark = re.match(r"\s*(```+|~~~+)", line)
        if mark:
            if fence is None:
                fence = mark.group(1)[:3]
            elif mark.group(1).startswith(fence):
                fence = None
            continue
        if fence is None:
            yield number, line


def anchors(page):
    """The names by which a page's headings can be linked, as the usual web views make them."""
    seen = {}
    result = set()
    for _, line in prose(page.read_text(encoding="utf-8")):
        heading = re.match(r"#{1,6}\s+(.*?)\s*#*$", line)
        if heading:
            slug = re.sub(r"[^\w\- ]", "", heading.group(1).lower()).replace(" ", "-")
            count = seen.get(slug, 0)
            seen[slug] = count + 1
            result.add(slug if count == 0 else f"{slug}-{count}")
        result.update(re.findall(r"<a\s+(?:id|name)=\"([^\"]+)\"", line))
    return result


def alternatives(path):
    """`a/{b,c}.hpp` means a/b.hpp and a/c.hpp."""
    parts = re.split(r"\{([^{}]*)\}", path)
    choices = [[part] if i % 2 == 0 else part.split(",") for i, part in enumerate(parts)]
    return ["".join(choice).strip() for choice in product(*choices)]


def looks_like_path(text):
    if re.search(r"[\s<>$|=()\"'…]", text) or "://" in text:
        return False
    if text in FILES:
        return True
    first, slash, _ = text.removeprefix("./").partition("/")
    return bool(slash) and first in FOLDERS


def exists(root, text):
    path = re.sub(r"(:\d+)?(#.*)?$", "", text).removeprefix("./")
    for one in alternatives(path):
        if any(c in one for c in "*?["):
            if not any(True for _ in root.glob(one.rstrip("/"))):
                return one
        elif not (root / one).exists() and not (root / one).suffix and any(True for _ in root.glob(one.rstrip("/") + ".*")):
            continue  # a/b means the pair a/b.hpp and a/b.cpp
        elif not (root / one).exists():
            return one
    return None


def headings(page):
    return [m.group(1) for _, line in prose(page.read_text(encoding="utf-8")) if (m := re.match(r"#{1,6}\s+(.*?)\s*#*$", line))]


def dead_references(root):
    """Of sources."""
    all_pages = [page.relative_to(root) for page in pages(root)]

    def page_of(file, name):
        """The page that a source means by a path or, where only one has it, by its name."""
        for there in (root / name, file.parent / name):
            if there.is_file():
                return there
        ends = [page for page in all_pages if f"/{page.as_posix()}".endswith("/" + re.sub(r"^(\.\./)+", "", name))]
        return root / ends[0] if len(ends) == 1 else None

    for file, text in sources(root):
        shown = file.relative_to(root).as_posix()
        text = CONTINUED.sub(lambda gap: "\n" + " " * (len(gap.group()) - 1), text)

        def at(hit):
            return shown, text.count("\n", 0, hit.start()) + 1

        for hit in PATH.finditer(text):
            name = hit.group()
            if not (page_of(file, name) if name.endswith(".md") else (root / name).exists()):
                yield *at(hit), f"{name} is no page of the repository", "name one by its path from the root, such as docs/reference/ports.md"
        for hit in HEADING.finditer(text):
            page, heading = page_of(file, hit.group(1)), re.sub(r"\s+", " ", hit.group(2))
            if page and heading not in headings(page):
                yield *at(hit), f"{hit.group(1)} has no heading \"{heading}\"", "use the words of a heading"
        for hit in SECTION.finditer(text):
            name, number = hit.groups()
            page = page_of(file, name)
            if name.isdecimal() or name == "thesis" or name.endswith(".md") and not page:
                continue  # of an RFC, of the thesis; or reported already
            if not page:
                yield *at(hit), f"{name}, section {number}: no text of the repository is called so", "name the page by its path"
            elif not any(heading.startswith(f"{number}.") for heading in headings(page)):
                yield *at(hit), f"{name} has no section {number}", "use the number of a heading"
        for hit in DECISION.finditer(text):
            if not any(root.glob(f"docs/adr/{hit.group(1)}-*.md")):
                yield *at(hit), f"ADR {hit.group(1)} does not exist", "use a number of docs/adr/README.md"


def findings(root):
    root = Path(root).resolve()
    yield from dead_references(root)
    for page in pages(root):
        shown = page.relative_to(root).as_posix()
        for number, line in prose(page.read_text(encoding="utf-8")):
            bare = CODE.sub("", line)
            for target in LINK.findall(bare if "](" in bare else line):
                if re.match(r"[a-z][a-z0-9+.-]*:", target):
                    continue
                name, _, anchor = unquote(target).partition("#")
                there = (page.parent / name).resolve() if name else page
                if not there.exists():
                    yield shown, number, f"link to {target}, but there is no such file", "correct the path, relative to this page"
                elif not there.is_relative_to(root):
                    yield shown, number, f"link to {target} leaves the repository", "link to a page of the repository"
                elif anchor and there.suffix == ".md" and anchor not in anchors(there):
                    yield shown, number, f"link to {target}, but that page has no such heading", "use the name of a heading"
            for text in CODE.findall(line):
                if looks_like_path(text):
                    missing = exists(root, text)
                    if missing:
                        yield shown, number, f"`{missing}` does not exist", "correct the path, from the root of the repository"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("root", nargs="?", default=Path(__file__).resolve().parent.parent, help="the repository (default: this one)")
    root = Path(parser.parse_args().root)
    if not root.is_dir():
        parser.error(f"{root} is no folder: expected the root of the repository")
    found = list(findings(root))
    for path, line, what, how in found:
        print(f"{path}:{line}: {what}: {how}")
    print(f"check_docs: {len(found)} finding(s)" if found else "check_docs: everything pointed to is there")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
