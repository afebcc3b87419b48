"""Odometry on a running daemon: devices that restart, lose their connection, or are reset."""

import time
from typing import Any

import pytest

from hostlink.core.config import CalibrationConfig, Config, RobotConfig
from hostlink.core.protocol.endpoint import EndpointKind
from hostlink.core.protocol.rosserial.frame import encode
from tests.support.daemon import Daemon, daemon
from tests.support.fake_device import CATALOG, FakeDevice, fake_device, pose, robot_topics, topic
from tests.support.rosbridge import Client, client
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


async def test_odometry_of_a_device_that_restarted_begins_anew_if_configured() -> None:
    config = Config(robots={"robot_0": RobotConfig(odometry_after_restart="restart")})
    async with daemon(config) as host:
        async with fake_device(host.tcp, robot_topics()) as device:
            assert (await publish_pose(host, device, 1.5))["restarts"] == 0
        await gone(host)
        async with fake_device(host.tcp, robot_topics()) as device:
            await publish_pose(host, device, 0.0)
            shown = await publish_pose(host, device, 0.25)
    assert (shown["pose"]["x_m"], shown["restarts"]) == (0.25, 1)


async def test_requested_reset_is_at_the_origin_and_not_a_restart() -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device:
        await publish_pose(host, device, 1.5)
        assert (await host.rest("POST", "/api/robots/robot_0/odometry/reset"))[0] == 200
        assert await device.frame(101) == b""
        shown = await publish_pose(host, device, 0.0)
    assert (shown["pose"]["x_m"], shown["restarts"]) == (0.0, 0)


async def test_a_header_stamp_becomes_host_time_and_the_link_reports_its_clock() -> None:
    """The device's clock is an hour behind; its third message was held up for half a second on its way."""
    odometry = topic(EndpointKind.PUBLISHER, 125, "/robot_0/odometry", "nav_msgs/Odometry")
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


async def test_a_calibrated_robot_is_shown_where_it_is_and_its_own_topic_stays() -> None:
    """A wheel separation that is 5 % larger than the device's, and a left wheel that is 1 % larger."""
    calibration = CalibrationConfig(left_factor=1.01, nominal_separation_m=0.2, separation_m=0.21)
    config = Config(robots={"robot_0": RobotConfig(calibration=calibration)})
    async with daemon(config) as host, fake_device(host.tcp, robot_topics()) as device, client(host) as program:
        await program.send(op="subscribe", topic="/robot_0/odometry", id="own")
        await program.send(op="subscribe", topic="/robot_0/odom", id="shown")
        await program.call("/rosapi/get_time")  # both are subscribed
        await publish_pose(host, device, 0.0)
        turned = await publish_pose(host, device, 0.0, theta=0.1)  # both wheels rolled 1 cm, the left one backwards
        ahead = await publish_pose(host, device, 0.1, 0.0, 0.1)
        own = [message["msg"] for message in await published(program, 6) if message["topic"] == "/robot_0/odometry"]
    assert turned["pose"]["theta_rad"] == pytest.approx((0.01 + 0.0101) / 0.21)
    assert turned["pose"]["x_m"] == pytest.approx(-0.00005, abs=1e-6)
    assert ahead["pose"]["x_m"] > 0.0995
    assert [message["theta"] for message in own] == [0.0, 0.1, 0.1]
    assert [message["x"] for message in own] == [0.0, 0.0, 0.1]


async def published(program: Client, count: int) -> list[dict[str, Any]]:
    """The next messages of topics."""
    found: list[dict[str, Any]] = []
    while len(found) < count:
        message = await program.receive()
        if message["op"] == "publish":
            found.append(message)
    return found


async def test_another_robot_of_the_same_name_is_not_calibrated() -> None:
    calibration = CalibrationConfig(left_factor=1.5)
    config = Config(robots={"robot_0": RobotConfig(address="192.0.2.1", calibration=calibration)})
    async with daemon(config) as host, fake_device(host.tcp, robot_topics()) as device:
        (robot,) = (robot for robot in host.hub.robots.all() if robot.link is not None)
        for number in range(2):
            await device.send(pose(0.05 * number, 0.0, 0.0))
            await expect(lambda count=number + 1: robot.odometry.count == count)
        shown = robot.odometry.snapshot(0.0)
    assert shown is not None
    assert shown.pose.x_m == 0.05
