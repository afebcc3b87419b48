"""A crash ends what it belongs to: a link, a robot, a participant, a task. Everything else continues."""

import contextlib
import os
import resource
from collections.abc import Iterator
from pathlib import Path

import pytest
from structlog.testing import capture_logs

from hostlink.core.diagnosis.link_monitor import LinkMonitor
from hostlink.core.protocol import events
from hostlink.core.protocol.endpoint import EndpointKind
from hostlink.core.protocol.rosserial.frame import Id, encode
from hostlink.core.robot.velocity import PlanarVelocity
from tests.support.compiled_modules import replaces_a_method
from tests.support.daemon import Daemon, daemon
from tests.support.fake_device import FakeDevice, fake_device, robot_topics, topic
from tests.support.gates import drive_gate
from tests.support.participants import publish
from tests.support.waiting import expect

ZERO = (0.0, 0.0)
CURVE = (0.2, 0.5)
OTHER = "127.0.0.3"


def drive(host: Daemon, name: str) -> None:
    drive_gate(host.hub.robots.find(name), PlanarVelocity(x_m_s=0.2, yaw_rad_s=0.5), owner="test")


async def is_driven(host: Daemon, name: str, device: FakeDevice) -> None:
    drive(host, name)
    assert await device.velocity_other_than(ZERO) == CURVE


async def receives_zero_and_is_cut(device: FakeDevice) -> None:
    assert await device.velocity_other_than(CURVE) == ZERO
    await device.closed()


@pytest.fixture
def logged() -> Iterator[list[dict[str, object]]]:
    with capture_logs() as lines:
        yield lines  # type: ignore[misc]


def crashes(lines: list[dict[str, object]]) -> list[object]:
    return [line["event"] for line in lines if str(line["event"]).endswith(".crashed")]


@pytest.mark.parametrize("error", [MemoryError(), ValueError("a defect"), RecursionError()])
async def test_a_crash_in_a_link_stops_its_robot_and_no_other(
    error: Exception, logged: list[dict[str, object]]
) -> None:
    def crash(*_: object) -> None:
        raise error

    async with (
        daemon() as host,
        fake_device(host.tcp, robot_topics("a")) as one,
        fake_device(host.tcp, robot_topics("b"), local_host=OTHER) as other,
    ):
        await expect(lambda: len([robot for robot in host.hub.robots.all() if robot.link]) == 2)
        await is_driven(host, "a", one)
        host.hub.links._reactions[events.DeviceLogged] = crash
        await one.send(encode(Id.LOG, b"\x01\x02\x00\x00\x00hi"))
        await receives_zero_and_is_cut(one)
        await is_driven(host, "b", other)
    assert crashes(logged) == ["link.crashed"]


@replaces_a_method
async def test_a_crash_in_a_robots_gate_ends_its_link_alone(logged: list[dict[str, object]]) -> None:
    def crash(_: float) -> None:
        raise ArithmeticError("a defect")

    async with (
        daemon() as host,
        fake_device(host.tcp, robot_topics("a")) as one,
        fake_device(host.tcp, robot_topics("b"), local_host=OTHER) as other,
    ):
        await expect(lambda: len([robot for robot in host.hub.robots.all() if robot.link]) == 2)
        await is_driven(host, "a", one)
        await is_driven(host, "b", other)
        host.hub.robots.find("a").gate.step = crash  # type: ignore[method-assign, assignment]
        await receives_zero_and_is_cut(one)
        await is_driven(host, "b", other)
    assert "robot.crashed" in crashes(logged)


@replaces_a_method
async def test_a_crash_in_the_gate_of_a_device_without_poses_leaves_the_clock_of_all_gates(
    logged: list[dict[str, object]],
) -> None:
    cart = [topic(EndpointKind.SUBSCRIBER, 100, "/cart/cmd_vel", "geometry_msgs/Twist")]

    def crash(*_: object, **__: object) -> None:
        raise ArithmeticError("a defect")

    async with (
        daemon() as host,
        fake_device(host.tcp, robot_topics("a"), local_host=OTHER) as robot,
        fake_device(host.tcp, cart),
    ):
        await expect(lambda: host.hub.topics.find("/cart/cmd_vel").devices)
        publish(host.hub, "/cart/cmd_vel", {"linear": {"x": 0.2}}, source="test")
        session = next(link for link in host.hub.links.all() if link.address != OTHER).session
        session.publish = crash  # type: ignore[method-assign]
        await expect(lambda: host.hub.isolation.crashes["robot"] > 0)
        await is_driven(host, "a", robot)
        assert await robot.velocity_other_than(CURVE) == ZERO  # the lease ends by the clock
    assert set(crashes(logged)) == {"robot.crashed"}


async def test_a_crash_of_a_task_or_a_diagnosis_ends_nothing_else(
    logged: list[dict[str, object]], monkeypatch: pytest.MonkeyPatch
) -> None:
    async def work() -> None:
        raise ZeroDivisionError

    def crash(*_: object) -> None:
        raise OSError(24, "Too many open files")

    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device:
        await expect(lambda: host.hub.robots.find("robot_0").link)
        host.hub.spawn(work(), name="some work")
        monkeypatch.setattr(LinkMonitor, "sample", crash)
        await expect(lambda: host.hub.isolation.crashes["diagnosis"] > 0)
        await is_driven(host, "robot_0", device)
    assert {"task.crashed", "diagnosis.crashed"} <= set(crashes(logged))


def _highest_descriptor() -> int:
    """Return the highest descriptor in use: other tests of this process may have opened some."""
    return max(int(each.name) for each in Path("/proc/self/fd").iterdir())


async def test_without_a_free_descriptor_a_sick_device_is_diagnosed_and_a_robot_driven() -> None:
    usual = resource.getrlimit(resource.RLIMIT_NOFILE)
    async with (
        daemon() as host,
        fake_device(host.tcp, robot_topics()) as device,
        fake_device(host.tcp, local_host=OTHER) as silent,
    ):
        await expect(lambda: host.hub.robots.find("robot_0").link)
        opened = []
        resource.setrlimit(resource.RLIMIT_NOFILE, (_highest_descriptor() + 8, usual[1]))
        try:
            with contextlib.suppress(OSError):  # too many open files
                while True:
                    opened.append(os.open("/dev/null", os.O_RDONLY))
            assert opened
            await silent.send(b"nonsense" * 100)
            await expect(lambda: any(host.hub.diagnoses.of(link) for link in host.hub.links.all()))
            await is_driven(host, "robot_0", device)
        finally:
            resource.setrlimit(resource.RLIMIT_NOFILE, usual)
            for descriptor in opened:
                os.close(descriptor)
        assert not host.hub.isolation.crashes


async def test_a_link_that_is_replaced_leaves_a_standing_robot() -> None:
    """The robot is stopped also if the device has no watchdog."""
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device:
        await expect(lambda: host.hub.robots.find("robot_0").link)
        await is_driven(host, "robot_0", device)
        async with fake_device(host.tcp, robot_topics()):
            await receives_zero_and_is_cut(device)
