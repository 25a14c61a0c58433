# SPDX-License-Identifier: GPL-2.0-or-later
"""python3 pack_python.py PROGRAM MODULE...: Python modules as one executable file, equal whenever it is made."""
import pathlib
import sys
import zipfile

program, modules = pathlib.Path(sys.argv[1]), sys.argv[2:]
with program.open("wb") as file:
    file.write(b"#!/usr/bin/env python3\n")
    with zipfile.ZipFile(file, "w") as archive:
        for module in sorted(map(pathlib.Path, modules), key=lambda module: module.name):
            archive.writestr(zipfile.ZipInfo(module.name, (1980, 1, 1, 0, 0, 0)), module.read_bytes())
program.chmod(0o755)
