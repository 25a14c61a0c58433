# SPDX-License-Identifier: GPL-2.0-or-later
"""The interactive prompt: what it completes, and that it runs."""
import os
import subprocess
import sys

import pytest

from axon import shell


@pytest.fixture
def names(laboratory, client, take):
    laboratory.add("PeopleBot")
    laboratory.add("Cyton", category="ROBOT", kind="STATIONARY")
    lab = client()
    lab.wait_for("Cyton", 5)
    return {"lab": lab, "robot": take(lab)}


@pytest.mark.parametrize("line, words", [
    ('robot = checkout("', ["Cyton", "PeopleBot"]),
    ('lab.stop("Cyton", "Pe', ["PeopleBot"]),
    ('robot.run("', ["Drive", "Say"]),
    ("robot.run('Dr", ["Drive"]),
    ('robot.run("Drive", ', ["Distance=", "Speed="]),
    ('robot.run("Drive", Distance=5, S', ["Speed="]),
    ('robot.run("Drive", Distance=axon.Quantity(5, "', ["mm"]),
    ('robot.run("Say", Voice="h', ["high"]),
    ('robot.upload("Drive", "', ["Map"]),
    ('x = robot.start("drive", Di', ["Distance="]),
    ('robot.run("Nothing", ', []),
    ('robot.run("Drive", Distance=', []),
    ("1 + 1", []),
    ('other.run("', []),
    ("robot.run(((((", []),
])
def test_completes_entities_services_parameters_choices_and_units(names, line, words):
    assert shell.completions(line, names)[1] == words


def test_completes_the_rest_of_a_name_with_a_space():
    typed, words = shell.begins(["Fetch ball", "Fetch box"], "Fetch b")
    assert ["b" + word[len(typed):] for word in words] == ["ball", "box"]


def test_runs_what_is_typed_and_completes_it(laboratory):
    laboratory.add()
    text = ("robot = checkout('PeopleBot')\n"
            "print('completes', get_ipython().complete('Dr', \"robot.run('Dr\", 13)[1])\n"
            "print('holds', robot.name, robot.run('Drive', Distance=1))\n"
            "print(stop('Nobody'))\n")
    done = subprocess.run([sys.executable, "-m", "axon.shell", laboratory.server], input=text, capture_output=True, text=True, timeout=60,
                          env=dict(os.environ, IPYTHONDIR=str(laboratory.folder)))
    assert "There: PeopleBot" in done.stdout, done.stderr
    assert "completes ['Drive']" in done.stdout
    assert "holds PeopleBot TaskResult()" in done.stdout
    assert "UNKNOWN_ENTITY" in done.stdout + done.stderr
    assert done.returncode == 0, done.stderr


def test_says_what_is_missing(laboratory, tmp_path):
    done = subprocess.run([sys.executable, "-m", "axon.shell", "127.0.0.1:1"], capture_output=True, text=True)
    assert done.returncode == 3 and "start axon-server" in done.stderr
    (tmp_path / "IPython.py").write_text("raise ImportError('hidden by a test')")
    done = subprocess.run([sys.executable, "-m", "axon.shell", laboratory.server], capture_output=True, text=True,
                          env=dict(os.environ, PYTHONPATH=f"{tmp_path}:{os.environ.get('PYTHONPATH', '')}"))
    assert done.returncode == 2 and "fix: apt install ipython3" in done.stderr
