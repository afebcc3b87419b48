"""Daemons over Zenoh: each shows and drives the robots of all, and a lease ends where the robot is."""

import asyncio
import contextlib
from pathlib import Path

import pytest

from hostlink.client import connect
from hostlink.core.config import Config, RobotConfig
from hostlink.core.protocol.endpoint import EndpointKind
from hostlink.core.robot.admission import LEASE_S
from hostlink.core.robot.velocity import TWIST_TYPE, PlanarVelocity
from hostlink.errors import HostlinkError
from tests.support.device_reports import battery_topic, report
from tests.support.fake_device import fake_device, pose, robot_topics, topic
from tests.support.participants import subscribe
from tests.support.rosbridge import client
from tests.support.stopwatch import Stopwatch
from tests.support.waiting import expect, expect_never
from tests.support.zenoh_fleet import drive, fleet, has_met, joined, port_of, robot, shown, subscriber_count

STILL = (0.0, 0.0)
ROBOTS = 10


async def test_a_robot_of_another_daemon_is_shown() -> None:
    async with fleet("a", "b") as (a, b), fake_device(b.tcp, robot_topics("robot_7")) as device:
        await device.send(pose(1.5))
        await shown(a, "robot_7")
        view = await robot(a, "robot_7")
        assert (view["host"], view["connected"], view["also_at"]) == ("b", True, [])
        await expect(lambda: a.hub.robots.remote["robot_7"].odometry.count)
        assert (await a.get("/api/robots/robot_7/odometry"))["pose"]["x_m"] == 1.5
        assert [each["name"] for each in (await a.get("/api/robots"))["robots"]] == ["robot_7"]
        assert (await robot(b, "robot_7"))["host"] is None


async def test_board_description_of_a_remote_device_is_shown_while_it_is_connected() -> None:
    keys = ("battery_v", "battery_percent", "signal_dbm", "firmware", "wheel_separation_m", "kinematics")
    settings = {"robot_7": RobotConfig(wheel_separation_m=0.2, kinematics="differential")}
    async with fleet("a", "b", config=Config(robots=settings)) as (a, b):
        async with fake_device(b.tcp, [*robot_topics("robot_7"), battery_topic("robot_7")]) as device:
            await device.send(report(9.5))
            await shown(a, "robot_7")
            await expect(lambda: "battery_low" in a.hub.robots.remote["robot_7"].known.device_errors)
            view = await robot(a, "robot_7")
            assert [view[key] for key in keys] == [9.5, 25.0, -67, "rover 1.4", 0.2, "differential"]
            assert "battery_low" in view["device_errors"]
        await expect(lambda: a.hub.robots.remote["robot_7"].link is None)
        view = await robot(a, "robot_7")
        assert [view[key] for key in keys[:4]] == [None] * 4
        assert view["device_errors"] == []


async def test_a_robot_of_another_daemon_is_driven_over_rest() -> None:
    async with fleet("a", "b") as (a, b), fake_device(b.tcp, robot_topics("robot_7")) as device:
        await shown(a, "robot_7")
        status, answer = await drive(a, "robot_7", 0.3)
        assert (status, answer["velocity"]["linear_m_s"], answer["is_limited"]) == (200, 0.3, False)
        assert await device.velocity_other_than(STILL) == (0.3, 0.0)
        holder = (await robot(b, "robot_7"))["holder"]
        assert holder == "program (127.0.0.1) at a"
        await expect(lambda: a.hub.robots.remote["robot_7"].known.holder == "program (127.0.0.1)")


async def test_the_other_daemons_limits_apply() -> None:
    async with fleet("a", "b") as (a, b), fake_device(b.tcp, robot_topics("robot_7")):
        await shown(a, "robot_7")
        _, answer = await drive(a, "robot_7", 9.0)
        assert (answer["velocity"]["linear_m_s"], answer["is_limited"]) == (1.0, True)


async def test_driver_that_leaves_stops_its_remote_robot_at_once() -> None:
    async with fleet("a", "b") as (a, b), fake_device(b.tcp, robot_topics("robot_7")) as device:
        await shown(a, "robot_7")
        participant = a.hub.join("driver")
        participant.drive(a.hub.robots.find("robot_7"), PlanarVelocity(x_m_s=0.3))
        assert await device.velocity_other_than(STILL) == (0.3, 0.0)
        participant.leave()
        watch = Stopwatch()
        assert await device.velocity_other_than((0.3, 0.0)) == STILL
        assert watch.seconds < 0.3 or b.was_paused  # the lease alone would last 0.5 s


@pytest.mark.parametrize("how", ["stop", "lock"])
async def test_interruption_at_the_robots_daemon_disarms_remote_drivers(how: str) -> None:
    async with fleet("a", "b") as (a, b), fake_device(b.tcp, robot_topics("robot_7")) as device:
        await shown(a, "robot_7")
        async with connect(a.url) as program:
            driven = program.robot("robot_7")
            await driven.drive(0.3, 0.0)
            assert await device.velocity_other_than(STILL) == (0.3, 0.0)
            gate = b.hub.robots.find("robot_7").gate
            before = gate.counts.commands
            await expect(lambda: gate.counts.commands > before + 2)  # it is repeated
            await b.rest("POST", f"/api/robots/robot_7/{how}")
            if how == "lock":
                await b.rest("POST", "/api/robots/robot_7/unlock")
            accepted = gate.counts.commands
            await expect(lambda: not driven.is_driven)
            assert (gate.counts.commands, gate.current.is_zero) == (accepted, True)
            with pytest.raises(HostlinkError, match="robot_7 was stopped: "):
                await driven.drive(0.3, 0.0)
            await driven.drive(0.2, 0.0, resume=True)
            assert gate.current.x_m_s == 0.2


async def test_stream_that_continued_through_a_restart_of_the_robots_daemon_does_not_drive() -> None:
    async with fleet("a") as (a,), contextlib.AsyncExitStack() as stack:
        b = await stack.enter_async_context(joined(port_of(a), "b"))
        driver = a.hub.join("driver")
        async with fake_device(b.tcp, robot_topics("robot_7")):
            driver.drive(await shown(a, "robot_7"), PlanarVelocity(0.2))

        def refusal() -> str:
            try:
                driver.drive(a.hub.robots.remote["robot_7"], PlanarVelocity(0.2))
            except HostlinkError as error:
                return error.kind
            return ""

        async def go_on() -> None:
            while True:
                refusals.append(refusal())
                await asyncio.sleep(0.05)

        refusals: list[str] = []
        async with asyncio.TaskGroup() as tasks:
            going_on = tasks.create_task(go_on())
            await stack.aclose()
            async with (
                joined(port_of(a), "b") as again,
                fake_device(again.tcp, robot_topics("robot_7")),
            ):
                await shown(a, "robot_7")
                del refusals[:]
                await expect(lambda: len(refusals) > 20)
                assert set(refusals) == {"disarmed"} or a.was_paused  # which lets a stream end
                going_on.cancel()
                assert again.hub.robots.find_here("robot_7").gate.counts.commands == 0 or a.was_paused


async def test_remote_played_robot_is_marked_as_played() -> None:
    mark = topic(EndpointKind.PUBLISHER, 130, "/robot_7/played", "hostlink_msgs/PlayedRecording")
    async with fleet("a", "b") as (a, b), fake_device(b.tcp, [*robot_topics("robot_7"), mark]):
        await shown(a, "robot_7")
        await expect(lambda: a.hub.robots.remote["robot_7"].known.is_played)


async def test_stop_all_reaches_every_daemon_and_is_answered_by_each() -> None:
    async with (
        fleet("a", "b", "c") as (a, b, c),
        fake_device(b.tcp, robot_topics("robot_7")) as seventh,
        fake_device(c.tcp, robot_topics("robot_8")) as eighth,
    ):
        await shown(a, "robot_7")
        await shown(a, "robot_8")
        for host, name in ((b, "robot_7"), (c, "robot_8")):
            host.hub.join("driver").drive(host.hub.robots.find(name), PlanarVelocity(x_m_s=0.2))
        for device in (seventh, eighth):
            assert await device.velocity_other_than(STILL) == (0.2, 0.0)
        status, answer = await a.rest("POST", "/api/stop")
        assert (status, [each["holder"] for each in answer["robots"]]) == (200, [None, None])
        for device in (seventh, eighth):
            assert await device.velocity_other_than((0.2, 0.0)) == STILL


async def test_a_lock_holds_everywhere_until_it_is_released_from_anywhere() -> None:
    async with fleet("a", "b") as (a, b), fake_device(b.tcp, robot_topics("robot_7")):
        await shown(a, "robot_7")
        status, view = await a.rest("POST", "/api/robots/robot_7/lock", b'{"reason":"smoke"}')
        assert (status, view["locked"], view["lock_reason"]) == (200, True, "smoke (a)")
        assert b.hub.robots.find_here("robot_7").gate.lock_reason == "smoke (a)"
        for host in (a, b):
            status, answer = await drive(host, "robot_7", 0.3)
            assert (status, answer["error"]["kind"]) == (409, "locked")
        status, view = await a.rest("POST", "/api/robots/robot_7/unlock")
        assert (status, view["locked"]) == (200, False)
        for host in (a, b):  # each went on through the lock
            status, answer = await drive(host, "robot_7", 0.3)
            assert (status, answer["error"]["kind"]) == (409, "disarmed")
        await asyncio.sleep(LEASE_S + 0.1)
        assert (await drive(b, "robot_7", 0.3))[0] == 200


async def test_lock_follows_a_robot_that_connects_to_another_daemon() -> None:
    async with fleet("a", "b") as (a, b):
        async with fake_device(a.tcp, robot_topics("robot_7")):
            await shown(b, "robot_7")
            assert (await b.rest("POST", "/api/robots/robot_7/lock", b'{"reason":"smoke"}'))[0] == 200
        await expect(lambda: b.hub.robots.remote["robot_7"].link is None)
        async with fake_device(b.tcp, robot_topics("robot_7")):
            await expect(lambda: b.hub.robots.get_here("robot_7"))
            await expect(lambda: b.hub.robots.find_here("robot_7").gate.lock_reason == "locked at a: smoke (b)")
            assert (await drive(a, "robot_7", 0.2))[0] == 409  # also before a knows where it is
            await shown(a, "robot_7")
            assert (await drive(a, "robot_7", 0.2))[0] == 409
            assert (await a.rest("POST", "/api/robots/robot_7/unlock"))[0] == 200
            await expect_never(lambda: b.hub.robots.find_here("robot_7").gate.lock_reason, for_s=0.5)


async def test_local_subscription_interrupts_no_remote_subscriber() -> None:
    async with fleet("a", "b") as (a, b), fake_device(b.tcp, robot_topics("robot_7")) as device:
        await shown(a, "robot_7")
        await expect(lambda: a.hub.topics.find_or_none("/robot_7/odometry"))
        received: list[float] = []
        before = await subscriber_count(b, "/robot_7/odometry")
        subscribe(a.hub, "/robot_7/odometry", lambda _: received.append(0.0))
        await expect(lambda: len(b.hub.topics.find("/robot_7/odometry").subscribers) == before + 1)
        for number in range(10):
            subscription = subscribe(b.hub, "/robot_7/odometry", lambda _: None)
            await device.send(pose(number))
            await asyncio.sleep(0.06)  # the graph's changes are noticed
            subscription.close()
        await expect(lambda: len(received) == 10 or a.was_paused)  # a pause breaks the connection of the daemons


async def test_velocity_topic_of_a_remote_robot_drives_it() -> None:
    async with fleet("a", "b") as (a, b), fake_device(b.tcp, robot_topics("robot_7")) as device, client(a) as program:
        await shown(a, "robot_7")
        await expect(lambda: a.hub.topics.find_or_none("/robot_7/cmd_vel"))
        velocity = {"linear": {"x": 0.2, "y": 0, "z": 0}, "angular": {"x": 0, "y": 0, "z": 0}}
        await program.send(op="publish", topic="/robot_7/cmd_vel", type=TWIST_TYPE, msg=velocity)
        assert await device.velocity_other_than(STILL) == (0.2, 0.0)


async def test_reset_reaches_a_remote_device() -> None:
    async with fleet("a", "b") as (a, b), fake_device(b.tcp, robot_topics("robot_7")) as device:
        await shown(a, "robot_7")
        reset = b.hub.robots.find_here("robot_7").topics.reset
        assert reset is not None
        await expect(lambda: a.hub.topics.find_or_none("/robot_7/reset_odometry"))
        status, _ = await a.rest("POST", "/api/robots/robot_7/odometry/reset")
        assert status == 200
        reset_id = next(info.id for info in robot_topics("robot_7") if info.name == reset)
        assert await device.frame(reset_id) == b""


async def test_one_name_at_two_daemons_is_shown_and_neither_is_driven_from_a_third() -> None:
    async with (
        fleet("a", "b", "c") as (a, b, c),
        fake_device(b.tcp, robot_topics()) as second,
        fake_device(c.tcp, robot_topics()) as third,
    ):
        await shown(a, "robot_0")
        await expect(lambda: a.hub.robots.remote["robot_0"].also_at)
        assert (await robot(a, "robot_0"))["also_at"] == ["c"]
        await expect(lambda: b.hub.robots.find_here("robot_0").also_at)
        assert (await robot(b, "robot_0"))["also_at"] == ["c"]
        status, answer = await drive(a, "robot_0", 0.3)
        assert (status, answer["error"]["kind"]) == (503, "DeviceGone")
        assert "several robots have this name, at b, c" in answer["error"]["reason"]
        assert (await drive(b, "robot_0", 0.2))[0] == 200  # its own programs mean its own
        assert await second.velocity_other_than(STILL) == (0.2, 0.0)
        status, _ = await a.rest("POST", "/api/robots/robot_0/lock")
        assert status == 200
        for host in (b, c):
            assert host.hub.robots.find_here("robot_0").gate.lock_reason is not None
        third.hang_up()
        await expect(lambda: not a.hub.robots.remote["robot_0"].also_at)


async def test_a_daemon_that_ends_takes_its_robots_with_it_and_its_drivers() -> None:
    async with fleet("a") as (a,), contextlib.AsyncExitStack() as stack:
        b = await stack.enter_async_context(joined(port_of(a), "b"))
        async with (
            fake_device(b.tcp, robot_topics("robot_7")),
            fake_device(a.tcp, robot_topics("robot_1")) as own,
        ):
            await shown(a, "robot_7")
            await shown(b, "robot_1")
            await has_met(a, 1)
            b.hub.join("driver").drive(b.hub.robots.find("robot_1"), PlanarVelocity(x_m_s=0.3))
            assert await own.velocity_other_than(STILL) == (0.3, 0.0)
            await stack.aclose()
            assert await own.velocity_other_than((0.3, 0.0)) == STILL
            await expect(lambda: a.hub.robots.remote["robot_7"].link is None, timeout_s=2.0)


def threads() -> int:
    """Return the number of threads of this process, including Zenoh's."""
    return len(list(Path("/proc/self/task").iterdir()))


async def test_robots_that_come_to_a_fleet_take_no_thread_for_each_topic() -> None:
    async with fleet("lab-1", "lab-2") as (here, there), contextlib.AsyncExitStack() as stack:
        before = threads()
        for number in range(ROBOTS):
            await stack.enter_async_context(fake_device(here.tcp, robot_topics(f"robot_{number}")))
        for number in range(ROBOTS):
            await shown(there, f"robot_{number}")
        assert threads() < before + ROBOTS  # six topics each
