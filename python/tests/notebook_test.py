# SPDX-License-Identifier: GPL-2.0-or-later
"""The lesson docs/tutorials/python.md as a notebook, executed with a simulated PeopleBot."""
import base64
import json
import os
import pathlib
import sys

import nbclient
import nbformat

import axon
from support import BIN, ROOT

sys.path.insert(0, str(ROOT / "python"))
import make_notebook  # noqa: E402
from laboratory import Laboratory  # noqa: E402


def test_the_lesson_runs_and_draws(monkeypatch, tmp_path):
    lab = Laboratory(BIN, application=f"lesson-{os.getpid()}")
    try:
        lab.start_server()
        robot = lab.start_robot()
        lab.start_application(robot.address)
        lab.start_manager()
        lab.wait_for_entity()
        lab.wait_until_able()
        where = "AXON_CONFIG" if lab.behind_routers else "AXON_SERVER"
        monkeypatch.setenv(where, lab.env[where])
        monkeypatch.setenv("PYTHONPATH", str(pathlib.Path(axon.__file__).parent.parent))
        monkeypatch.setenv("IPYTHONDIR", str(tmp_path))
        monkeypatch.setenv("JUPYTER_RUNTIME_DIR", str(tmp_path))
        page = (ROOT / "docs/tutorials/python.md").read_text(encoding="utf-8")
        notebook = nbformat.reads(json.dumps(make_notebook.notebook(page)), as_version=4)  # lines become texts
        nbformat.validate(notebook)
        nbclient.NotebookClient(notebook, timeout=120, kernel_name="python3").execute()
        outputs = [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]
        pictures = [output.data["image/png"] for output in outputs if "image/png" in output.get("data", {})]
        assert len(pictures) >= 2, "the scan and the path are drawn"
        assert all(base64.b64decode(picture).startswith(b"\x89PNG") for picture in pictures)
        tables = [output.data["text/html"] for output in outputs if "text/html" in output.get("data", {})]
        assert any("PeopleBot" in table for table in tables)
        text = "".join(output.get("text", "") for output in outputs)
        assert "WRONG_UNITS" in text and "LATCHED" in text and "confirmed: True" in text
    finally:
        lab.end()
