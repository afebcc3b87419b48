"""Every end of a driver in the ROS graph stops the robot within the lease, also during a flood."""

import asyncio
import contextlib
import os
import re
import signal
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import dataclass, field
from pathlib import Path

import aiohttp
import pytest

from hostlink.core.protocol.endpoint import EndpointKind
from tests.support.background import meanwhile
from tests.support.fake_device import FakeDevice, robot_topics, topic
from tests.support.precedence import GOES_LAST
from tests.support.process import Process
from tests.support.ros1.debian import Graph, Node, call, graph, living_device
from tests.support.stopwatch import Stopwatch
from tests.support.waiting import TIMEOUT_S, expect, expect_never, is_true_within

pytestmark = pytest.mark.quiet

VELOCITY = "/robot_0/velocity_commands"
LEASE_S = 0.5
STEADY = 10  # velocities of half a second
LATE_S = 0.15  # a tick of the gates, and what a busy machine adds
AGAIN_S = 5.0  # a driver that a pause of the daemon interrupted lets go after this time
AT_ONCE_S = 0.25  # an end that TCP reports; the daemon shares two cores with the flood
FLOOD = "/neighbour/blob"


@dataclass
class Driven:
    """A robot that a rospy program drives; what it was sent, and when."""

    ros: Graph
    daemon: Process
    driver: Node
    robot: FakeDevice
    node_uri: str  # of the daemon
    heard: list[tuple[float, float]] = field(default_factory=list)

    async def listen(self) -> None:
        while True:
            speed, _ = await self.robot.velocity()
            self.heard.append((time.monotonic(), speed))

    @property
    def speed(self) -> float:
        return self.heard[-1][1]

    async def drives(self, speed: float) -> None:
        """Wait until the robot has this speed. After a pause of the daemon on a busy machine the driver lets go."""
        while not await is_true_within(lambda: {each for _, each in self.heard[-STEADY:]} == {speed}, AGAIN_S):
            for each in (0.0, speed):
                self.driver.send(str(each))
                await asyncio.sleep(LEASE_S)

    async def stands_after(self, end: "End", limit_s: float) -> None:
        """Check that the robot moves until `end`, gets its zero within the limit, and no other velocity afterwards.

        The time in which the test, the daemon or the driver waited for a core is left out.
        """
        await self.drives(0.25)
        began_s, watch = time.monotonic(), Stopwatch(self.daemon.pid, self.driver.child.pid)
        async with meanwhile(watch.sampling()):
            await end(self)
            await expect(lambda: self.speed == 0.0)
        moving_s = max(at_s for at_s, speed in self.heard if speed)
        zero_s = min(at_s for at_s, speed in self.heard if not speed and at_s > moving_s)
        after_s = zero_s - began_s - watch.kept_s
        assert after_s < limit_s, f"the zero came after {after_s:.3f} s"
        await expect_never(lambda: self.speed != 0.0, for_s=0.8)


End = Callable[[Driven], Awaitable[None]]


@contextlib.asynccontextmanager
async def driven(folder: Path, *, is_flooded: bool) -> AsyncIterator[Driven]:
    """`is_flooded`: two neighbours publish to another device as fast as they can."""
    async with contextlib.AsyncExitStack() as stack:
        ros = await stack.enter_async_context(graph(folder))
        daemon = await stack.enter_async_context(ros.daemon())
        robot = await stack.enter_async_context(living_device(daemon.tcp, robot_topics()))
        if is_flooded:
            blob = topic(EndpointKind.SUBSCRIBER, 105, FLOOD, "std_msgs/String")
            await stack.enter_async_context(drained(daemon, [*robot_topics("neighbour"), blob]))
            for number in range(2):
                words = ("talk", FLOOD, "std_msgs/String", "{data: flood}", "-1", f"name=flood_{number}")
                await stack.enter_async_context(ros.node(*words, precedence=GOES_LAST))
        driver = await stack.enter_async_context(ros.node("drive", VELOCITY, "0.25", "20"))
        if is_flooded:
            await flooding(daemon)
        made = Driven(ros, daemon, driver, robot, await ros.slave_uri("/hostlink"))
        tasks = await stack.enter_async_context(asyncio.TaskGroup())
        listening = tasks.create_task(made.listen())
        try:
            yield made
        finally:
            listening.cancel()


async def flooding(daemon: Process) -> None:
    """The flood is one: thousands of messages come."""
    async with aiohttp.ClientSession() as session, asyncio.timeout(TIMEOUT_S):
        count = 0.0
        while count < 3000:
            async with session.get(f"{daemon.url}/metrics") as response:
                found = re.search(
                    r'hostlink_graph_events_total\{graph="ros1",what="messages_from_ros"\} (\S+)', await response.text()
                )
            count = float(found[1]) if found else 0.0
            await asyncio.sleep(0.1)


@contextlib.asynccontextmanager
async def drained(daemon: Process, topics: list[object]) -> AsyncIterator[None]:
    """A device that reads all that it is sent."""
    async with living_device(daemon.tcp, topics, local_host="127.0.0.9") as device:  # type: ignore[arg-type]

        async def read() -> None:
            while True:
                await device.next()

        async with meanwhile(read()):
            yield


BESIDE_A_FLOOD = pytest.param(True, marks=pytest.mark.long, id="beside a flood")
flooded = pytest.mark.parametrize("is_flooded", [pytest.param(False, id="alone"), BESIDE_A_FLOOD])


def signalled(number: signal.Signals) -> End:
    async def end(made: Driven) -> None:
        made.driver.signal(number)

    return end


async def forgotten(made: Driven) -> None:
    """The master names the driver no more."""
    assert (await call(made.node_uri, "publisherUpdate", "/master", VELOCITY, []))[0] == 1


async def shut_down(made: Driven) -> None:
    """`rosnode kill` ends the daemon's node."""
    await call(made.node_uri, "shutdown", "/rosnode", "user request")


@flooded
@pytest.mark.parametrize(
    ("end", "limit_s"),
    [
        pytest.param(signalled(signal.SIGKILL), AT_ONCE_S, id="killed"),
        # Like a network that is cut or a process that hangs, without any report of it.
        pytest.param(signalled(signal.SIGSTOP), LEASE_S + LATE_S, id="silent"),
        # A killed driver closes its connection, too.
        pytest.param(signalled(signal.SIGINT), LEASE_S + LATE_S, marks=pytest.mark.long, id="in order"),
        pytest.param(forgotten, AT_ONCE_S, id="forgotten by the master"),
        pytest.param(shut_down, AT_ONCE_S, id="the daemon's node is killed"),
    ],
)
async def test_robot_stands_after_the_end_of_its_driver(
    tmp_path: Path, end: End, limit_s: float, is_flooded: bool
) -> None:
    async with driven(tmp_path, is_flooded=is_flooded) as made:
        await made.stands_after(end, limit_s)


@pytest.mark.long
@flooded
async def test_a_driver_beside_a_dead_master_drives_on_until_it_is_killed(tmp_path: Path, is_flooded: bool) -> None:
    async with driven(tmp_path, is_flooded=is_flooded) as made:
        await made.drives(0.25)
        await made.ros.kill()
        await made.daemon.read_log("ros1.master_lost")
        made.driver.send("0.2")
        await made.drives(0.2)
        made.driver.send("0.25")
        await made.stands_after(signalled(signal.SIGKILL), AT_ONCE_S)


async def test_a_daemon_that_is_killed_while_a_program_of_ros_drives(tmp_path: Path) -> None:
    async with driven(tmp_path, is_flooded=False) as made:
        await made.drives(0.25)
        os.kill(made.daemon.pid, signal.SIGKILL)
        with contextlib.suppress(EOFError, ConnectionError):
            await expect(lambda: made.speed == 0.0)
        assert made.speed == 0.0
