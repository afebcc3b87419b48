"""A Twist and a TwistStamped of one base are two ways to one motion: one source drives it, another one is refused."""

import asyncio
import struct

import pytest

from hostlink.core.hub.participant import Participant
from hostlink.core.protocol.endpoint import EndpointKind
from hostlink.core.robot.velocity import TWIST_STAMPED_TYPE, TWIST_TYPE
from hostlink.errors import CommandRefused, RefusalKind
from tests.support.fake_device import topic
from tests.support.memory_hub import SETTLED_S, MemoryHub, in_hub
from tests.support.scripted_device import ScriptedDevice

PLAIN, STAMPED, ARM = 100, 101, 102
TOPICS = [
    topic(EndpointKind.SUBSCRIBER, PLAIN, "cmd_vel", TWIST_TYPE),
    topic(EndpointKind.SUBSCRIBER, STAMPED, "cmd_vel_stamped", TWIST_STAMPED_TYPE),
    topic(EndpointKind.SUBSCRIBER, ARM, "arm_vel", TWIST_TYPE),
]


def publish(source: Participant, name: str, x_m_s: float) -> None:
    header = bytes(16) if name.endswith("stamped") else b""
    source.publish(name, header + struct.pack("<6d", x_m_s, 0, 0, 0, 0, 0))


def newest(device: ScriptedDevice, topic_id: int) -> float:
    (x_m_s,) = struct.unpack("<d", device.payloads(topic_id)[-1][-48:-40])
    return float(x_m_s)


async def connected(made: MemoryHub) -> tuple[ScriptedDevice, Participant, Participant]:
    device = await made.connect(TOPICS)
    sources = made.hub.join("first"), made.hub.join("second")
    for source in sources:
        source.advertise("/cmd_vel", TWIST_TYPE)
        source.advertise("/cmd_vel_stamped", TWIST_STAMPED_TYPE)
        source.advertise("/arm_vel", TWIST_TYPE)
    await asyncio.sleep(0.5)  # each topic is sent its first zeros
    return device, *sources


@pytest.mark.parametrize(("way", "other"), [("/cmd_vel", "/cmd_vel_stamped"), ("/cmd_vel_stamped", "/cmd_vel")])
def test_second_source_at_the_other_way_is_refused_until_the_first_lets_go(way: str, other: str) -> None:
    async def test(made: MemoryHub) -> None:
        device, first, second = await connected(made)
        zeros = len(device.payloads(PLAIN))
        for _ in range(5):
            publish(first, way, 0.2)
            with pytest.raises(CommandRefused, match="first drives it with the same priority") as refused:
                publish(second, other, -0.2)
            assert refused.value.kind is RefusalKind.HELD
            publish(second, other, 0.0)  # as a joystick at rest, which stops nothing
            await asyncio.sleep(0.1)
        assert {newest(device, PLAIN), newest(device, STAMPED)} == {0.2, 0.0}
        assert min(len(device.payloads(each)) for each in (PLAIN, STAMPED)) == zeros  # those of its connection
        publish(second, "/arm_vel", 0.1)  # another motion of the robot
        publish(first, way, 0.0)
        await asyncio.sleep(SETTLED_S)
        publish(second, other, -0.2)
        await asyncio.sleep(0.1)
        assert {newest(device, PLAIN), newest(device, STAMPED)} == {-0.2, 0.0}

    in_hub(test)


def test_one_source_may_use_both_ways_as_a_gamepad_does() -> None:
    async def test(made: MemoryHub) -> None:
        device, first, _ = await connected(made)
        publish(first, "/cmd_vel", 0.2)
        publish(first, "/cmd_vel_stamped", 0.2)
        await asyncio.sleep(0.1)
        assert (newest(device, PLAIN), newest(device, STAMPED)) == (0.2, 0.2)

    in_hub(test)


def test_take_over_ends_what_the_other_source_drives_by_the_other_way() -> None:
    async def test(made: MemoryHub) -> None:
        device, first, second = await connected(made)
        publish(first, "/cmd_vel_stamped", 0.2)
        await asyncio.sleep(0.1)
        robot = made.robot("robot_0")
        second.drive(robot, robot.gate.zero._replace(x_m_s=-0.2), take_over=True)
        await asyncio.sleep(0.2)
        assert (newest(device, PLAIN), newest(device, STAMPED)) == (-0.2, 0.0)
        with pytest.raises(CommandRefused):
            publish(first, "/cmd_vel_stamped", 0.2)

    in_hub(test)


def test_lease_that_ends_frees_the_other_way() -> None:
    async def test(made: MemoryHub) -> None:
        device, first, second = await connected(made)
        publish(first, "/cmd_vel", 0.2)
        await asyncio.sleep(0.7)
        publish(second, "/cmd_vel_stamped", -0.2)
        await asyncio.sleep(0.1)
        assert (newest(device, PLAIN), newest(device, STAMPED)) == (0.0, -0.2)

    in_hub(test)
