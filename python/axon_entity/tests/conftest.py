# SPDX-License-Identifier: MIT
import pathlib
import sys

import pytest

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[3] / "tools"))
from laboratory import robot_ports  # noqa: E402


@pytest.fixture
def ports():
    """A range of ports of this process's own."""
    return robot_ports()
