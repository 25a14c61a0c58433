# SPDX-License-Identifier: GPL-2.0-or-later
"""Anchors of headings; a module of its own, because Sphinx stores its configuration and finds functions by their module."""
import re


def github_slug(title):
    """The anchor of a heading, as repository browsers and tools/check_docs.py make it."""
    return re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-")
