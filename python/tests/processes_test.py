# SPDX-License-Identifier: GPL-2.0-or-later
"""The Python client with Axon's programs as they are: its examples, TLS, routers, a server that ends.

In another environment (AXON_ENVIRONMENT) the tests that have servers of their own are skipped.
"""
import os
import pathlib
import subprocess
import sys
import time

import pytest

import axon
from axon import RefusalCode as Code
from support import BIN, ROOT, TEST_BIN

sys.path.insert(0, str(ROOT / "tests" / "tutorials"))
import console  # noqa: E402
from laboratory import Laboratory, addresses, wait_until  # noqa: E402

EXAMPLES = ROOT / "examples"
ROBOTS = ["robot in C++", "robot in Python"]
serial = iter(range(1000))


@pytest.fixture
def real():
    """real(environment) is a laboratory of real processes."""
    made = []

    def make(environment=None, **more):
        if environment and os.environ.get("AXON_ENVIRONMENT", environment) != environment:
            pytest.skip(f"its servers are always of the environment {environment}")
        first = 5600 + (os.getpid() * 7 + next(serial) * 13) % 1900
        lab = Laboratory(BIN, environment=environment, ports=f"{first}-{first + 9}", **more)
        made.append(lab)
        return lab
    yield make
    for lab in made:
        lab.end()


def connect(lab, **options):
    """A client of the laboratory's server, or of its router."""
    where = {"config": lab.env["AXON_CONFIG"]} if lab.behind_routers else {"server": lab.at["client"]}
    return axon.connect(**where, **options)


def start(lab, *options, **programs):
    """Entities of an example, each a program with the words that come before its file of ports, and their Entity Managers."""
    ports = lab.folder / "ports.cfg"
    ports.write_text(f"Axon.Ports = {lab.ports}\n")
    for application, words in programs.items():
        lab.start(f"application-{application}", *words, ports, *options, env=environment_of(lab))
        lab.start(f"manager-{application}", "axon-entity-manager", "--application", application, "--ports-file", ports,
                  *lab.manager_options([]))


def environment_of(lab):
    return dict(lab.env, PYTHONPATH=os.environ.get("PYTHONPATH", str(pathlib.Path(axon.__file__).parent.parent)))


def check(lab, program, *words):
    """Does it print what its README shows?"""
    done = subprocess.run([sys.executable, EXAMPLES / "python" / program, *map(str, words)], env=environment_of(lab), timeout=90,
                          stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
    printed = done.stdout.splitlines()
    for block in console.blocks((EXAMPLES / "python" / "README.md").read_text(encoding="utf-8")):
        for step in console.steps(block) if block.language == "console" else ():
            if step.typed and step.typed.split()[0] == f"./{program}":
                assert console.agrees(step.expected, printed), console.difference(step.expected, printed)
                assert done.returncode == 0
                return
    raise AssertionError(f"examples/python/README.md does not show {program}")


def test_the_example_greets(real):
    lab = real()
    lab.start_server()
    start(lab, Greeter=["hello-entity", EXAMPLES / "01_hello_entity"])
    check(lab, "greet.py")


def python_robot(name):
    return [sys.executable, "-u", EXAMPLES / "python" / name]


@pytest.mark.parametrize("plotter", [["plotter-entity", EXAMPLES / "03_parameters"], python_robot("03_parameters/plotter.py")], ids=ROBOTS)
def test_the_example_draws(real, plotter):
    lab = real()
    lab.start_server()
    start(lab, Plotter=plotter)
    check(lab, "draw.py", EXAMPLES / "03_parameters")


@pytest.mark.parametrize("cart", [["cart-entity", EXAMPLES / "04_stop"], python_robot("04_stop/cart.py")], ids=ROBOTS)
def test_the_example_stops(real, cart):
    lab = real()
    lab.start_server()
    start(lab, Cart=cart)
    check(lab, "stop.py")


@pytest.mark.parametrize("programs", [{name: [f"{name.lower()}-entity"] for name in ("Shuttle", "Arm", "Planner")},
                                      {name: python_robot(f"05_collaboration/{name.lower()}.py") for name in ("Shuttle", "Arm", "Planner")}], ids=ROBOTS)
def test_the_example_delivers(real, programs):
    example = EXAMPLES / "05_collaboration"
    lab = real()
    (lab.services_folder / "delivery.xml").write_bytes((example / "globalservices/delivery.xml").read_bytes())
    lab.start_server()
    start(lab, "--speed", "20", **{name: [*words, example] for name, words in programs.items()})
    check(lab, "deliver.py")
    with connect(lab) as client:
        history = client.run_history(most=1)
        assert history.runs[0].service.name == "Delivery" and history.runs[0].state == axon.RunState.SUCCEEDED
        assert {one.name for one in history.runs[0].participants} == {"Shuttle", "Arm", "Planner"}
        heavy = client.global_service("Heavy delivery")
        proposal = client.propose(heavy)
        with client.checkout_all([role.entity for role in proposal.roles]):
            run = client.run_global(heavy, proposal)
            wait_until(lambda: run.report.state == axon.RunState.HELD, "held")
            assert any(step.state == axon.TaskState.FAILED for step in run.report.steps)
            run.cancel()
            with pytest.raises(axon.Refused) as error:
                run.result(20)
            assert error.value.report.state == axon.RunState.CANCELLED
            assert any(began is not None for _, _, began, _ in run.timeline())
            with pytest.raises(axon.Refused) as error:
                client.check_global(heavy, {0: "Shuttle", 1: "Arm", 2: "Arm"})
            assert error.value.code == Code.DUPLICATE
        with pytest.raises(axon.Refused) as error:
            client.global_service("No such")
        assert "it offers: Delivery" in error.value.message


def tour(server=None, **options):
    """Check-out, task, stream, stop, rearm and release, of the entity Greeter."""
    with axon.connect(server, **options) as client:
        client.wait_for("Greeter", 15)
        with client.checkout("Greeter") as robot:
            assert robot.run("Greet", Name="Ada", Times=1).report.state == axon.TaskState.SUCCEEDED
            task = robot.start("Wait", Seconds=60)
            wait_until(lambda: task.report.state == axon.TaskState.RUNNING, "running")
            receipt = robot.stop()
            assert receipt.confirmed
            assert task.wait(5).state == axon.TaskState.STOPPED
            robot.rearm()
            return robot.direct


def test_over_tls_with_a_certificate_and_without(real):
    lab = real("embedded", application="Greeter")
    for what in (["init"], ["issue", "--server", "localhost"], ["issue", "--entity", "Greeter"], ["issue", "--client", "client1"]):
        status, lines, errors = lab.axon("certs", *what, "--folder", str(lab.folder / "certs"))
        assert status == 0, (lines, errors)

    def configuration(name, *more):
        file = lab.folder / f"{name}.cfg"
        file.write_text("\n".join([(lab.folder / "certs" / f"{name}.cfg").read_text(), *more, ""]))
        file.chmod(0o600)
        return file
    server = lab.start("server", "axon-server", "--config", configuration("server-localhost", *[
        f"{key}.Endpoints=ssl -h 127.0.0.1 -p 0" for key in ("FrontEndServer", "FrontEndServerSignal", "EntityServer", "EntityServerSignal")]))
    at = {name: address.replace("127.0.0.1", "localhost") for name, address in addresses(server.wait_for("ready ")).items()}
    ports = lab.folder / "ports.cfg"
    ports.write_text(f"Axon.Ports = {lab.ports}\n")
    lab.start("hello", "hello-entity", EXAMPLES / "01_hello_entity", ports)
    lab.start("em", "axon-entity-manager", "--config", configuration("entity-Greeter", "Axon.Application=Greeter", f"Axon.Ports={lab.ports}",
                                                                     f"Axon.Server={at['entity']}"))
    mine = configuration("client-client1", f"Axon.Server={at['client']}")
    tour(config=mine)
    with pytest.raises(axon.Refused) as error:
        axon.connect(at["client"].replace("ssl://", ""))
    assert error.value.code in (Code.UNAVAILABLE, Code.PERMISSION_DENIED), error.value


def test_through_the_routers_of_a_cluster(real):
    lab = real("cluster")
    lab.start_server()
    start(lab, Greeter=["hello-entity", EXAMPLES / "01_hello_entity"])
    assert not tour(config=lab.env["AXON_CONFIG"])


def test_directly_to_the_entity_manager_and_not(real):
    lab = real("embedded")
    lab.start_server()
    start(lab, Greeter=["hello-entity", EXAMPLES / "01_hello_entity"])
    assert tour(lab.at["client"])
    assert not tour(lab.at["client"], direct=False)


def test_a_lost_server_is_told_and_the_client_comes_back(real):
    lab = real()
    server = lab.start_server()
    start(lab, Greeter=["hello-entity", EXAMPLES / "01_hello_entity"])
    with connect(lab, resume=False) as client:
        client.wait_for("Greeter", 15)
        robot = client.checkout("Greeter")
        task = robot.start("Wait", Seconds=60)
        wait_until(lambda: task.report.state == axon.TaskState.RUNNING, "running")
        told = []
        client.on_connection(lambda connected, reason: told.append((connected, reason)))
        events = client.events(timeout=15)
        at = None if lab.behind_routers else dict(lab.at)
        server.kill()
        wait_until(lambda: (False, told[0][1]) in told if told else False, "told")
        assert not client.connected and told[0][1]
        assert any(event.kind == "lost" for event in events)
        with pytest.raises(axon.Refused) as error:
            task.result(5)
        assert error.value.code == Code.OUTCOME_UNKNOWN
        with pytest.raises(axon.Refused) as error:
            client.stop()
        assert error.value.code == Code.NOT_CONNECTED
        lab.start_server(at)
        wait_until(lambda: client.connected, "connected again", 20)
        wait_until(lambda: any(connected for connected, _ in told), "told of it")
        client.wait_for("Greeter", 20)
        wait_until(lambda: not client.find("Greeter").holder.id, "free")
        with client.checkout("Greeter") as again:
            if again.entity.latched:
                again.rearm()
            again.run("Greet", Name="again", Times=1)


def test_two_of_a_name_are_told_apart(real):
    lab = real()
    lab.start_server()
    first = int(lab.ports.split("-")[0])
    for number in (0, 1):
        folder = lab.folder / f"robot-{number}"
        folder.mkdir()
        for name in ("basic.xml", "services.xml"):
            (folder / name).write_bytes((EXAMPLES / "01_hello_entity" / name).read_bytes())
        ports = folder / "ports.cfg"
        ports.write_text(f"Axon.Ports = {first + 5 * number}-{first + 5 * number + 4}\n")
        its_own = dict(lab.env, XDG_STATE_HOME=str(folder / "state"))
        lab.start(f"application-{number}", "hello-entity", folder, ports, env=its_own)
        lab.start(f"manager-{number}", "axon-entity-manager", "--application", "Greeter", "--ports-file", ports, *lab.manager_options([]),
                  env=its_own)
    with connect(lab) as client:
        wait_until(lambda: len(client.entities()) == 2, "both are there")
        with pytest.raises(axon.Refused) as error:
            client.find("Greeter")
        assert error.value.code == Code.AMBIGUOUS_ENTITY
        assert client.find("Greeter#2").name == "Greeter"
        with client.checkout_all(["Greeter#1", client.find("Greeter#2")]) as both:
            assert len(both) == 2


def test_an_upload_that_was_given_up_goes_on_under_the_same_check_out_and_under_the_next(real):
    lab = real()
    lab.start_server()
    start(lab, Plotter=["plotter-entity", EXAMPLES / "03_parameters"])
    file = lab.folder / "drawing.txt"
    file.write_text("0.5 0.5\n" * 200_000)
    size = file.stat().st_size
    sent_of = []

    class Enough(Exception):
        pass

    def give_up_behind(end):
        sent_of.clear()

        def told(sent, _):
            sent_of.append(sent)
            if sent > end:
                raise Enough
        return told
    with connect(lab) as client:
        client.wait_for("Plotter", 15)
        with client.checkout("Plotter") as robot:
            with pytest.raises(Enough):
                robot.upload("Draw", "Drawing", file, give_up_behind(size / 3))
            before = sent_of[-1]
            assert before < size
            with pytest.raises(Enough):
                robot.upload("Draw", "Drawing", file, give_up_behind(size / 2))
            assert sent_of[0] >= before
            last = sent_of[-1]
        with client.checkout("Plotter") as robot:
            sent_of.clear()
            robot.upload("Draw", "Drawing", file, lambda sent, _: sent_of.append(sent))
            assert sent_of[0] >= last, "where the one before ended"


def test_the_command_starts_the_shell(real):
    lab = real()
    lab.start_server()
    done = subprocess.run([BIN / "axon", "shell"], env=dict(lab.env, IPYTHONDIR=str(lab.folder)), input="print('entities:', len(entities()))\n",
                          capture_output=True, text=True, timeout=60)
    assert done.returncode == 0 and lab.env.get("AXON_SERVER", "") in done.stdout, done.stdout + done.stderr
    assert "entities: 0" in done.stdout, done.stdout + done.stderr


def test_pictures_arrive_at_thirty_hertz(real):
    """640 × 480 × 3 bytes: nothing is dropped in two seconds, and each is an array that looks into the sample."""
    lab = real()
    lab.start_server()
    ports = lab.folder / "ports.cfg"
    ports.write_text(f"Axon.Ports = {lab.ports}\n")
    lab.start("camera", TEST_BIN / "camera-entity", EXAMPLES.parent / "python/tests/camera", ports)
    lab.start("em", "axon-entity-manager", "--application", "Camera", "--ports-file", ports, *lab.manager_options([]))
    with connect(lab) as client:
        client.wait_for("Camera", 15)
        with client.stream("Camera", "eye").watch() as eye:
            first = eye.take(1)[0]
            begin = time.monotonic()
            samples = eye.take(60)
            took = time.monotonic() - begin
        pictures = [sample.data for sample in samples]
        assert all(picture.shape == (480, 640, 3) and not picture.flags.owndata for picture in pictures)
        assert [sample.sequence for sample in samples] == list(range(first.sequence + 1, first.sequence + 61))
        assert all(picture[0, 0, 0] == sample.sequence % 256 for picture, sample in zip(pictures, samples))
        assert 1.8 < took < 4, f"{took:g} s for 60 pictures"
