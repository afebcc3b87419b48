"""A board that may be a robot which is away: the robot's stop and lock hold for it."""

import asyncio
import struct

import pytest

from hostlink.core.config import Config, RobotConfig, WheelsConfig
from hostlink.core.hub.reloader import places_of
from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind
from hostlink.core.robot.velocity import TWIST_TYPE, PlanarVelocity
from hostlink.errors import CommandRefused, RefusalKind, ReloadRefused, UnknownTopic
from tests.support.fake_device import robot_topics, topic
from tests.support.memory_hub import SETTLED_S, MemoryHub, in_hub
from tests.support.participants import publish

INT16, POSE = "std_msgs/Int16", "geometry_msgs/Pose2D"
LEFT, RIGHT, COMMAND = 110, 111, 100  # ids of topics
NUMBER, ZERO = struct.pack("<h", 50), bytes(2)
HERE, OTHER = "10.0.0.2", "10.0.0.3"


def motors(*names: str) -> list[DeviceEndpoint]:
    return [topic(EndpointKind.SUBSCRIBER, LEFT + at, name, INT16) for at, name in enumerate(names)]


def commanded(name: str, type_name: str = TWIST_TYPE) -> list[DeviceEndpoint]:
    return [topic(EndpointKind.SUBSCRIBER, COMMAND, name, type_name)]


def car(*topics: str) -> Config:
    return Config(robots={"car": RobotConfig(address=HERE, wheels=WheelsConfig(topics=topics, unit="pwm"))})


def is_refused(made: MemoryHub, name: str) -> bool:
    """Whether the lock of car refuses a number for this topic."""
    try:
        publish(made.hub, name, NUMBER, type_name=INT16)
    except CommandRefused as refused:
        return str(refused) == f"{name}: locked: a foot; to drive it again: hostlink unlock car"
    return False


@pytest.mark.parametrize("is_locked_before", [True, False])
def test_lock_of_a_robot_holds_for_a_board_at_its_address_that_lacks_its_command(*, is_locked_before: bool) -> None:
    """The settings have a wrong name."""

    async def test(made: MemoryHub) -> None:
        if is_locked_before:
            made.hub.robots.find_to_stop("car").lock("a foot")
        device = await made.connect(motors("left_motor", "right_motor"))
        if not is_locked_before:
            assert not is_refused(made, "/left_motor")
            made.hub.robots.find_to_stop("car").lock("a foot")
        await asyncio.sleep(SETTLED_S)
        robot = made.robot("car")
        assert is_refused(made, "/left_motor")
        assert [(each.topic, each.is_locked, each.reason) for each in robot.unguarded_endpoints] == [
            ("/left_motor", True, ""),
            ("/right_motor", True, ""),
        ]
        assert (device.payloads(LEFT)[-1], device.payloads(RIGHT)) == (ZERO, [ZERO])
        assert robot.why_unknown() == f"{device.link.peer}, which may be its device, takes no velocity of it"
        robot.unlock()
        assert not is_refused(made, "/left_motor")

    in_hub(test, car("left_moter", "right_moter"))


def test_stop_of_a_robot_reaches_a_board_at_its_address_that_lacks_its_command() -> None:
    async def test(made: MemoryHub) -> None:
        device = await made.connect(motors("left_motor"))
        made.hub.robots.find_to_stop("car").stop()
        await asyncio.sleep(SETTLED_S)
        assert device.payloads(LEFT) == [ZERO]
        assert not is_refused(made, "/left_motor")

    in_hub(test, car("left_moter", "right_moter"))


def test_lock_of_an_arm_refuses_the_topics_that_its_settings_lock() -> None:
    async def test(made: MemoryHub) -> None:
        await made.connect(motors("lifter/stepper"))
        made.hub.robots.find_to_stop("car").lock("a foot")
        assert is_refused(made, "/lifter/stepper")

    in_hub(test, Config(robots={"car": RobotConfig(address=HERE, locked_topics=("lifter/stepper",))}))


def test_lock_holds_for_a_board_that_reconnects_with_a_part_of_its_topics() -> None:
    async def test(made: MemoryHub) -> None:
        device = await made.connect(motors("left_motor", "right_motor"))
        made.robot("car").lock("a foot")
        await device.aclose()
        await asyncio.sleep(SETTLED_S)
        device = await made.connect(motors("left_motor"))
        assert is_refused(made, "/left_motor")
        assert device.payloads(LEFT) == [ZERO]
        whole = await made.connect(motors("left_motor", "right_motor"))
        await asyncio.sleep(1.0)
        assert made.robot("car").link is whole.link
        assert made.robot("car").parts == ()

    in_hub(test, car("left_motor", "right_motor"))


def test_board_at_the_address_of_a_robot_that_is_there_is_not_the_robot() -> None:
    async def test(made: MemoryHub) -> None:
        robot = await made.connect(motors("left_motor", "right_motor"))
        other = await made.connect(motors("lift_speed"))
        made.robot("car").lock("a foot")
        assert not is_refused(made, "/lift_speed")
        await robot.aclose()
        await asyncio.sleep(SETTLED_S)
        assert is_refused(made, "/lift_speed")
        assert other.payloads(LEFT)[-1] == ZERO

    in_hub(test, car("left_motor", "right_motor"))


LOCKED = [*commanded("a/b/cmd_vel"), topic(EndpointKind.PUBLISHER, 125, "a/odom", POSE)]


@pytest.mark.parametrize("is_same_link", [True, False])
@pytest.mark.parametrize(
    ("first", "then", "name"),
    [
        (LOCKED, commanded("a/b/cmd_vel"), "a_b"),
        (robot_topics("robot_0"), commanded("rover_cmd", "ackermann_msgs/AckermannDrive"), "rover"),
        (robot_topics("robot_0"), commanded("base/cmd_vel"), "base"),
    ],
)
def test_lock_holds_for_a_robot_whose_board_has_other_topics_now(
    *, first: list[DeviceEndpoint], then: list[DeviceEndpoint], name: str, is_same_link: bool
) -> None:
    async def test(made: MemoryHub) -> None:
        device = await made.connect(first)
        (locked,) = made.hub.robots.here()
        locked.lock("a foot")
        if not is_same_link:
            await device.aclose()
            await asyncio.sleep(SETTLED_S)
            device = await made.connect(then)
        else:
            device.infos = then
            await device.announce()
            await device.announce()
        await asyncio.sleep(1.0)
        assert made.robot(name).gate.lock_reason == f"it may be {locked.name}: a foot"

    in_hub(test)


def test_lock_does_not_hold_for_another_robot_of_its_address_or_at_another_one() -> None:
    async def test(made: MemoryHub) -> None:
        device = await made.connect(robot_topics("a"))
        await made.connect(robot_topics("b"))
        made.robot("a").lock("a foot")
        await device.aclose()
        await asyncio.sleep(SETTLED_S)
        await made.connect(robot_topics("c"))
        await made.connect(robot_topics("d"), address=OTHER)
        assert {name: made.robot(name).gate.lock_reason for name in "bcd"} == dict.fromkeys("bcd")

    in_hub(test)


@pytest.mark.parametrize("is_robot_of_several", [True, False])
def test_reload_frees_no_board_from_the_lock_of_its_robot(*, is_robot_of_several: bool) -> None:
    places = {"devices": (HERE, OTHER)} if is_robot_of_several else {"address": HERE}
    config = Config(
        robots={"car": RobotConfig(wheels=WheelsConfig(topics=("left_moter", "right_moter"), unit="pwm"), **places)}
    )

    async def test(made: MemoryHub) -> None:
        await made.connect(motors("left_motor"))
        made.hub.robots.find_to_stop("car").lock("a foot")
        with pytest.raises(ReloadRefused, match=r"^car is locked: unlock it before 10\.0\.0\.2 leaves it$"):
            made.hub.links.check(places_of(Config()))
        made.hub.links.check(places_of(config))
        made.robot("car").unlock()
        made.hub.links.check(places_of(Config()))

    in_hub(test, config)


def test_stop_of_all_stops_a_robot_when_another_board_takes_no_zero() -> None:
    """A board that has begun anew refuses its topics until it announces them."""

    async def test(made: MemoryHub) -> None:
        robot, device = await made.connect(robot_topics("a")), await made.connect(motors("left_motor"), address=OTHER)

        def refuse(*_: object, **__: object) -> None:
            raise UnknownTopic("topic", "left_motor", [])

        device.link.session.publish = refuse  # type: ignore[method-assign]
        made.hub.join("driver").drive(made.robot("a"), PlanarVelocity(0.2))
        await asyncio.sleep(0.2)
        made.hub.robots.stop_all()
        await asyncio.sleep(SETTLED_S)
        assert robot.payloads(COMMAND)[-1] == bytes(48)
        made.robot("a").lock("a foot")
        made.hub.robots.lock_all("a foot")
        await asyncio.sleep(2.0)  # repeated zeros are refused as well
        assert made.hub.isolation.crashes == {}

    in_hub(test)


def test_neighbour_of_a_locked_robot_is_not_locked_when_it_reconnects() -> None:
    async def test(made: MemoryHub) -> None:
        locked, other = await made.connect(robot_topics("a")), await made.connect(robot_topics("b"))
        made.robot("a").lock("a foot")
        await locked.aclose()
        await other.aclose()
        await asyncio.sleep(1.0)
        await made.connect(robot_topics("b"))
        assert made.robot("b").gate.lock_reason is None

    in_hub(test)


def test_lock_holds_on_one_connection_for_another_robot_of_the_settings() -> None:
    async def test(made: MemoryHub) -> None:
        device = await made.connect(LOCKED)
        (locked,) = made.hub.robots.here()
        locked.lock("a foot")
        device.infos = commanded("a/b/cmd_vel")
        await device.announce()
        await device.announce()
        await asyncio.sleep(1.0)
        (driven,) = [robot for robot in made.hub.robots.here() if robot.link is not None]
        assert driven.gate.lock_reason in ("a foot", f"it may be {locked.name}: a foot")

    in_hub(test, Config(robots={name: RobotConfig(address=HERE) for name in ("car1", "car2")}))


def test_lock_holds_for_what_is_left_when_a_robot_loses_its_command_on_one_connection() -> None:
    motor = topic(EndpointKind.SUBSCRIBER, LEFT, "/car/arm_motor_pwm", INT16)

    async def test(made: MemoryHub) -> None:
        device = await made.connect([*commanded("/car/cmd_vel"), motor])
        made.robot("car").lock("a foot")
        device.infos = [motor]
        await device.announce()
        await device.announce()
        await asyncio.sleep(1.0)
        assert made.robot("car").link is None
        assert is_refused(made, "/car/arm_motor_pwm")

    in_hub(test)


def test_lock_holds_for_a_board_whose_settings_are_refused() -> None:
    """A number of 8 bits without a sign takes no velocity back."""
    infos = [
        topic(EndpointKind.SUBSCRIBER, LEFT + at, f"{side}_motor", "std_msgs/UInt8") for at, side in enumerate("lr")
    ]

    async def test(made: MemoryHub) -> None:
        await made.connect(infos)
        assert made.hub.robots.here() == []
        made.hub.robots.find_to_stop("car").lock("a foot")
        with pytest.raises(CommandRefused, match="locked: a foot"):
            publish(made.hub, "/l_motor", b"\1", type_name="std_msgs/UInt8")

    in_hub(test, car("l_motor", "r_motor"))


def test_unlock_of_one_robot_leaves_the_lock_of_another_that_a_board_may_be() -> None:
    async def test(made: MemoryHub) -> None:
        await made.connect(motors("left_motor"))
        car, arm = (made.hub.robots.find_to_stop(name) for name in ("car", "arm"))
        car.lock("a foot")
        arm.lock("a hand")
        arm.unlock()
        assert is_refused(made, "/left_motor")
        made.hub.robots.lock_all("smoke")
        car.unlock()
        with pytest.raises(CommandRefused, match="locked: smoke"):
            publish(made.hub, "/left_motor", NUMBER, type_name=INT16)

    in_hub(test, Config(robots={name: RobotConfig(address=HERE) for name in ("car", "arm")}))


def test_reload_that_places_a_robot_where_a_board_is_lets_its_lock_hold() -> None:
    async def test(made: MemoryHub) -> None:
        await made.connect(motors("left_motor"))
        made.hub.robots.find_to_stop("car").lock("a foot")
        assert not is_refused(made, "/left_motor")
        config = Config(robots={"car": RobotConfig(address=HERE)})
        made.hub.reconfigure(config, places_of(config))
        assert is_refused(made, "/left_motor")

    in_hub(test, Config(robots={"car": RobotConfig()}))


def test_gate_of_a_spatial_drive_follows_the_locks_of_the_robots_that_it_may_be() -> None:
    spatial = RobotConfig(address=HERE, command_topic="/thrusters", kinematics="spatial")

    async def test(made: MemoryHub) -> None:
        await made.connect(commanded("/thrusters"))
        drone, base = (made.hub.robots.find_to_stop(name) for name in ("drone", "base"))

        def is_open() -> bool:
            try:
                publish(made.hub, "/thrusters", {"linear": {"x": 0.1}}, type_name=TWIST_TYPE)
            except CommandRefused as refused:
                return refused.kind is not RefusalKind.LOCKED
            return True

        assert is_open()
        drone.lock("a foot")
        base.lock("a hand")
        base.unlock()
        assert not is_open()
        made.hub.robots.lock_all("smoke")
        made.hub.robots.unlock_all()
        assert is_open()
        drone.lock("a foot")
        made.hub.robots.lock_all("smoke")
        base.unlock()
        assert not is_open()
        drone.unlock()
        assert not is_open()  # all boards are locked
        made.hub.robots.unlock_all()
        assert is_open()

    in_hub(test, Config(robots={"drone": spatial, "base": RobotConfig(address=HERE)}))
