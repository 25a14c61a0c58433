# SPDX-License-Identifier: GPL-2.0-or-later
"""The claims of the C++ client's component test (src/client/session_component_test.cpp), made again of the Python client.

Each test here has the name of one there. every_claim_is_made_of_python_too() compares the two lists, so a claim that is added
there is missed here. They are made over a server in the process of the test's laboratory, and again over a cluster with TLS
(AXON_ENVIRONMENT=cluster) and on several machines (AXON_ENVIRONMENT=machines, cluster.py).
"""
import re
import threading
import time

import pytest

import axon
from axon import RefusalCode as Code
from axon import TaskState
from support import ROOT, wait_until

# Claims of the C++ test that are not made here, and why.
ELSEWHERE = {
    "WhatWasAcceptedArrivesOnceWholeAndInOrderHoweverItIsWritten": "of the way that messages are written, which is below both interfaces",
    "KeepsItsSessionWithWatchdogsOfTheServerThatItHasReconnectedTo": "of heartbeats, which are below both interfaces",
}
# What is contrary in Python.
CONTRARY = {"WaitingInACallbackIsAMisuseThatIsNamed": "waiting_in_a_callback_is_allowed"}


def test_every_claim_is_made_of_python_too():
    text = (ROOT / "src/client/session_component_test.cpp").read_text()
    claims = re.findall(r"^TEST_F\(\w+, (\w+)\)", text, re.MULTILINE)
    assert len(claims) >= 31
    missing = []
    for claim in claims:
        snake = re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "_", claim).lower()
        name = CONTRARY.get(claim, snake)
        if claim not in ELSEWHERE and f"test_{name}" not in globals():
            missing.append(name)
    assert not missing


def test_nobody_there_is_an_answer_with_the_mend(refused):
    with refused(Code.UNAVAILABLE) as told:
        axon.connect("127.0.0.1:1")
    assert "axon-server" in told.error.message
    assert told.error.fix.startswith("start axon-server")
    with refused(Code.MALFORMED):
        axon.connect("not an address")


def test_knows_who_is_there_as_soon_as_it_is_connected(laboratory, client, refused):
    """Two of one name, which this laboratory does not have, are in processes_test.py."""
    laboratory.add("First")
    laboratory.add("Second")
    lab = client()
    assert sorted(entity.name for entity in lab.entities()) == ["First", "Second"]
    first = lab.entities()["First"]
    assert lab.find(first.id).name == lab.find(first.id[:8]).name == "First"
    assert lab.me.name == "client1@lab"
    with refused(Code.UNKNOWN_ENTITY) as told:
        lab.find("Firts")
    assert "First" in told.error.message


def test_runs_a_task_from_check_out_to_release(laboratory, client, take, refused):
    entity = laboratory.add()
    entity.on("Drive", ["progress", 0.5], ["feedback", "half way"], ["result", "Moved", [1000.0]], ["succeed"])
    lab = client()
    robot = take(lab)
    assert [service.name for service in robot.services] == ["Drive", "Say"]
    told = []
    task = robot.start("Drive", Distance=1000)
    task.on_update(told.append)
    result = task.result(5)
    assert result["Moved"] == axon.Quantity(1000.0, "mm")
    assert float(result.Moved) == 1000.0
    assert task.report.state == TaskState.SUCCEEDED
    wait_until(lambda: told and told[-1].state == TaskState.SUCCEEDED)
    assert robot.run("Drive", Distance=axon.Quantity(10, "mm")).Moved.units == "mm"
    assert entity.do("expect_task")["parameters"]["Distance"] == [1000]
    assert entity.do("expect_task")["parameters"]["Distance"] == [10]
    robot.release()
    with refused(Code.NOT_HOLDER):
        robot.send_text("too late")
    wait_until(lambda: lab.find("PeopleBot").state == axon.EntityState.IDLE)


def test_the_applications_reason_reaches_the_client(laboratory, client, take, refused):
    entity = laboratory.add()
    robot = take(client())
    robot.set("Drive", Speed=250.0)
    entity.do("deny", service="Drive", parameter="Speed", reason="too fast")
    with refused(Code.DENIED) as told:
        robot.set("Drive", Speed=900)
    assert "too fast" in told.error.message


def test_a_held_entity_is_refused_with_its_holders_name_and_several_all_or_none(laboratory, client, take, refused):
    laboratory.add("First")
    laboratory.add("Second")
    client1, client2 = client(), client(name="client2@lab")
    held = take(client1, "Second")
    client2.wait_for("First", 5)
    with refused(Code.ALREADY_HELD) as told:
        client2.checkout_all(["First", "Second"])
    assert told.error.holder == "client1@lab"
    assert "client1@lab" in told.error.fix
    assert client2.held() == []
    held.release()
    wait_until(lambda: client2.find("First").state == axon.EntityState.IDLE and client2.find("Second").state == axon.EntityState.IDLE)
    with client2.checkout_all(["First", "Second"]) as both:
        assert [robot.name for robot in both] == ["First", "Second"]
        assert len(client2.held()) == 2
    assert client2.held() == []


def test_who_is_refused_and_ends_at_once_leaves_nothing_reserved(laboratory, client, take, refused):
    laboratory.add("First")
    laboratory.add("Second")
    holder = client()
    take(holder, "Second")
    for _ in range(10):
        with client(name="client2@lab") as other:
            other.wait_for("First", 5)
            with refused(Code.ALREADY_HELD):
                other.checkout_all(["First", "Second"])
        holder.checkout("First").release()


def test_a_stop_is_confirmed_latches_and_is_rearmed(laboratory, client, take, drive, refused):
    entity = laboratory.add()
    robot = take(client())
    task = drive(robot, entity)
    receipt = robot.stop()
    assert receipt.confirmed
    # Behind routers the server's answer takes another way than the Entity Manager's, which ends the waiting.
    assert receipt.server is not None or laboratory.behind_routers
    assert entity.do("expect_stop")["cause"] == "REQUESTED"
    assert task.wait(5).state == TaskState.STOPPED
    with refused(Code.STOPPED) as told:
        task.result()
    assert told.error.report.state == TaskState.STOPPED
    with refused(Code.LATCHED):
        robot.run("Drive", Distance=1)
    robot.rearm()
    drive(robot)


def test_standstill_is_told_to_whoever_stopped_it_and_of_a_robot_that_stood_nobody_waits(laboratory, client, take, drive):
    entity = laboratory.add(standstill=0.1)
    lab, other = client(), client(name="client2@lab")
    robot = take(lab)
    other.wait_for("PeopleBot", 5)
    for who in (lab, other):
        drive(robot, entity)
        receipts = who.stop("PeopleBot", deadline=1, standstill=5)
        assert len(receipts) == 1 and receipts.confirmed
        assert receipts[0].standstill is not None
        assert receipts[0].at_rest

        def rearmed():
            try:
                lab.rearm("PeopleBot")
                return True
            except axon.Refused:
                return False
        wait_until(rearmed)
    begin = time.monotonic()
    assert not lab.stop("PeopleBot", standstill=60)[0].standstill_follows
    assert time.monotonic() - begin < 10


def test_a_reset_and_a_clear_say_what_they_have_done(laboratory, client, take, drive, refused):
    entity = laboratory.add()
    robot = take(client())
    assert robot.reset().tasks_ended == 0
    first = drive(robot, entity)
    receipt = robot.reset()
    assert receipt.confirmed and receipt.tasks_ended == 1
    assert first.wait(5).state == TaskState.STOPPED
    drive(robot)
    waiting = robot.start("Drive", Distance=1)
    wait_until(lambda: waiting.report.accepted)
    receipt = robot.clear()
    assert (receipt.tasks_ended, receipt.tasks_removed) == (1, 1)
    robot.release()
    with refused(Code.NOT_HOLDER):
        robot.reset()


def test_anybody_stops_everything_and_a_late_stage_is_shown_as_missing(laboratory, client):
    laboratory.add("First")
    second = laboratory.add("Second")
    second.do("confirm", confirm=False)
    lab = client()
    receipts = lab.stop(deadline=0.4)
    assert sorted((receipt.name, receipt.confirmed) for receipt in receipts) == [("First", True), ("Second", False)]
    assert not receipts.confirmed
    assert "NO" in receipts._repr_html_()
    second.do("confirm", confirm=True)


def test_pauses_resumes_and_cancels(laboratory, client, take, drive, refused):
    entity = laboratory.add()
    task = drive(take(client()), entity)
    task.pause()
    assert task.report.state == TaskState.PAUSED
    task.resume()
    task.cancel()
    assert task.wait(5).state == TaskState.CANCELLED
    with refused(Code.WRONG_STATE):
        task.pause()


def test_uploads_a_file_in_its_window(laboratory, client, take, refused, tmp_path):
    entity = laboratory.add()
    robot = take(client())
    file = tmp_path / "lab.map"
    file.write_text("m" * 1_500_000)
    told = []
    robot.upload("Drive", "Map", file, lambda sent, total: told.append((sent, total)))
    assert told == sorted(told) and told[-1] == (1_500_000, 1_500_000)
    assert entity.do("uploaded", service="Drive", resource="Map")["text"] == "m" * 1_500_000
    with refused(Code.UNKNOWN_RESOURCE):
        robot.upload("Drive", "Mapp", file)
    with refused(Code.UNKNOWN_RESOURCE):
        robot.upload("Drive", "Map", tmp_path / "none")


def test_an_upload_that_was_given_up_goes_on_under_the_same_check_out_and_under_the_next(laboratory, client, take, tmp_path):
    laboratory.must_have_processes("its Entity Managers keep no part of a file; python_processes_test makes the claim of others")
    laboratory.add()
    lab = client()
    file = tmp_path / "lab.map"
    file.write_text("m" * 1_500_000)
    sent_of = []

    def give_up_behind(end):
        sent_of.clear()

        def told(sent, _):
            sent_of.append(sent)
            if sent > end:
                raise InterruptedError
        return told
    with take(lab) as robot:
        with pytest.raises(InterruptedError):
            robot.upload("Drive", "Map", file, give_up_behind(500_000))
        before = sent_of[-1]
        assert before < 1_500_000
        with pytest.raises(InterruptedError):
            robot.upload("Drive", "Map", file, give_up_behind(750_000))
        assert sent_of[0] >= before
        last = sent_of[-1]
    with lab.checkout("PeopleBot") as robot:
        sent_of.clear()
        robot.upload("Drive", "Map", file, lambda sent, _: sent_of.append(sent))
        assert sent_of[0] >= last, "where the one before ended"


def test_texts_and_streams_arrive_in_order(laboratory, client, take):
    entity = laboratory.add()
    robot = take(client())
    robot.send_text("hello")
    assert entity.do("expect_text")["text"] == "hello"
    robot.send_raw(b"\x00raw")
    assert entity.do("expect_raw")["text"] == "\x00raw"
    texts, raws = [], []
    robot.on_text(texts.append)
    robot.on_raw(raws.append)
    for number in range(50):
        entity.do("text", text=str(number))
    entity.do("raw", text="bytes")
    wait_until(lambda: len(texts) == 50)
    assert texts == [str(number) for number in range(50)]
    wait_until(lambda: raws == [b"bytes"])
    with robot.battery.watch() as watch:
        wait_until(lambda: entity.sample("battery", 12.5) or len(watch._feed), "a sample")
        for number in range(10):
            entity.sample("battery", float(number))
        numbers = [float(sample) for sample in watch.take(3)]
    assert numbers[0] == 12.5


def test_a_destroyed_client_leaves_a_stopped_and_free_robot(laboratory, client, take, drive, refused):
    entity = laboratory.add()
    with client() as lab, take(lab) as robot:
        task = drive(robot, entity)
    assert task.report.final
    entity.do("expect_stop")
    other = client(name="client2@lab")
    wait_until(lambda: other.find("PeopleBot").state == axon.EntityState.IDLE)
    for call in (task.pause, lambda: robot.send_text("x"), lambda: lab.checkout("PeopleBot")):
        with pytest.raises(axon.Refused):
            call()


def test_an_entity_that_leaves_is_lost_with_a_reason(laboratory, client, take, drive):
    entity = laboratory.add()
    robot = take(client())
    task = drive(robot, entity)
    lost = []
    robot.on_lost(lost.append)
    entity.do("leave")
    wait_until(lambda: lost)
    assert lost[0].message
    # UNKNOWN, unless the end of the task was told before the entity left.
    assert task.wait(5).state in (TaskState.UNKNOWN, TaskState.STOPPED)


def test_an_operator_who_is_not_there_stops_the_robot(laboratory, client, take, drive):
    entity = laboratory.add()
    lab = client(reconnect=False)
    drive(take(lab), entity)
    assert lab.present
    lab.present = False
    assert entity.do("expect_stop")["cause"] == "CLIENT_LOST"


def test_waiting_in_a_callback_is_allowed(laboratory, client, take, drive):
    entity = laboratory.add()
    robot = take(client())
    task = drive(robot, entity)
    done = threading.Event()

    def told(_):
        robot.set("Drive", Speed=250.0)
        done.set()
    task.on_update(told)
    assert done.wait(5)


def test_many_threads_may_use_one_client(laboratory, client, take):
    entity = laboratory.add()
    lab = client()
    robot = take(lab)
    failed = []

    def repeat(call):
        def work():
            try:
                for number in range(50):
                    call(number)
            except Exception as error:  # pylint: disable=broad-except
                failed.append(error)
        return threading.Thread(target=work)
    threads = [repeat(lambda number: robot.set("Drive", Speed=100.0 + number)), repeat(lambda _: lab.services("PeopleBot")),
               repeat(lambda _: robot.send_text("x")), repeat(lambda _: lab.find("PeopleBot"))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not failed
    for _ in range(50):
        entity.do("expect_text")


def test_a_lost_connection_is_resumed_under_the_same_lease(laboratory, client, take, drive, refused):
    entity = laboratory.add()
    lab = client(**laboratory.behind_valve())
    robot = take(lab)
    ticket = robot.ticket()
    task = drive(robot, entity)
    resumed, lost, orphaned = [], [], []
    robot.on_resumed(lambda: resumed.append(True))
    robot.on_lost(lost.append)
    robot.on_orphaned(orphaned.append)
    laboratory.cut()
    wait_until(lambda: robot.orphaned)
    with refused(Code.NOT_CONNECTED):
        robot.send_text("x")
    assert entity.do("expect_stop")["cause"] == "CLIENT_LOST"
    laboratory.open()
    wait_until(lambda: resumed)
    assert not lost and orphaned
    assert robot.ticket() == ticket
    assert task.wait(5).state == TaskState.STOPPED, "told as it ended"
    with refused(Code.LATCHED):  # coming back starts nothing
        robot.run("Drive", Distance=1)
    robot.rearm()
    drive(robot)


def test_a_lost_server_is_told_and_the_client_comes_back(laboratory, client, take, drive, refused):
    laboratory.must_have_processes("its server cannot be killed; python_processes_test makes the claim of another")
    entity = laboratory.add()
    lab = client(resume=False)
    robot = take(lab)
    task = drive(robot, entity)
    told = []
    lab.on_connection(lambda connected, reason: told.append(connected))
    laboratory.kill_server()
    wait_until(lambda: told == [False])
    assert not lab.connected
    with refused(Code.OUTCOME_UNKNOWN):
        task.result(5)
    with refused(Code.NOT_CONNECTED):
        lab.stop()
    laboratory.restart_server()
    wait_until(lambda: told == [False, True], "connected again", 20)
    wait_until(lambda: lab.connected and not lab.find("PeopleBot").holder.id, "free", 20)
    robot = take(lab)
    robot.rearm()
    drive(robot)


def test_without_resuming_the_lease_is_lost_with_the_connection(laboratory, client, take):
    laboratory.add()
    lab = client(**laboratory.behind_valve(), resume=False)
    robot = take(lab)
    lost = []
    robot.on_lost(lost.append)
    laboratory.cut()
    wait_until(lambda: lost)
    assert lost[0].code == Code.NOT_CONNECTED


def test_a_ticket_takes_the_lease_to_another_client_and_stops_the_robot_first(laboratory, client, take, drive):
    entity = laboratory.add()
    client1, client2 = client(), client(name="client1@lab, restarted")
    robot = take(client1)
    drive(robot, entity)
    lost = []
    robot.on_lost(lost.append)
    ticket = robot.ticket()
    resumed = client2.resume(ticket)
    assert resumed.ticket() == ticket
    entity.do("expect_stop")
    wait_until(lambda: lost)
    assert robot.ticket() == ""
    resumed.send_text("here I am")
    with pytest.raises(axon.Refused):
        client2.resume("no ticket")


def test_who_waits_is_told_its_place_and_is_next(laboratory, client, take):
    laboratory.add()
    client1, client2 = client(), client(name="client2@lab")
    held = take(client1)
    client2.wait_for("PeopleBot", 5)
    places, granted = [], []
    thread = threading.Thread(target=lambda: granted.append(
        client2.checkout("PeopleBot", wait=20, on_waiting=lambda waiting: places.append(waiting.place))))
    thread.start()
    wait_until(lambda: 1 in places)
    wait_until(lambda: client1.find("PeopleBot").waiting == 1)
    held.release()
    thread.join(10)
    granted[0].send_text("mine")


def test_a_wait_that_is_given_up_leaves_the_line(laboratory, client, take, refused):
    laboratory.add()
    client1, client2 = client(), client(name="client2@lab")
    take(client1)
    client2.wait_for("PeopleBot", 5)
    with refused(Code.TIMED_OUT):
        client2.checkout("PeopleBot", wait=0.3)
    wait_until(lambda: client1.find("PeopleBot").waiting == 0)


def test_the_holder_is_asked_and_its_answer_counts(laboratory, client, take, drive, refused):
    entity = laboratory.add()
    client1, client2 = client(), client(name="client2@lab")
    robot = take(client1)
    drive(robot, entity)
    asked, lost, accept = [], [], [False]

    def answer(request):
        if not request.withdrawn:
            asked.append((request.by, request.reason))
            robot.answer_hand_over(accept[0], "because")
    robot.on_hand_over_request(answer)
    robot.on_lost(lost.append)
    client2.wait_for("PeopleBot", 5)
    with refused(Code.HAND_OVER_REFUSED):
        client2.checkout("PeopleBot", ask=True, reason="a demonstration")
    assert asked == [("client2@lab", "a demonstration")]
    accept[0] = True
    assert client2.checkout("PeopleBot", ask=True, reason="a demonstration").name == "PeopleBot"
    entity.do("expect_stop")
    wait_until(lambda: lost)
    assert lost[0].code == Code.REVOKED_LEASE
    client2.held()[0].set_hand_over_policy(axon.HandOverPolicy(refuse=True))
    with refused(Code.HAND_OVER_REFUSED):
        client1.checkout("PeopleBot", ask=True, reason="nobody is asked")


def test_an_admin_takes_over_and_the_loser_is_told(laboratory, client, take, drive):
    entity = laboratory.add()
    client1, admin = client(), client(name="client2@lab")
    assert admin.me.role == axon.Role.ADMIN
    robot = take(client1)
    task = drive(robot, entity)
    lost = []
    robot.on_lost(lost.append)
    admin.wait_for("PeopleBot", 5)
    admin.checkout("PeopleBot", force=True, reason="fire drill")
    wait_until(lambda: lost)
    assert lost[0].code == Code.REVOKED_LEASE
    assert "fire drill" in lost[0].message
    assert "client2@lab" in lost[0].holder
    assert task.wait(5).final


def test_a_query_finds_what_is_free_and_says_what_is_not(laboratory, client, take, refused):
    laboratory.add("First")
    laboratory.add("Second")
    client1, client2 = client(), client(name="client2@lab")
    take(client1, "First")
    wait_until(lambda: client2.find("First").state == axon.EntityState.REG)
    with pytest.raises(axon.Refused, match="First is held by client1@lab"):
        client2.checkout_query("2 ROBOT/MOBILE")
    assert client2.checkout_query("1 mobile with drive")[0].name == "Second"
    with refused(Code.MALFORMED):
        client2.checkout_query("1 ROBTO")


def test_a_drill_measures_and_disturbs_nothing(laboratory, client, take, drive, refused):
    entity = laboratory.add()
    client1, client2 = client(), client(name="client2@lab")
    robot = take(client1)
    task = drive(robot, entity)
    client2.wait_for("PeopleBot", 5)
    reports = client2.drill("PeopleBot", count=5, period=0.01)
    assert len(reports) == 1 and len(reports[0].callback) == 5
    assert all(time is not None for time in reports[0].callback)
    assert task.report.state == TaskState.RUNNING
    assert not client2.find("PeopleBot").latched
    robot.send_text("and commands are still obeyed")
    entity.do("expect_text")
    with refused(Code.UNKNOWN_ENTITY):
        client2.drill("Nobody")
