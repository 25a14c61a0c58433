# SPDX-License-Identifier: GPL-2.0-or-later
"""The laboratory of the cluster: its valve, and what it leaves to the next test."""
import socket
import types

import pytest

from cluster import ClusterLaboratory, Valve


@pytest.fixture
def target():
    """A socket of loopback that does not listen yet."""
    with socket.socket() as made:
        made.bind(("127.0.0.1", 0))
        yield made


@pytest.fixture
def valve(target):
    made = Valve(target.getsockname()[1])
    yield made
    made.end()


def connected(valve):
    return socket.create_connection(("127.0.0.1", valve.port), timeout=10)


def test_a_refused_connection_does_not_end_the_relay(target, valve):
    with connected(valve) as refused:
        assert refused.recv(1) == b""
    target.listen()
    with connected(valve) as near, target.accept()[0] as far:
        near.sendall(b"x")
        assert far.recv(1) == b"x"


def test_a_cut_resets_what_is_connected_and_refuses_what_comes(target, valve):
    target.listen()
    with connected(valve) as near, target.accept()[0]:
        valve.cut()
        with pytest.raises(ConnectionResetError):
            near.recv(1)
    with connected(valve) as refused:
        assert refused.recv(1) == b""
    valve.open()
    with connected(valve), target.accept()[0]:
        pass


def test_an_end_waits_for_nothing(target):
    rounds = 200
    target.listen(rounds)  # nobody accepts, and to a full queue no relay connects
    for _ in range(rounds):
        valve = Valve(target.getsockname()[1])
        connected(valve).close()
        valve.end()
        assert valve._passed.is_set(), "its order was heeded"


@pytest.mark.parametrize("restarts", [True, False])
def test_the_next_test_has_a_server_though_this_one_killed_it(tmp_path, restarts):
    done = []
    seen = types.SimpleNamespace(connected=True, entities=lambda all: [])
    cluster = types.SimpleNamespace(seen=seen, lab=types.SimpleNamespace(server=types.SimpleNamespace(do=lambda *words: done.append(words))))
    laboratory = ClusterLaboratory(cluster, tmp_path)
    laboratory.kill_server()
    if restarts:
        laboratory.restart_server()
    laboratory.end()
    assert done == [("kill", "fe1"), ("restart", "fe1")]
