# SPDX-License-Identifier: GPL-2.0-or-later
"""Lays the pages of the repository out for Sphinx: the same folders and names, so that links between pages stay as they are.

What Markdown of a repository has and Sphinx does not is put right in the copies: links to folders and to files that are no
pages, and diagrams. The copies also get what the navigation needs. The pages themselves know nothing of the site.
"""
import os
import re
import shutil
import subprocess
from urllib.parse import unquote

import check_docs

SECTIONS = {
    "tutorials": ("Tutorials", "Lessons with a result, step by step.", ("docs/tutorials/", "examples/")),
    "how-to": ("How-tos", "How to reach a goal.", ("docs/how-to/",)),
    "reference": ("Reference", "Facts to look up.", ("docs/reference/", "docs/results.md", "docs/design/", "api/schema/")),
    "explanation": ("Explanation", "Why Axon is as it is, and what follows from that.", ("docs/explanation/",)),
    "decisions": ("Decisions", "One page for each decision that is not obvious from the code.", ("docs/adr/",)),
    "code": ("The code", "For those who read or change Axon.", ("",)),  # what is nowhere else
}
# On the first level of the navigation; the others are below a section.
FIRST = [("Start here", "README.md"), ("Questions", "docs/questions.md"), ("Installation", "docs/how-to/install.md")]
TEMPLATES = "src/cli/init/"  # of projects: pages for whoever makes one, with places to fill in
LAST = [("Glossary", "docs/glossary.md"), ("Changes", "CHANGELOG.md"), ("List of all pages", "docs/README.md")]


def release(root):
    return re.search(r"project\(Axon VERSION ([\d.]+)", (root / "CMakeLists.txt").read_text(encoding="utf-8")).group(1)


def title_of(text):
    return next((line[2:].strip() for line in text.splitlines() if line.startswith("# ")), "")


def descriptions(root):
    """What docs/README.md says of each page, in the order in which it does; links as seen from a folder below the root."""
    index = root / "docs" / "README.md"
    found = {}
    for _, line in check_docs.prose(index.read_text(encoding="utf-8")):
        row = re.match(r"\| \[[^\]]*\]\(([^)#]+)\) \| (.*) \|$", line)
        if row:
            name = os.path.normpath(os.path.join("docs", row.group(1)))
            found[name] = re.sub(r"\]\((?!https?:)([^)#]+)", lambda m: "](../" + os.path.normpath(os.path.join("docs", m.group(1))), row.group(2))
    return found


def section_of(name):
    return next(key for key, (_, _, starts) in SECTIONS.items() if name.startswith(starts))


def with_links(root, page, text, extra):
    """The text of a page with links that Sphinx can follow; adds to `extra` what has to be staged for that."""
    def follow(match):
        target = match.group(2)
        if re.match(r"[a-z][a-z0-9+.-]*:", target):
            return match.group()
        name, _, anchor = unquote(target).partition("#")
        if not name or name.endswith(".md"):
            return match.group()
        there = (page.parent / name).resolve()
        shown = os.path.relpath(there, page.parent)
        if there.is_dir():
            shown += "/README.md"
            if not (there / "README.md").exists():
                extra[there.relative_to(root) / "README.md"] = None
        else:
            extra[there.relative_to(root)] = there
        return f"{match.group(1)}({shown}{'#' + anchor if anchor else ''})"

    inside, lines = None, []
    for line in text.splitlines():
        mark = re.match(r"\s*(```+|~~~+)", line)
        if mark:
            inside = None if inside == mark.group(1) else inside or mark.group(1)
        lines.append(line if inside or mark else re.sub(r"(!?\[(?:[^\]`]|`[^`]*`)*\])\(\s*<?([^)>\s]+)>?\s*\)", follow, line))
    return "\n".join(lines) + "\n"


def drawn(diagram):
    """A state diagram of Mermaid as a picture in the page, in the colours of the page. Graphviz draws it."""
    def label(text):
        words, rows = [word.strip() for word in text.split(",")], [""]
        for word in words:
            if len(rows[-1]) + len(word) > 30 and rows[-1]:
                rows.append("")
            rows[-1] += ("" if not rows[-1] else ", ") + word
        return ",\\n".join(rows)

    edges = re.findall(r"^\s*(\S+)\s*-->\s*(\S+)(?:\s*:\s*(.*))?$", diagram, re.MULTILINE)
    if not edges:
        raise RuntimeError("a Mermaid diagram without edges; fix: draw a stateDiagram-v2, or teach tools/docs_site/stage.py others")
    lines = ["digraph {", 'bgcolor="transparent"; rankdir=TB; nodesep=0.5; ranksep=0.6;',
             'node [shape=box, style=rounded, fontname="Helvetica", fontsize=14]; edge [fontname="Helvetica", fontsize=10];']
    for start, end, text in edges:
        if start == "[*]":
            lines.append('"[*]" [shape=point, width=0.15];')
        lines.append(f'"{start}" -> "{end}" [label="{label(text)}"];')
    picture = subprocess.run(["dot", "-Tsvg"], input="\n".join(lines + ["}"]), capture_output=True, text=True, check=True).stdout
    picture = picture[picture.index("<svg"):]
    picture = re.sub(r'(stroke|fill)="black"', r'\1="currentColor"', picture)
    picture = re.sub(r"<text ", '<text fill="currentColor" ', picture)
    picture = re.sub(r"<title>.*?</title>|<!--.*?-->", "", picture, flags=re.DOTALL)
    picture = re.sub(r' id="[^"]*"', "", picture)
    return f'```{{raw}} html\n<div class="diagram">{picture}</div>\n```'


def with_diagrams(text):
    return re.sub(r"^```mermaid\n(.*?)^```$", lambda match: drawn(match.group(1)), text, flags=re.DOTALL | re.MULTILINE)


def toctree(entries, options=""):
    return "\n```{toctree}\n" + options + "\n" + "\n".join(entries) + "\n```\n"


def entry(name, title=None):
    path = "/" + re.sub(r"\.(md|rst)$", "", name)
    return f"{title} <{path}>" if title else path


def write(root, source):
    """`source` may hold pages of the API already (contracts.write)."""
    texts = {page.relative_to(root).as_posix(): page.read_text(encoding="utf-8") for page in check_docs.pages(root)
             if not page.relative_to(root).as_posix().startswith(TEMPLATES)}
    told = descriptions(root)
    front = [name for _, name in FIRST + LAST]
    order = {name: number for number, name in enumerate(told)}
    listed = {key: [] for key in SECTIONS}
    for name in sorted(texts, key=lambda name: (order.get(name, len(order)), name)):
        if name not in front and name != "docs/adr/README.md":
            listed[section_of(name)].append(name)

    extra = {}
    for name, text in texts.items():
        text = with_diagrams(with_links(root, root / name, text, extra))
        if name == "docs/adr/README.md":
            text += toctree([entry(one) for one in listed["decisions"]], ":hidden:\n")
        (source / name).parent.mkdir(parents=True, exist_ok=True)
        (source / name).write_text(text, encoding="utf-8")
    for name, there in extra.items():
        (source / name).parent.mkdir(parents=True, exist_ok=True)
        if there:
            shutil.copyfile(there, source / name)
        else:  # a folder that has no page of its own
            files = sorted(one.name for one in (root / name).parent.iterdir() if one.is_file())
            for file in files:
                shutil.copyfile((root / name).parent / file, (source / name).parent / file)
            (source / name).write_text(f"---\norphan: true\n---\n# {name.parent.name}\n" +
                                       "".join(f"* [{file}]({file})\n" for file in files), encoding="utf-8")

    sections = []
    for key, (title, what, _) in SECTIONS.items():
        if key == "decisions":
            sections.append((title, "docs/adr/README.md", what))
        elif listed[key]:
            lines = [f"# {title}", what, ""]
            for name in listed[key]:
                lines.append(f"* [{title_of(texts[name])}](../{name})" + (f": {told[name]}" if name in told else ""))
            (source / "sections").mkdir(exist_ok=True)
            (source / f"sections/{key}.md").write_text("\n".join(lines) + "\n" + toctree([entry(n) for n in listed[key]], ":hidden:\n"), encoding="utf-8")
            sections.append((title, f"sections/{key}.md", what))
        if key == "reference":
            sections.append(("API", "sections/api.md", "Classes of the two libraries, and the contracts between the programs."))

    first = [(title, name) for title, name in FIRST if name in texts]
    last = [(title, name) for title, name in LAST if name in texts]
    lines = [f"# Axon {release(root)}",
             "Axon is middleware for a laboratory with several robots: people and programs share the robots, command them and stop them.", "",
             "New here? [Start here](README.md)" +
             (", or look up one of the [questions that everybody asks](docs/questions.md)." if "docs/questions.md" in texts else "."),
             "The search on the left looks through all pages.", ""]
    lines += [f"* [{title}]({name}): {what[0].lower()}{what[1:]}" for title, name, what in sections]
    lines += ["", "These pages belong to the release that their title names."]
    names = [entry(name, title) for title, name in first] + [entry(name, title) for title, name, _ in sections] + \
            [entry(name, title) for title, name in last]
    (source / "index.md").write_text("\n".join(lines) + "\n" + toctree(names, ":hidden:\n"), encoding="utf-8")
