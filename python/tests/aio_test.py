# SPDX-License-Identifier: GPL-2.0-or-later
"""The client as coroutines."""
import asyncio
import threading
import time

import pytest

import axon
import axon.aio
from support import wait_until
from axon import RefusalCode as Code
from axon import TaskState


def run(coroutine):
    return asyncio.run(asyncio.wait_for(coroutine, 30))


async def until(holds, seconds=10):
    end = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < end, "not in time"
        await asyncio.sleep(0.01)


async def refused(awaitable, code):
    with pytest.raises(axon.Refused) as error:
        await awaitable
    assert error.value.code == code, error.value
    return error.value


def test_runs_a_task_from_check_out_to_release(laboratory):
    entity = laboratory.add()
    entity.on("Drive", ["progress", 0.5], ["result", "Moved", [1000.0]], ["succeed"])

    async def work():
        async with axon.aio.connect(laboratory.server) as lab, lab.checkout("PeopleBot") as robot:
            result = await robot.run("Drive", Distance=1000)
            assert result["Moved"] == axon.Quantity(1000.0, "mm")
            states = [report.state async for report in robot.start("Drive", Distance=axon.Quantity(1, "mm"))]
            assert states[-1] == TaskState.SUCCEEDED
            assert (await robot.start("Drive", Distance=1)).Moved.units == "mm"
            await refused(robot.run("Drive", Distance=axon.Quantity(1, "cm")), Code.WRONG_UNITS)
            await robot.set("Drive", Speed=100.0)
            assert [service.name for service in await lab.services("PeopleBot")] == ["Drive", "Say"]
        await refused(robot.send_text("too late"), Code.NOT_CONNECTED if not lab.connected else Code.NOT_HOLDER)
    run(work())


def test_many_tasks_and_streams_need_no_threads(laboratory):
    entities = [laboratory.add(f"Robot{number}") for number in range(4)]
    for entity in entities:
        entity.on("Drive", ["never"])

    async def work():
        async with axon.aio.connect(laboratory.server) as lab:
            robots = await lab.checkout_all([f"Robot{number}" for number in range(4)])
            before = threading.active_count()
            tasks = [robot.start("Drive", Distance=1) for robot in robots]
            waits = [asyncio.ensure_future(task.wait()) for task in tasks]
            reads = [asyncio.ensure_future(robot.battery.take(2, timeout=20)) for robot in robots]
            await until(lambda: all(task.report.state == TaskState.RUNNING for task in tasks))
            assert threading.active_count() <= before
            while not all(read.done() for read in reads):
                for entity in entities:
                    entity.sample("battery", 12.0)
                await asyncio.sleep(0.02)
            assert {float(sample) for read in reads for sample in read.result()} == {12.0}
            receipts = await robots.stop()
            assert receipts.confirmed and len(receipts) == 4
            assert {report.state for report in await asyncio.gather(*waits)} == {TaskState.STOPPED}
            for robot in robots:
                await robot.rearm()
    run(work())


def test_cancelling_a_run_cancels_the_task_and_cancelling_a_check_out_leaves_the_line(laboratory):
    entity = laboratory.add()
    entity.on("Drive", ["never"])

    async def work():
        async with axon.aio.connect(laboratory.server, name="client1@lab") as lab, axon.aio.connect(laboratory.server) as other:
            robot = await lab.checkout("PeopleBot")
            running = asyncio.ensure_future(robot.run("Drive", Distance=1))
            await until(lambda: robot.entity.state == axon.EntityState.BUSY)
            running.cancel()
            with pytest.raises(asyncio.CancelledError):
                await running
            await until(lambda: robot.entity.state == axon.EntityState.REG)
            places = []
            waiting = asyncio.ensure_future(other.checkout("PeopleBot", wait=20, on_waiting=lambda told: places.append(told.place)).__aenter__())
            await until(lambda: 1 in places)
            waiting.cancel()
            with pytest.raises(asyncio.CancelledError):
                await waiting
            await until(lambda: lab.find("PeopleBot").waiting == 0)
            error = await refused(other.checkout("PeopleBot"), Code.ALREADY_HELD)
            assert error.holder == "client1@lab"
    run(work())


def test_texts_events_hand_overs_and_losses_are_iterated(laboratory):
    entity = laboratory.add()

    async def work():
        async with axon.aio.connect(laboratory.server, name="client1@lab") as lab, axon.aio.connect(laboratory.server, name="client2@lab") as other:
            events = lab.events()
            robot = await lab.checkout("PeopleBot")
            texts = robot.texts()
            entity.do("text", text="one")
            entity.do("text", text="two")
            assert [await texts.__anext__(), await texts.__anext__()] == ["one", "two"]
            lost = asyncio.ensure_future(robot.lost())
            asked = robot.hand_over_requests()
            taking = asyncio.ensure_future(other.checkout_all(["PeopleBot"], ask=True, reason="mine").__aenter__())
            request = await asked.__anext__()
            assert (request.by, request.reason) == ("client2@lab", "mine")
            await robot.answer_hand_over(True)
            assert (await lost).code == Code.REVOKED_LEASE
            robots = await taking
            assert robots[0].name == "PeopleBot"
            async for event in events:
                if event.kind == "changed" and event.entity.holder.name == "client2@lab":
                    break
    run(work())


def test_an_upload_tells_its_progress_in_the_event_loop(laboratory, tmp_path):
    entity = laboratory.add()
    file = tmp_path / "lab.map"
    file.write_text("m" * 300_000)

    async def work():
        here = threading.get_ident()
        told = []
        async with axon.aio.connect(laboratory.server) as lab, lab.checkout("PeopleBot") as robot:
            await robot.upload("Drive", "Map", file, lambda sent, total: told.append((threading.get_ident() == here, sent, total)))
            await until(lambda: told and told[-1][1] == 300_000)
            assert all(mine for mine, _, _ in told)
    run(work())
    assert len(entity.do("uploaded", service="Drive", resource="Map")["text"]) == 300_000


def test_a_stop_waits_for_nothing_that_waits(laboratory):
    """Hundred requests that wait have hundred threads, and the stop has its own."""
    laboratory.add()

    async def work():
        async with axon.aio.connect(laboratory.server) as lab:
            waits = [asyncio.ensure_future(lab.wait_for(f"Nobody{number}", 20)) for number in range(100)]
            await asyncio.sleep(0.2)
            assert (await lab.stop()).confirmed
            for wait in waits:
                wait.cancel()
    begin = time.monotonic()
    run(work())
    assert time.monotonic() - begin < 15


def test_what_never_comes_is_told_in_time(laboratory):
    laboratory.add().on("Drive", ["never"])

    async def work():
        async with axon.aio.connect(laboratory.server) as lab, lab.checkout("PeopleBot") as robot:
            await refused(robot.battery.next(timeout=0.1), Code.TIMED_OUT)
            await refused(robot.start("Drive", Distance=1).result(timeout=0.2), Code.TIMED_OUT)
            with pytest.raises(ValueError):
                await lab.wait_for("x", -1)
    run(work())
    with pytest.raises(axon.Refused):
        run(axon.aio.connect("127.0.0.1:1").__aenter__())


def test_several_may_iterate_over_the_same(laboratory):
    entity = laboratory.add()

    async def work():
        async with axon.aio.connect(laboratory.server, name="client1@lab") as lab:
            first, second = lab.events(), lab.events()
            robot = await lab.checkout("PeopleBot")
            texts, others = robot.texts(), lab.held()[0].texts()
            entity.do("text", text="one")
            assert [await texts.__anext__(), await others.__anext__()] == ["one", "one"]
            await texts.aclose()
            entity.do("text", text="two")
            assert await others.__anext__() == "two"
            for events in (first, second):
                async for event in events:
                    if event.kind == "changed" and event.entity.holder.name == "client1@lab":
                        break
    run(work())


def test_whoever_asks_what_is_held_while_a_robot_is_granted_is_told_too(laboratory):
    entity = laboratory.add()

    class Grants:
        def __init__(self, lab):
            self.lab, self.native, self.loop = lab, lab._native, asyncio.get_running_loop()

        def __getattr__(self, name):
            return getattr(self.native, name)

        def check_out(self, *arguments):
            self.native.check_out(*arguments)
            asyncio.run_coroutine_threadsafe(self.ask(), self.loop).result(10)

        async def ask(self):
            self.texts = self.lab.held()[0].texts()

    async def work():
        async with axon.aio.connect(laboratory.server) as lab:
            lab._native = grants = Grants(lab)
            texts = (await lab.checkout("PeopleBot")).texts()
            entity.do("text", text="both")
            for each in (texts, grants.texts):
                assert await asyncio.wait_for(each.__anext__(), 10) == "both"
    run(work())


def test_a_result_that_has_come_when_the_task_is_cancelled_is_handed_over():
    """Between the answer and the coroutine that waits for it, the loop runs others; one of them cancels it."""
    async def work():
        given_back = threading.Event()
        came = threading.Event()
        waiting = asyncio.ensure_future(axon.aio.in_thread(lambda: came.wait(10), unwanted=lambda _: given_back.set()))
        await asyncio.sleep(0)
        answer = waiting._fut_waiter
        loop = asyncio.get_running_loop()
        came.set()
        wait_until(lambda: loop._ready, "the answer is in the loop's queue, and this coroutine has not let it run yet")
        loop.call_soon(waiting.cancel)
        with pytest.raises(asyncio.CancelledError):
            await waiting
        assert answer.done() and not answer.cancelled()
        await until(given_back.is_set)
    run(work())


def test_leaving_robots_releases_all_of_them_also_when_cancelled(laboratory):
    for number in range(3):
        laboratory.add(f"Robot{number}")

    async def work():
        async with axon.aio.connect(laboratory.server) as lab, axon.aio.connect(laboratory.server) as other:
            robots = await lab.checkout_all([f"Robot{number}" for number in range(3)])
            leaving = asyncio.ensure_future(robots.__aexit__(None, None, None))
            await asyncio.sleep(0)
            leaving.cancel()
            with pytest.raises(asyncio.CancelledError):
                await leaving
            await until(lambda: not any(entity.holder.id for entity in other.entities()))
    run(work())
