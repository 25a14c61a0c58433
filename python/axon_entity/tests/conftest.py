# SPDX-License-Identifier: MIT
import os

import pytest


@pytest.fixture
def ports():
    """A range of ports of this process's own."""
    first = 5500 + os.getpid() % 24 * 100
    return (first, first + 99)
