"""connect_blocking against a daemon: each script runs in a thread, as a program without asyncio does."""

import asyncio
import contextlib
import functools
import itertools
import math
import os
import threading
import time
from collections.abc import AsyncIterator, Callable, Mapping
from typing import Any

import pytest

from hostlink.client import BlockingHost, connect_blocking
from hostlink.core.robot.events import LET_GO
from hostlink.errors import HostlinkError
from tests.support.daemon import Daemon, daemon, stops_of
from tests.support.driving import obeyed
from tests.support.fake_device import FakeDevice, fake_device, pose, robot_topics
from tests.support.waiting import expect

ZERO = (0.0, 0.0)


@contextlib.asynccontextmanager
async def world() -> AsyncIterator[tuple[Daemon, FakeDevice]]:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device:
        yield host, device


async def run(script: Callable[[BlockingHost], Any], host: Daemon) -> Any:
    """The script in a thread, with a connection for its length."""

    def connected() -> Any:
        with connect_blocking(host.url) as me:
            return script(me)

    return await asyncio.to_thread(connected)


def driver_of(host: Daemon) -> str | None:
    return host.hub.robots.find("robot_0").gate.owner_name


def threads() -> list[threading.Thread]:
    """Return the threads of open connections."""
    return [each for each in threading.enumerate() if each.name == "hostlink"]


async def test_a_script_drives_at_once_after_its_own_unlock_and_its_own_stop() -> None:
    def script(me: BlockingHost) -> None:
        robot = me.robot("robot_0")
        for interrupt in (lambda: robot.lock("smoke", wait_s=0), lambda: robot.stop(wait_s=0), me.stop_all):
            obeyed(lambda: robot.drive(0.2, 0.0))
            interrupt()
            robot.unlock()
            obeyed(lambda: robot.drive(0.2, 0.0))

    async with world() as (host, _):
        await run(script, host)


async def test_a_robot_is_driven_while_the_program_computes_and_stops_at_the_end_of_the_block() -> None:
    def script(me: BlockingHost) -> bool:
        accepted = obeyed(lambda: me.robot("robot_0").drive(0.2, 0.5))
        assert (accepted.linear_m_s, accepted.is_limited) == (0.2, False)
        time.sleep(0.8)
        return me.robot("robot_0").is_driven

    async with world() as (host, device):
        reasons = stops_of(host, "robot_0")
        is_driven = await run(script, host)
        assert await device.velocity_other_than(ZERO) == (0.2, 0.5)
        assert await device.velocity_other_than((0.2, 0.5)) == ZERO
        gate = host.hub.robots.find("robot_0").gate
        await expect(lambda: gate.owner_name is None)
        assert (is_driven, reasons, gate.counts.stops) == (True, [LET_GO], 0) or host.was_paused


async def test_robot_stops_when_the_thread_that_drives_it_hangs_also_beside_a_thread_that_reads() -> None:
    """The connection has a thread of its own, which does not hang."""
    hangs = threading.Event()

    def script() -> str:
        with connect_blocking(host.url, idle_timeout_s=1.0) as me:
            robot = me.robot("robot_0")
            reader = threading.Thread(target=read, args=(me,))
            reader.start()
            obeyed(lambda: robot.drive(0.2, 0.5))
            hangs.wait()
            reader.join()
            with pytest.raises(HostlinkError) as caught:
                robot.drive(0.2, 0.5)
            return str(caught.value)

    def read(me: BlockingHost) -> None:
        while not hangs.wait(0.05):
            me.robots()

    async with world() as (host, device), asyncio.TaskGroup() as tasks:
        reasons = stops_of(host, "robot_0")
        running = tasks.create_task(asyncio.to_thread(script))
        assert await device.velocity_other_than(ZERO) == (0.2, 0.5)
        assert await device.velocity_other_than((0.2, 0.5)) == ZERO
        await expect(lambda: reasons)
        hangs.set()
        assert "idle_timeout_s" in await running or host.was_paused
        assert str(reasons[0]).startswith("the program made no call for 1.") or host.was_paused


async def test_blocking_client_works_without_with_in_a_thread_with_a_loop_and_after_an_error() -> None:
    """A notebook runs its cells in an event loop, which the blocking client must not need."""
    async with world() as (host, device):
        me = await asyncio.to_thread(connect_blocking, host.url)
        robot = me.robot("robot_0")
        await asyncio.to_thread(obeyed, lambda: robot.drive(0.2, 0.0))
        with pytest.raises(HostlinkError, match="finite"):
            robot.drive(math.nan, 0.0)  # it is refused before it is sent: this thread has the daemon's loop
        await asyncio.to_thread(obeyed, lambda: robot.drive(0.1, 0.0))
        assert await device.velocity_other_than(ZERO) == (0.2, 0.0)
        assert repr(me) == f"<BlockingHost {host.url}: connected>"
        assert repr(robot) == f"<BlockingRobot robot_0 at {host.url}, priority 50>"
        await asyncio.to_thread(me.close)
        me.close()
        await expect(lambda: (driver_of(host), threads()) == (None, []))
        with pytest.raises(HostlinkError, match="the connection is closed: connect again"):
            me.robots()


async def test_robot_of_a_collected_connection_is_not_driven() -> None:
    async with world() as (host, _):
        me = await asyncio.to_thread(connect_blocking, host.url)
        robot = me.robot("robot_0")
        await asyncio.to_thread(obeyed, functools.partial(robot.drive, 0.2, 0.0))
        del me
        await asyncio.to_thread(obeyed, functools.partial(robot.drive, 0.1, 0.0))  # the robot is still referenced
        del robot
        await expect(lambda: driver_of(host) is None and not threads())
        assert host.hub.robots.find("robot_0").gate.counts.expired == 0 or host.was_paused


async def test_streams_are_iterators() -> None:
    async with world() as (host, device):
        await device.send(pose(1.0))

        def script(me: BlockingHost) -> list[Any]:
            with me.robot("robot_0").odometry() as poses:
                first = next(poses)["pose"]["x_m"]
            events = {event.name for event in itertools.islice(me.watch(), 3)}
            with me.subscribe("/chat", type_name="std_msgs/String") as messages:
                assert repr(messages) == "<Messages of /chat: 0 waiting, 0 dropped>"
                for number in range(3):
                    me.publish("/chat", {"data": str(number)})
                me.settle()
                one = next(messages)["data"]
                rest = [message["data"] for message in messages.pop_all()]
            with pytest.raises(HostlinkError, match="the stream of /chat is closed"):
                next(messages)
            return [first, events, one, rest, messages.dropped]

        found = await run(script, host)
        assert found == [1.0, {"robots", "links", "clients"}, "0", ["1", "2"], 0]
        await expect(lambda: host.hub.topics.find_or_none("/chat") is None)


async def test_a_stream_that_is_forgotten_is_unsubscribed() -> None:
    def script(me: BlockingHost) -> None:
        for _ in range(300):  # one client may have 256
            me.subscribe("/chat", type_name="std_msgs/String")
        me.settle()
        assert (
            next(iter([each for each in me.topics() if each["name"] == "/chat"]), {"subscribers": 0})["subscribers"] < 2
        )

    async with world() as (host, _):
        await run(script, host)


async def test_a_program_offers_a_service_whose_answer_uses_the_connection() -> None:
    def script(me: BlockingHost) -> list[Any]:
        def count(_: Mapping[str, Any]) -> dict[str, Any]:
            return {"success": True, "message": str(len(me.robots()))}

        def fail(_: Mapping[str, Any]) -> dict[str, Any]:
            raise HostlinkError("not today")

        opened = me.serve("/count", "std_srvs/Trigger", count)
        me.serve("/fail", "std_srvs/Trigger", fail)
        assert repr(opened) == "<open: /count>"
        me.settle()
        found = [me.call("/count")["message"]]
        for service in ("/fail", "/count"):
            with pytest.raises(HostlinkError) as caught:
                me.call(service)
            found.append(str(caught.value))
            opened.close()
            me.settle()
        return found

    async with world() as (host, _):
        one, failed, gone = await run(script, host)
        assert (one, "not today" in failed, "/count" in gone) == ("1", True, True)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
async def test_an_error_in_an_answer_fails_the_call_and_nothing_else() -> None:
    def script(me: BlockingHost) -> tuple[str, bool]:
        with me.serve("/broken", "std_srvs/Trigger", lambda request: request["nothing"]):
            me.settle()
            with pytest.raises(HostlinkError) as caught:
                me.call("/broken")
        return str(caught.value), me.is_connected

    async with world() as (host, _):
        error, is_connected = await run(script, host)
        assert ("an error in its answer" in error and is_connected) or host.was_paused


async def test_a_refused_message_is_raised_at_the_end_of_the_block_or_by_close_once() -> None:
    def script(me: BlockingHost) -> None:
        me.publish("/nobody", {"data": 1})

    async with world() as (host, _):
        with pytest.raises(HostlinkError, match="nobody"):
            await run(script, host)
        me = await asyncio.to_thread(connect_blocking, host.url)
        await asyncio.to_thread(script, me)
        with pytest.raises(HostlinkError, match="nobody"):
            await asyncio.to_thread(me.close)
        me.close()


async def test_without_a_daemon_the_error_is_the_same_and_no_thread_stays() -> None:
    with pytest.raises(HostlinkError, match="is `hostlink serve` running there"):
        await asyncio.to_thread(connect_blocking, "http://127.0.0.1:9")
    await expect(lambda: not threads())


async def test_close_releases_a_call_that_waits_in_another_thread() -> None:
    async with world() as (host, _):
        me = await asyncio.to_thread(connect_blocking, host.url)
        stream = await asyncio.to_thread(me.subscribe, "/chat", type_name="std_msgs/String")
        waiting = asyncio.get_running_loop().run_in_executor(None, next, stream)
        await expect(lambda: me._loop._life._calls)
        await asyncio.to_thread(me.close)
        with pytest.raises(HostlinkError, match="the connection is closed"):
            await waiting


async def test_a_forked_process_has_no_connection_and_ends_none() -> None:
    async with world() as (host, _):
        me = await asyncio.to_thread(connect_blocking, host.url)
        await asyncio.to_thread(obeyed, lambda: me.robot("robot_0").drive(0.2, 0.0))
        child = os.fork()
        if child == 0:
            status = 1
            with contextlib.suppress(BaseException):
                me.close()
                me.robots()
            with contextlib.suppress(HostlinkError):
                status = 2
                me.robots()
                status = 3
            os._exit(status)
        assert await asyncio.to_thread(lambda: os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])) == 2
        assert len(await asyncio.to_thread(me.robots)) == 1
        assert me.robot("robot_0").is_driven or host.was_paused
        await asyncio.to_thread(me.close)
