# SPDX-License-Identifier: GPL-2.0-or-later
"""Writes the pages of the API: C++ classes (Doxygen and Breathe), Slice (Doxygen) and protobuf (protoc)."""
import os
import re
import subprocess
import xml.etree.ElementTree as ElementTree

from google.protobuf import descriptor_pb2

from slugs import github_slug

LIBRARIES = [
    # file of the site, title, folder of the headers, headers in their order, what it is
    ("client", "Client library", "src/client/axon", ["client.hpp", "types.hpp", "global.hpp"],
     "For programs that use robots."),
    ("results", "Results and refusals", "src/common/axon", ["result.hpp", "refusal.hpp", "states.hpp"],
     "What the client library answers with, and the states of an entity."),
    ("entity_interfacer", "Entity Interfacer", "src/entity_interfacer/axon", ["entity_interfacer.hpp", "device_guard.hpp"],
     "For robot applications."),
    ("testing_entity", "Tests of robot applications", "src/testing/entity/axon/testing",
     ["scripted_manager.hpp", "manual_clock.hpp", "failure.hpp"], "A scripted Entity Manager and a clock, for the test of a robot application."),
    ("testing_client", "Tests of programs that use robots", "src/testing/client/axon/testing", ["laboratory.hpp", "script.hpp"],
     "A laboratory with scripted robots, for the test of a program."),
]


def run(command, what, **more):
    done = subprocess.run(command, check=False, capture_output=True, text=True, **more)
    if done.returncode != 0:
        raise RuntimeError(f"{what} failed:\n{done.stdout}{done.stderr}")


def doxygen(folder, inputs, root, **settings):
    """Doxygen's XML of some files; returns its folder."""
    folder.mkdir()
    settings = {"PROJECT_NAME": "Axon", "OUTPUT_DIRECTORY": folder, "INPUT": " ".join(str(root / one) for one in inputs),
                "STRIP_FROM_PATH": root, "GENERATE_XML": "YES", "GENERATE_HTML": "NO", "GENERATE_LATEX": "NO", "XML_PROGRAMLISTING": "NO",
                "EXTRACT_ALL": "YES", "EXTRACT_PRIVATE": "NO", "HIDE_FRIEND_COMPOUNDS": "YES", "AUTOLINK_SUPPORT": "NO",
                "JAVADOC_AUTOBRIEF": "NO", "QUIET": "YES", "WARN_IF_UNDOCUMENTED": "NO", "SORT_MEMBER_DOCS": "NO",
                "OPTIMIZE_OUTPUT_SLICE": "NO", "MARKDOWN_SUPPORT": "YES", **settings}
    file = folder / "Doxyfile"
    file.write_text("".join(f"{key} = {value}\n" for key, value in settings.items()), encoding="utf-8")
    run(["doxygen", str(file)], "doxygen")
    return folder / "xml"


# --- texts of comments ---

def linked(text, page):
    """Paths of pages in a comment as links, as seen from this page of the site."""
    def link(match):
        name, heading = match.group(1), match.group(2)
        anchor = "#" + github_slug(heading) if heading else ""
        shown = name + (f', "{heading}"' if heading else "")
        return f"[{shown}]({os.path.relpath(name, os.path.dirname(page))}{anchor})"
    return re.sub(r'(?<![\w/`(\[])((?:docs|src|api)/[\w./-]+\.md)(?:,\s+"([^"]+)")?|(?<=\()((?:docs|src|api)/[\w./-]+\.md)',
                  lambda m: link(m) if m.group(1) else f"[{m.group(3)}]({os.path.relpath(m.group(3), os.path.dirname(page))})", text)


def escaped(text):
    """A comment is plain text but for `code`; what Markdown would take for more is escaped."""
    parts = re.split(r"(`[^`]+`)", text)
    return "".join(part if i % 2 else re.sub(r"([*<>\[\]|{}])", r"\\\1", part) for i, part in enumerate(parts))


def told(text, page):
    return linked(escaped(re.sub(r"\s+", " ", text).strip()), page)


def table(titles, rows):
    """A table whose last column is left out if no row has anything in it."""
    if not rows:
        return []
    if not any(row[-1] for row in rows):
        titles, rows = titles[:-1], [row[:-1] for row in rows]
    return [f"| {' | '.join(cells)} |" for cells in (titles, ["---"] * len(titles), *rows)] + [""]


# --- protobuf ---

SCALARS = {value: name.removeprefix("TYPE_").lower() for name, value in descriptor_pb2.FieldDescriptorProto.Type.items()}


class Proto:
    def __init__(self, root, work):
        folder = root / "api" / "proto"
        self.names = sorted(path.relative_to(folder).as_posix() for path in folder.glob("axon/*.proto"))
        out = work / "proto.bin"
        run(["protoc", f"-I{folder}", "--include_source_info", f"--descriptor_set_out={out}", *self.names], "protoc")
        everything = descriptor_pb2.FileDescriptorSet.FromString(out.read_bytes())
        self.files = {file.name: file for file in everything.file}
        self.sources = {name: (folder / name).read_text(encoding="utf-8") for name in self.names}
        self.homes = {}
        for name, file in self.files.items():
            for message in file.message_type:
                self.note(name, "", message)
            for enum in file.enum_type:
                self.homes[f".{file.package}.{enum.name}"] = (name, enum.name)

    def note(self, file, outer, message):
        name = outer + message.name
        self.homes[f".{self.files[file].package}.{name}"] = (file, name)
        for inner in message.nested_type:
            self.note(file, name + ".", inner)
        for enum in message.enum_type:
            self.homes[f".{self.files[file].package}.{name}.{enum.name}"] = (file, f"{name}.{enum.name}")

    def comments(self, file):
        found = {}
        for place in self.files[file].source_code_info.location:
            texts = [text.strip() for text in (place.leading_comments, place.trailing_comments) if text.strip()]
            if texts:
                found[tuple(place.path)] = "; ".join(texts)
        return found

    def type_of(self, field, page):
        label = "repeated " if field.label == field.LABEL_REPEATED else "optional " if field.proto3_optional else ""
        if field.type_name:
            file, name = self.homes[field.type_name]
            there = f"{os.path.basename(file).removesuffix('.proto')}.md"
            return f"{label}[{name}]({there}#{name.lower().replace('.', '')})"
        return label + SCALARS[field.type]

    def enum(self, name, enum, path, comments, page):
        rows = [(str(value.number), f"`{value.name}`", told(comments.get((*path, 2, i), ""), page)) for i, value in enumerate(enum.value)]
        return [f"## {name}", f"*enumeration* {told(comments.get(path, ''), page)}", "", *table(("number", "value", "meaning"), rows)]

    def message(self, name, message, path, comments, page):
        lines = [f"## {name}", told(comments.get(path, ""), page), ""]
        rows = []
        for i, field in enumerate(message.field):
            what = told(comments.get((*path, 2, i), ""), page)
            if field.HasField("oneof_index") and not field.proto3_optional:
                what = f"one of `{message.oneof_decl[field.oneof_index].name}`" + (f": {what}" if what else "")
            rows.append((str(field.number), f"`{field.name}`", self.type_of(field, page), what))
        lines += table(("number", "field", "type", "meaning"), rows)
        for i, enum in enumerate(message.enum_type):
            lines += self.enum(f"{name}.{enum.name}", enum, (*path, 4, i), comments, page)
        for i, inner in enumerate(message.nested_type):
            lines += self.message(f"{name}.{inner.name}", inner, (*path, 3, i), comments, page)
        return lines

    def write(self, source):
        pages = []
        for name in self.names:
            file, comments = self.files[name], self.comments(name)
            page = "api/proto/" + name.replace(".proto", ".md").replace("axon/", "")
            short = os.path.basename(name)
            # What stands above `syntax` is about the file.
            head = "\n".join(re.findall(r"^//(?! ?SPDX) ?(.*)$", self.sources[name].split("syntax", 1)[0], re.MULTILINE))
            lines = [f"# {short}", f"The messages of `api/proto/{name}`, package `{file.package}`.", told(head, page), ""]
            for i, message in enumerate(file.message_type):
                lines += self.message(message.name, message, (4, i), comments, page)
            for i, enum in enumerate(file.enum_type):
                lines += self.enum(enum.name, enum, (5, i), comments, page)
            (source / page).parent.mkdir(parents=True, exist_ok=True)
            (source / page).write_text("\n".join(lines), encoding="utf-8")
            pages.append((page, short, head.split(". ")[0].split("\n")[0].rstrip(".")))
        return pages


# --- Slice ---

def text_of(element):
    """Doxygen's description as one line of text with `code`."""
    if element is None:
        return ""
    out = [element.text or ""]
    for child in element:
        inner = text_of(child)
        out.append(f"`{inner}`" if child.tag == "computeroutput" else f" {inner} " if child.tag in ("para", "listitem", "simplesect") else inner)
        out.append(child.tail or "")
    return re.sub(r"[ \n]+", " ", "".join(out)).strip()


def description(element):
    return " ".join(filter(None, (text_of(element.find("briefdescription")), text_of(element.find("detaileddescription")))))


def slice_pages(root, work, source):
    folder = "api/slice/axon"
    names = sorted(path.name for path in (root / folder).glob("*.ice"))
    xml = doxygen(work / "slice", [f"{folder}/{name}" for name in names], root, FILE_PATTERNS="*.ice")
    found = {name: [] for name in names}  # (line, markdown)

    def home(element):
        place = element.find("location")
        return os.path.basename(place.get("file")), int(place.get("line"))

    for file in sorted(xml.glob("*.xml")):
        for compound in ElementTree.parse(file).getroot().iter("compounddef"):
            kind = compound.get("kind")
            if kind in ("file", "dir", "page"):
                continue
            name = re.split(r"::|\.", compound.findtext("compoundname"))[-1]
            where = home(compound) if compound.find("location") is not None else None
            if kind in ("namespace", "module"):
                for member in compound.iter("memberdef"):
                    file_name, line = home(member)
                    page = f"api/slice/{file_name.removesuffix('.ice')}.md"
                    title = member.findtext("name")
                    lines = [f"## {title}", "```", declaration(member), "```", told(description(member), page), ""]
                    lines += values_of(member, page)
                    found[file_name].append((line, "\n".join(lines)))
                continue
            if where is None or where[0] not in found:
                continue
            page = f"api/slice/{where[0].removesuffix('.ice')}.md"
            lines = [f"## {name}", f"*{kind}* {told(description(compound), page)}", ""]
            fields = [one for one in compound.iter("memberdef") if one.get("kind") in ("variable", "property")]
            if fields:
                lines += table(("field", "type", "meaning"), [(f"`{one.findtext('name')}`", f"`{text_of(one.find('type')).replace('`', '')}`",
                                                               told(description(one), page)) for one in fields])
            for one in (one for one in compound.iter("memberdef") if one.get("kind") == "function"):
                lines += [f"### {name}.{one.findtext('name')}", "```", declaration(one), "```", told(description(one), page), ""]
            found[where[0]].append((where[1], "\n".join(lines)))

    pages = []
    for name, parts in found.items():
        page = f"api/slice/{name.removesuffix('.ice')}.md"
        (source / page).parent.mkdir(parents=True, exist_ok=True)
        (source / page).write_text(f"# {name}\nThe contract `{folder}/{name}`.\n\n" + "\n".join(text for _, text in sorted(parts)), encoding="utf-8")
        pages.append((page, name, ""))
    return pages


def declaration(member):
    parts = [text_of(member.find("definition")).replace("`", ""), text_of(member.find("argsstring")).replace("`", ""),
             text_of(member.find("initializer")).replace("`", ""), text_of(member.find("exceptions")).replace("`", "")]
    if member.get("kind") == "enum":
        parts = [f"enum {member.findtext('name')}"]
    elif member.get("kind") == "function":
        arguments = ", ".join(f"{text_of(one.find('type'))} {one.findtext('declname') or ''}".replace("`", "").strip() for one in member.iter("param"))
        parts[:2] = [f"{text_of(member.find('type'))} {member.findtext('name')}({arguments})".replace("`", "")]
    return re.sub(r"\bAxon(::|\.)|\bCommUtil(::|\.)", "", " ".join(filter(None, parts)))


def values_of(member, page):
    return table(("value", "meaning"), [(f"`{one.findtext('name')}`", told(description(one), page)) for one in member.findall("enumvalue")])


# --- C++ ---

def declared_in(xml, headers):
    """For each header, in the order of its lines: (line, directive of Breathe, name, heading or None)."""
    found = {header: [] for header in headers}

    def note(element, directive, name, heading):
        place = element.find("location")
        if place is not None and place.get("file") in found:
            found[place.get("file")].append((int(place.get("line")), directive, name, heading))

    compounds = [one for file in sorted(xml.glob("*.xml")) for one in ElementTree.parse(file).getroot().iter("compounddef")]
    classes = {one.findtext("compoundname") for one in compounds if one.get("kind") in ("class", "struct")}
    for compound in compounds:
        name = compound.findtext("compoundname")
        if compound.get("kind") in ("class", "struct") and name.rpartition("::")[0] not in classes:  # others are shown inside theirs
            note(compound, "doxygen" + compound.get("kind"), name, name.removeprefix("axon::").removeprefix("client::").removeprefix("testing::"))
        elif compound.get("kind") == "namespace":
            for member in compound.iter("memberdef"):
                kind, whole = member.get("kind"), f"{name}::{member.findtext('name')}"
                if kind == "enum":
                    note(member, "doxygenenum", whole, member.findtext("name"))
                elif kind == "function":
                    types = [text_of(one.find("type")).replace("`", "") for one in member.findall("param")]
                    note(member, "doxygenfunction", f"{whole}({', '.join(types)})", None)
                elif kind == "typedef":
                    note(member, "doxygentypedef", whole, None)
                elif kind == "variable" and "#" not in (member.findtext("initializer") or ""):
                    note(member, "doxygenvariable", whole, None)
    return {header: sorted(items) for header, items in found.items()}


def with_links(xml, page):
    """Makes links of the pages that comments name."""
    def link(match):
        name, heading = match.group(1), match.group(2)
        anchor = "#" + github_slug(heading) if heading else ""
        return f'<ulink url="{os.path.relpath(name, os.path.dirname(page))}.html{anchor}">{match.group()}</ulink>'
    for file in xml.glob("*.xml"):
        text = file.read_text(encoding="utf-8")
        file.write_text(re.sub(r'(?<![\w/."])(docs/[\w/-]+)\.md(?:,\s+(?:"|&quot;)([^"&<]+)(?:"|&quot;))?', link, text), encoding="utf-8")


def cpp_pages(root, work, source):
    headers = [f"{folder}/{name}" for _, _, folder, names, _ in LIBRARIES for name in names]
    xml = doxygen(work / "cpp", headers, root, PREDEFINED='"AXON_EI_API=" "AXON_TESTING_API="', MACRO_EXPANSION="YES", ENABLE_PREPROCESSING="YES",
                  SEARCH_INCLUDES="YES", EXCLUDE_SYMBOLS="*::Shared *::Channel *::Desk")
    with_links(xml, "api/cpp/client.rst")  # all pages of the classes lie in this folder
    declared = declared_in(xml, headers)
    pages = []
    for file, title, folder, names, what in LIBRARIES:
        lines = [title, "=" * len(title), "", what, ""]
        for name in names:
            include = f"{folder[folder.index('/axon') + 1:]}/{name}"
            lines += [include, "-" * len(include), ""]
            for _, directive, whole, heading in declared[f"{folder}/{name}"]:
                if heading:
                    lines += [heading, "^" * len(heading), ""]
                lines += [f".. {directive}:: {whole}", "   :project: axon"] + (["   :members:", "   :undoc-members:"] if directive in ("doxygenclass", "doxygenstruct") else []) + [""]
        page = f"api/cpp/{file}.rst"
        (source / page).parent.mkdir(parents=True, exist_ok=True)
        (source / page).write_text("\n".join(lines), encoding="utf-8")
        pages.append((page, title, what))
    return pages


def write(root, work, source):
    groups = [("Classes", cpp_pages(root, work, source)), ("Operations between processes (Slice)", slice_pages(root, work, source)),
              ("Messages (protobuf)", Proto(root, work).write(source))]
    lines = ["# API", "What programs are written against.",
             "[Write a client in another language](../docs/how-to/foreign-client.md) explains how the two contracts are used; "
             "[compatibility](../docs/reference/compatibility.md) says what later releases keep.", ""]
    for title, pages in groups:
        lines += [f"## {title}", ""] + [f"* [{name}](../{page})" + (f": {escaped(what)}" if what else "") for page, name, what in pages] + [""]
    lines += ["```{toctree}", ":hidden:", ""] + ["/" + re.sub(r"\.(md|rst)$", "", page) for _, pages in groups for page, _, _ in pages] + ["```"]
    (source / "sections").mkdir(exist_ok=True)
    (source / "sections" / "api.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
