"""A device that subscribes to a Twist and publishes no pose, or a second Twist of a robot: each has a gate, too."""

import asyncio
import contextlib
import struct
from collections.abc import Awaitable, Callable
from typing import NamedTuple

import pytest
from structlog.testing import capture_logs

from hostlink.cli import garbage
from hostlink.core.config import Config, RobotConfig
from hostlink.core.hub.hub import Hub
from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind
from hostlink.core.protocol.rosserial.frame import Id
from hostlink.core.robot.admission import LEASE_S
from hostlink.core.robot.velocity import PlanarVelocity
from hostlink.errors import CommandRefused
from tests.support.fake_device import CATALOG, robot_topics, topic
from tests.support.participants import (
    NEIGHBOUR,
    ODOMETRY_ID,
    ROBOT,
    VELOCITY_ID,
    Scene,
    play,
    publish,
    source_of,
)
from tests.support.ros_lib_device import running_hub
from tests.support.scripted_device import ScriptedDevice
from tests.support.virtual_loop import run_virtual

ZERO = bytes(48)
SPEED = struct.pack("<d", 0.77)
NO_POSE = [topic(EndpointKind.SUBSCRIBER, 100, "/cart/cmd_vel", "geometry_msgs/Twist")]
SECOND = [*robot_topics(), topic(EndpointKind.SUBSCRIBER, 102, "/robot_0/arm_vel", "geometry_msgs/Twist")]
VELOCITY, ARM, ARM_ID = "/robot_0/velocity_commands", "/robot_0/arm_vel", 102


def twist(speed_m_s: float) -> bytes:
    return struct.pack("<6d", speed_m_s, 0, 0, 0, 0, 0)


class Arm(NamedTuple):
    """A hub, and the robot that has an arm."""

    hub: Hub
    device: ScriptedDevice


def play_arm(test: Callable[[Arm], Awaitable[None]]) -> None:
    async def run(made: Scene) -> None:
        made.robot.infos = SECOND
        await made.robot.announce()
        await asyncio.sleep(0.5)
        await test(Arm(made.hub, made.robot))

    play(run)


class Collector(NamedTuple):
    """The garbage collector of a process that always has enough to collect."""

    note: Callable[[], None]  # called for each collection

    def get_count(self) -> tuple[int, int, int]:
        return 0, 0, garbage.ENOUGH

    def collect(self) -> int:
        self.note()
        return 0

    def freeze(self) -> None: ...

    def unfreeze(self) -> None: ...


class Twisted(NamedTuple):
    """A hub, and a device whose velocity topic is not that of a robot's base."""

    hub: Hub
    device: ScriptedDevice
    name: str
    topic_id: int

    def heard(self) -> list[bytes]:
        """Return what the device received on the topic."""
        return self.device.payloads(self.topic_id)

    async def drive(self, source: str = "test") -> None:
        publish(self.hub, self.name, twist(0.3), source=source)
        await asyncio.sleep(0.05)
        assert self.heard()[-1] == twist(0.3)

    async def stands(self) -> None:
        """The device receives a zero within the time of a frame, and nothing but zeros for a second."""
        await asyncio.sleep(0.05)
        before = len(self.heard())
        assert self.heard()[-1] == ZERO
        await asyncio.sleep(1.0)
        assert set(self.heard()[before:]) <= {ZERO}


def play_twisted(infos: list[DeviceEndpoint], test: Callable[[Twisted], Awaitable[None]]) -> None:
    """Run the test with a hub and a device that has these topics; the last one is the velocity topic."""

    async def run() -> None:
        async with running_hub(Hub(Config(), CATALOG, reraises=True)) as hub:
            device = ScriptedDevice(hub, infos, address="10.0.0.1")
            await asyncio.sleep(0.5)
            await test(Twisted(hub, device, infos[-1].name, infos[-1].id))
            await device.aclose()

    with capture_logs():
        run_virtual(run())


BOTH = pytest.mark.parametrize("infos", [NO_POSE, SECOND], ids=["no pose", "second topic"])


@BOTH
class TestBoth:
    def test_driver_that_is_silent_for_a_lease_leaves_the_device_standing(self, infos: list[DeviceEndpoint]) -> None:
        async def test(made: Twisted) -> None:
            await made.drive()
            await asyncio.sleep(LEASE_S)
            await made.stands()

        play_twisted(infos, test)

    def test_driver_that_leaves_stops_the_device_at_once(self, infos: list[DeviceEndpoint]) -> None:
        async def test(made: Twisted) -> None:
            await made.drive()
            source_of(made.hub, "test").leave()
            await made.stands()

        play_twisted(infos, test)

    def test_garbage_is_not_collected_while_the_device_moves(
        self, infos: list[DeviceEndpoint], monkeypatch: pytest.MonkeyPatch
    ) -> None:
        async def test(made: Twisted) -> None:
            collections = list[float]()
            now_s = asyncio.get_running_loop().time
            monkeypatch.setattr(garbage, "gc", Collector(lambda: collections.append(now_s())))
            collecting = asyncio.get_running_loop().create_task(garbage.collect_while_idle(made.hub.robots))
            for _ in range(10):
                await made.drive()
                await asyncio.sleep(LEASE_S - 0.1)
            assert collections == []
            await asyncio.sleep(3.0)
            assert collections
            collecting.cancel()

        play_twisted(infos, test)

    def test_stop_of_all_stops_the_device(self, infos: list[DeviceEndpoint]) -> None:
        async def test(made: Twisted) -> None:
            await made.drive()
            made.hub.robots.stop_all()
            await made.stands()

        play_twisted(infos, test)

    def test_end_of_the_daemon_sends_a_zero_before_its_stop(self, infos: list[DeviceEndpoint]) -> None:
        async def test(made: Twisted) -> None:
            await made.drive()
            before = len(made.device.heard)
            await made.hub.shutdown()
            frames = [frame for _, frame in made.device.heard[before:]]
            stop = [frame.topic_id for frame in frames].index(Id.STOP)
            velocities = {frame.payload for frame in frames[:stop] if frame.topic_id == made.topic_id}
            assert velocities == {ZERO}

        play_twisted(infos, test)

    def test_link_that_the_daemon_ends_leaves_the_device_standing(self, infos: list[DeviceEndpoint]) -> None:
        async def test(made: Twisted) -> None:
            await made.drive()
            made.device.link.received_at_s -= 60.0
            made.device.link.wake()
            await asyncio.sleep(0.5)
            assert made.heard()[-1] == ZERO
            assert made.device.link not in made.hub.links.all()

        play_twisted(infos, test)


def test_locked_robot_is_locked_on_its_second_topic() -> None:
    async def test(made: Twisted) -> None:
        await made.drive()
        made.hub.robots.find("robot_0").lock("smoke")
        await made.stands()
        with pytest.raises(CommandRefused, match="locked"):
            publish(made.hub, made.name, twist(0.3))
        await made.stands()

    play_twisted(SECOND, test)


def test_lock_applies_to_a_second_topic_that_appears_later_and_ends_with_the_unlock() -> None:
    async def test(made: Scene) -> None:
        robot = made.hub.robots.find(ROBOT)
        robot.lock("smoke")
        made.robot.infos = SECOND
        await made.robot.announce()
        await asyncio.sleep(0.5)
        with pytest.raises(CommandRefused, match="locked"):
            publish(made.hub, ARM, twist(0.3))
        robot.unlock()
        publish(made.hub, ARM, ZERO)  # a stream that a lock interrupted begins with a zero
        publish(made.hub, ARM, twist(0.3))
        await asyncio.sleep(0.1)
        assert made.robot.payloads(ARM_ID)[-1] == twist(0.3)

    play(test)


def test_twist_of_a_topic_without_a_name_of_a_velocity_is_sent_once_and_unchanged() -> None:
    plain = [topic(EndpointKind.SUBSCRIBER, 100, "/show/target", "geometry_msgs/Twist")]

    async def test(made: Scene) -> None:
        device = ScriptedDevice(made.hub, plain, address="10.0.0.3")
        await asyncio.sleep(0.5)
        publish(made.hub, "/show/target", twist(0.3))
        await asyncio.sleep(2 * LEASE_S)
        assert device.payloads(100) == [twist(0.3)]
        await device.aclose()
        await asyncio.sleep(0.5)

    play(test)


def test_second_velocity_of_a_robot_has_the_robots_limits_and_another_device_its_own() -> None:
    async def run() -> tuple[bytes, bytes]:
        hub = Hub(Config(robots={"robot_0": RobotConfig(max_linear_m_s=0.25)}), CATALOG)
        async with running_hub(hub):
            robot = ScriptedDevice(hub, SECOND, address="10.0.0.1")
            cart = ScriptedDevice(hub, NO_POSE, address="10.0.0.3")
            await asyncio.sleep(0.5)
            for name in (ARM, "/cart/cmd_vel"):
                publish(hub, name, twist(30.0))
            await asyncio.sleep(0.1)
            for device in (robot, cart):
                await device.aclose()
        return robot.payloads(ARM_ID)[-1], cart.payloads(100)[-1]

    with capture_logs():
        assert run_virtual(run()) == (twist(0.25), twist(1.0))


def test_commands_of_a_device_before_its_identification_are_not_obeyed_later() -> None:
    async def test(made: Scene) -> None:
        drives = topic(EndpointKind.PUBLISHER, 126, f"/{NEIGHBOUR}/velocity_commands", "geometry_msgs/Twist")
        made.robot.task.cancel()  # it answers nothing: whether the new one is the same takes time to find out
        for _ in range(5):
            await made.robot.send(ODOMETRY_ID, bytes(24))
            await asyncio.sleep(0.1)
        made.hub.join("driver").drive(made.hub.robots.find(ROBOT), PlanarVelocity(0.2))
        device = ScriptedDevice(made.hub, [*robot_topics(ROBOT), drives], address="10.0.0.1")
        await asyncio.sleep(0.1)
        early = made.hub.robots.devices[device.link.number].early
        sent_at_s = asyncio.get_running_loop().time()
        await device.send(126, SPEED + bytes(40))
        for _ in range(10):
            await asyncio.sleep(0.1)
            await device.send(ODOMETRY_ID, bytes(24))
        assert len(early) == 0
        twists = [(at_s, f.payload) for at_s, f in made.other.heard if f.topic_id == VELOCITY_ID]
        assert not [at_s for at_s, twist in twists if twist[:8] == SPEED and at_s > sent_at_s + LEASE_S]

    play(test)


def test_no_gate_of_a_locked_robots_second_topic_outlives_its_link() -> None:
    async def test(made: Scene) -> None:
        infos = [
            *robot_topics("robot_2"),
            topic(EndpointKind.SUBSCRIBER, 102, "/robot_2/arm_vel", "geometry_msgs/Twist"),
        ]
        for visit in range(5):
            device = ScriptedDevice(made.hub, infos, address="10.0.0.3")
            await asyncio.sleep(0.5)
            robot = made.hub.robots.find("robot_2")
            if visit == 0:
                robot.lock()
            assert device.link in {each.link for each in made.hub.gates._active}  # it hears its zero again and again
            await device.aclose()
            await asyncio.sleep(0.5)
        assert robot not in made.hub.gates._active
        robot.unlock()
        assert [each.name for each in made.hub.gates._active if each.link is None] == []

    play(test)


class TestOneRobot:
    """Several velocity topics of one robot, as a base and an arm: one robot, for who is more important."""

    def test_driver_of_higher_priority_stops_other_drivers_at_once(self) -> None:
        async def test(made: Arm) -> None:
            person, script = made.hub.join("person", priority=60), made.hub.join("script")
            for driven, other, other_id in ((VELOCITY, ARM, ARM_ID), (ARM, VELOCITY, VELOCITY_ID)):
                script.publish(other, twist(0.3))
                await asyncio.sleep(0.1)
                assert made.device.payloads(other_id)[-1] == twist(0.3)
                person.publish(driven, twist(0.2))
                await asyncio.sleep(0.05)
                assert made.device.payloads(other_id)[-1] == ZERO
                with pytest.raises(CommandRefused):
                    script.publish(other, twist(0.3))
                await asyncio.sleep(2 * LEASE_S)

        play_arm(test)

    def test_one_driver_drives_both_and_two_of_one_priority_one_each(self) -> None:
        async def test(made: Arm) -> None:
            base, arm = made.hub.join("base"), made.hub.join("arm")
            for first, second in ((base, base), (base, arm)):
                base.publish(ARM, ZERO)  # it keeps the arm until it lets go of it
                for _ in range(3):
                    first.publish(VELOCITY, twist(0.1))
                    second.publish(ARM, twist(0.2))
                    await asyncio.sleep(0.2)
                    assert made.device.payloads(VELOCITY_ID)[-1] == twist(0.1)
                    assert made.device.payloads(ARM_ID)[-1] == twist(0.2)
            arm.leave()
            await asyncio.sleep(0.05)
            assert made.device.payloads(VELOCITY_ID)[-1] == twist(0.1)
            assert made.device.payloads(ARM_ID)[-1] == ZERO

        play_arm(test)

    def test_take_over_of_one_topic_stops_the_others_that_its_driver_drives_at_once(self) -> None:
        async def test(made: Arm) -> None:
            script, other = made.hub.join("script"), made.hub.join("other")
            robot = made.hub.robots.find(ROBOT)
            script.publish(VELOCITY, twist(0.1))
            script.publish(ARM, twist(0.3))
            await asyncio.sleep(0.1)
            assert made.device.payloads(ARM_ID)[-1] == twist(0.3)
            other.drive(robot, PlanarVelocity(-0.2), take_over=True)
            await asyncio.sleep(0.05)
            assert made.device.payloads(VELOCITY_ID)[-1] == twist(-0.2)
            assert made.device.payloads(ARM_ID)[-1] == ZERO
            for name in (ARM, VELOCITY):
                with pytest.raises(CommandRefused, match="other"):
                    script.publish(name, twist(0.3))

        play_arm(test)

    def test_one_drivers_own_priorities_do_not_overrule_each_other(self) -> None:
        async def test(made: Arm) -> None:
            driver, script = made.hub.join("driver"), made.hub.join("script")
            for _ in range(3):
                driver.publish(ARM, twist(0.2), priority=40)
                driver.publish(VELOCITY, twist(0.1), priority=60)
                await asyncio.sleep(0.2)
                assert made.device.payloads(VELOCITY_ID)[-1] == twist(0.1)
                assert made.device.payloads(ARM_ID)[-1] == twist(0.2)
                driver.publish(ARM, ZERO, priority=40)  # what it claims by the other topic stays
                with pytest.raises(CommandRefused):
                    script.publish(ARM, twist(0.3))

        play_arm(test)

    def test_zero_of_higher_priority_claims_nothing(self) -> None:
        async def test(made: Arm) -> None:
            person, script = made.hub.join("person", priority=60), made.hub.join("script")
            script.publish(ARM, twist(0.3))
            person.publish(VELOCITY, ZERO)
            script.publish(ARM, twist(0.3))
            await asyncio.sleep(0.1)
            assert made.device.payloads(ARM_ID)[-1] == twist(0.3)

        play_arm(test)

    def test_another_robots_priorities_are_its_own(self) -> None:
        async def test(made: Arm) -> None:
            person, script = made.hub.join("person", priority=60), made.hub.join("script")
            person.publish(ARM, twist(0.2))
            script.drive(made.hub.robots.find(NEIGHBOUR), PlanarVelocity(0.3))
            script.leave()

        play_arm(test)

    def test_velocity_topics_of_a_device_without_pose_are_those_of_one_robot(self) -> None:
        async def test(made: Scene) -> None:
            infos = [*NO_POSE, topic(EndpointKind.SUBSCRIBER, 102, "/crane/cmd_vel", "geometry_msgs/Twist")]
            device = ScriptedDevice(made.hub, infos, address="10.0.0.3")
            await asyncio.sleep(0.5)
            person, script = made.hub.join("person", priority=60), made.hub.join("script")
            person.publish("/cart/cmd_vel", twist(0.2))
            with pytest.raises(CommandRefused, match="person"):
                script.publish("/crane/cmd_vel", twist(0.3))
            await asyncio.sleep(0.1)
            assert (device.payloads(100)[-1], device.payloads(102)[-1]) == (twist(0.2), twist(0.0))
            await device.aclose()
            await asyncio.sleep(0.5)

        play(test)


@pytest.mark.parametrize("infos", [NO_POSE, SECOND], ids=["no pose", "second topic"])
@pytest.mark.parametrize("is_known", [False, True])
def test_stream_that_begins_without_the_device_drives_after_a_lease_of_silence(
    infos: list[DeviceEndpoint], *, is_known: bool
) -> None:
    async def test(made: Scene) -> None:
        name, topic_id = infos[-1].name, infos[-1].id
        await made.robot.aclose()
        if is_known:
            before = ScriptedDevice(made.hub, infos, address="10.0.0.1")
            await asyncio.sleep(0.5)
            await before.aclose()
        source_of(made.hub, "test").advertise(name, "geometry_msgs/Twist")

        async def stream() -> None:
            while True:
                with contextlib.suppress(CommandRefused):
                    publish(made.hub, name, twist(0.3))
                await asyncio.sleep(0.1)

        streaming = made.tasks.create_task(stream())
        await asyncio.sleep(2 * LEASE_S)
        device = made.robot = ScriptedDevice(made.hub, infos, address="10.0.0.1")
        await asyncio.sleep(2.0)
        assert not any(map(any, device.payloads(topic_id)))
        streaming.cancel()
        await asyncio.sleep(LEASE_S + 0.1)
        publish(made.hub, name, twist(0.3))
        await asyncio.sleep(0.1)
        assert device.payloads(topic_id)[-1] == twist(0.3)

    play(test)
