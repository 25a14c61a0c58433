# SPDX-License-Identifier: GPL-2.0-or-later
"""Looks through the pages of a site: links and anchors that lead nowhere, and anything that a page would load from elsewhere."""
import re
from html.parser import HTMLParser
from urllib.parse import unquote, urlsplit

# Attributes by which a browser loads something without being asked, by element.
LOADED = {("script", "src"), ("img", "src"), ("img", "srcset"), ("source", "src"), ("source", "srcset"), ("iframe", "src"), ("audio", "src"),
          ("video", "src"), ("embed", "src"), ("object", "data"), ("image", "href"), ("use", "href"), ("form", "action")}
# What an element link with one of these relations names is not loaded.
NAMED_ONLY = {"canonical", "license", "author", "prev", "next"}
STYLE = re.compile(r"url\(\s*['\"]?([^'\")]+)|@import\s+(?:url\()?['\"]?([^'\");\s]+)")


class Page(HTMLParser):
    def __init__(self, text):
        super().__init__()
        self.links, self.loads, self.anchors, self.in_style = [], [], set(), False
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        values = {name: value or "" for name, value in attrs}
        self.in_style = tag == "style"
        for name in ("id", "name"):
            if name in values and (name == "id" or tag == "a"):
                self.anchors.add(values[name])
        if tag in ("a", "area") and "href" in values:
            self.links.append(values["href"])
        if tag == "link" and "href" in values:
            relation = set(values.get("rel", "").split())
            (self.links if relation & NAMED_ONLY else self.loads).append(values["href"])
        self.loads += [values[name] for element, name in LOADED if element == tag and name in values]
        self.loads += styles(values.get("style", ""))

    handle_startendtag = handle_starttag

    def handle_endtag(self, tag):
        self.in_style = False

    def handle_data(self, data):
        if self.in_style:
            self.loads += styles(data)


def styles(text):
    return [a or b for a, b in STYLE.findall(text)]


def foreign(url):
    parts = urlsplit(url)
    return bool(parts.netloc) or parts.scheme not in ("", "data")


def findings(site):
    site = site.resolve()
    pages = {path: Page(path.read_text(encoding="utf-8")) for path in sorted(site.rglob("*.html"))}
    if not pages:
        yield f"{site}: there is no page; fix: run tools/make_docs"
    for path, page in pages.items():
        shown = path.relative_to(site)
        for url in page.loads:
            if foreign(url):
                yield f"{shown}: loads {url} over the network; fix: put it into the site"
        for url in page.links + [one for one in page.loads if not foreign(one)]:
            parts = urlsplit(url)
            if parts.scheme or parts.netloc:
                continue
            there = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            if not there.is_file():
                yield f"{shown}: {url} leads to no file of the site; fix: correct the link in the page's source"
            elif parts.fragment and there.suffix == ".html" and unquote(parts.fragment) not in pages[there].anchors:
                yield f"{shown}: {url} names no heading of that page; fix: correct the link in the page's source"
    for path in sorted(site.rglob("*.css")):
        for url in styles(path.read_text(encoding="utf-8")):
            if foreign(url):
                yield f"{path.relative_to(site)}: loads {url} over the network; fix: put it into the site"
