"""Odometry on a running daemon: devices that restart, lose their connection, or are reset."""

import time
from typing import Any

import pytest

from hostlink.config import Config, RobotConfig
from hostlink.protocol.frame import Id, encode
from tests.support.daemon import Daemon, daemon
from tests.support.fake_device import CATALOG, FakeDevice, fake_device, pose, robot_topics, topic
from tests.support.rosbridge import client
from tests.support.waiting import expect


async def publish_pose(
    host: Daemon, device: FakeDevice, x: float, y: float = 0.0, theta: float = 0.0
) -> dict[str, Any]:
    """The device tells a pose; returns what hostlink makes of it."""
    odometry = host.hub.robots.find("robot_0").odometry
    count = odometry.count
    await device.send(pose(x, y, theta))
    await expect(lambda: odometry.count > count)
    shown: dict[str, Any] = await host.get("/api/robots/robot_0/odometry")
    return shown


async def gone(host: Daemon) -> None:
    await expect(lambda: host.hub.robots.find("robot_0").link is None)


@pytest.mark.parametrize(("mode", "x_m"), [("continue", 1.75), ("restart", 0.25)])
async def test_a_device_that_comes_back_at_the_origin(mode: Any, x_m: float) -> None:
    config = Config(robots={"robot_0": RobotConfig(odometry_after_restart=mode)})
    async with daemon(config) as host:
        async with fake_device(host.tcp, robot_topics()) as device:
            assert (await publish_pose(host, device, 1.5))["restarts"] == 0
        await gone(host)
        async with fake_device(host.tcp, robot_topics()) as device:
            await publish_pose(host, device, 0.0)
            shown = await publish_pose(host, device, 0.25)
    assert (shown["pose"]["x_m"], shown["restarts"]) == (x_m, 1)


async def test_a_device_that_lost_only_its_connection_counts_on() -> None:
    async with daemon() as host:
        async with fake_device(host.tcp, robot_topics()) as device:
            await publish_pose(host, device, 1.5)
        await gone(host)
        async with fake_device(host.tcp, robot_topics()) as device:
            shown = await publish_pose(host, device, 1.52)
    assert (shown["pose"]["x_m"], shown["restarts"]) == (1.52, 0)


@pytest.mark.parametrize("way", ["rest", "rosbridge"])
async def test_a_reset_by_somebody_is_at_the_origin_and_no_restart(way: str) -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device, client(host) as program:
        await publish_pose(host, device, 1.5)
        if way == "rest":
            assert (await host.rest("POST", "/api/robots/robot_0/odometry/reset"))[0] == 200
        else:
            await program.send(op="publish", topic="/robot_0/reset_odometry", msg={})
        assert await device.frame(101) == b""
        shown = await publish_pose(host, device, 0.0)
    assert (shown["pose"]["x_m"], shown["restarts"]) == (0.0, 0)


async def test_a_header_stamp_becomes_host_time_and_the_link_reports_its_clock() -> None:
    """The device's clock is an hour behind; its third message was held up for half a second on its way."""
    odometry = topic(Id.PUBLISHER, 125, "/robot_0/odometry", "nav_msgs/Odometry")
    type_ = CATALOG.message("nav_msgs/Odometry")
    assert type_ is not None
    async with daemon() as host, fake_device(host.tcp, [odometry, robot_topics()[1]]) as device:
        robot = host.hub.robots.find("robot_0")
        stamps = []
        for number, late_ns in enumerate([0, 0, 500_000_000]):
            stamp_ns = time.time_ns() - 3600 * 10**9 - late_ns
            secs, nsecs = divmod(stamp_ns, 10**9)
            message = {"header": {"stamp": {"secs": secs, "nsecs": nsecs}}, "pose": {}}
            await device.send(encode(125, type_.encode(message)))
            await expect(lambda count=number + 1: robot.odometry.count == count)
            stamps.append((await host.get("/api/robots/robot_0/odometry"))["stamp_ns"])
        clock = (await host.get("/api/links"))["links"][0]["clock"]
        metrics = await (await host.session.get(host.url + "/metrics")).text()
    assert clock["offset_s"] == pytest.approx(3600, abs=0.3)
    assert clock["drift_ppm"] is None
    assert 0 < clock["round_trip_s"] < 1
    assert 0 < clock["answer_s"] < 2
    assert stamps == sorted(stamps)
    assert stamps[2] == pytest.approx(time.time_ns() - 500_000_000, abs=480_000_000)
    assert 'hostlink_link_clock_offset_seconds{peer="127.0.0.1",robot="robot_0"} 3600.' in metrics
    assert "hostlink_link_round_trip_seconds{" in metrics
