#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""The example of each settings file has every key that its reference page lists, and no other."""
import pathlib
import re
import unittest

ROOT = pathlib.Path(__file__).resolve().parent.parent.parent
KEY = r"[A-Z]\w*(?:\.\w+)+"
PLACES = {"Server.Peer.fe2": "Server.Peer.NAME"}  # of the example, and as the page has it


def keys_of_page(name, begin, end):
    page = (ROOT / "docs" / "reference" / name).read_text()
    tables = [line for line in page[page.index(begin):page.index(end)].splitlines() if line.startswith("|")]
    cells = [cell for line in tables for cell in line.split("|")[1:3]]  # options of a command line come before their keys
    return set(re.findall(rf"`({KEY})`", " ".join(cells)))


def keys_of_example(name):
    lines = (ROOT / "deploy" / "config" / name).read_text().splitlines()
    found = [match.group(1) for line in lines if (match := re.match(rf"#?({KEY})=", line))]
    return [PLACES.get(key, key) for key in found]


class Settings(unittest.TestCase):
    def check(self, example, page, begin, end):
        found = keys_of_example(example)
        expected = keys_of_page(page, begin, end)
        self.assertGreater(len(expected), 15, f"the tables of {page} were not found")
        self.assertEqual(set(found), expected)

    def test_of_the_server(self):
        self.check("server.cfg", "server_configuration.md", "## Keys", "## Options")

    def test_of_the_entity_manager(self):
        self.check("entitymanager.cfg", "configuration.md", "## The application", "## What it prints")


if __name__ == "__main__":
    unittest.main()
