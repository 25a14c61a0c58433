# SPDX-License-Identifier: GPL-2.0-or-later
"""Makes a notebook of a page: make_notebook.py PAGE NOTEBOOK. Blocks of ```python are its cells of code."""
import json
import re
import sys


def cells(page):
    for index, part in enumerate(re.split(r"^```python\n(.*?)^```$", page, flags=re.MULTILINE | re.DOTALL)):
        text = part.strip("\n")
        if not text:
            continue
        lines = [line + "\n" for line in text.split("\n")[:-1]] + [text.split("\n")[-1]]
        if index % 2:
            yield {"cell_type": "code", "execution_count": None, "metadata": {}, "outputs": [], "source": lines}
        else:
            yield {"cell_type": "markdown", "metadata": {}, "source": lines}


def notebook(page):
    return {"cells": list(cells(page)), "nbformat": 4, "nbformat_minor": 4,
            "metadata": {"kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
                         "language_info": {"name": "python"}}}


if __name__ == "__main__":
    with open(sys.argv[1], encoding="utf-8") as source, open(sys.argv[2], "w", encoding="utf-8") as target:
        json.dump(notebook(source.read()), target, indent=1)
