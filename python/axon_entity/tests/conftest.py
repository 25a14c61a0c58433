# SPDX-License-Identifier: MIT
import os

import pytest


@pytest.fixture
def ports():
    """A range of ports of this process's own, among the 2500 for robot applications."""
    first = 5500 + os.getpid() % 25 * 100
    return first, first + 99
