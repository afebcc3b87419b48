"""A driven robot whose velocity topic is announced with damage that the checksum let pass: a zero still reaches it."""

import asyncio
import contextlib
from collections.abc import Callable

import pytest

from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind
from hostlink.core.protocol.rosserial.control import encode_topic_info
from hostlink.core.protocol.rosserial.frame import Id
from hostlink.core.robot.admission import LEASE_S
from hostlink.core.robot.velocity import ZERO, PlanarVelocity
from hostlink.errors import HostlinkError
from tests.support.fake_device import robot_topics, topic
from tests.support.gates import drive_gate
from tests.support.memory_hub import MemoryHub, in_hub, twist_zeros, velocities
from tests.support.scripted_device import ScriptedDevice

SLOW = PlanarVelocity(0.1)
VELOCITY = topic(EndpointKind.SUBSCRIBER, 100, "/robot_0/velocity_commands", "geometry_msgs/Twist")
DAMAGES = {
    "md5": VELOCITY._replace(md5="8" + VELOCITY.md5[1:]),
    "buffer": VELOCITY._replace(buffer_bytes=16),
    "type": VELOCITY._replace(type="geometry_msgs/Twisu"),
    "name": VELOCITY._replace(name="/robot_0/vflocity_commands"),
    "namespace": VELOCITY._replace(name="/robot_1/velocity_commands"),
    "id": VELOCITY._replace(id=116),
    "id of another": VELOCITY._replace(id=101),
    "publisher": VELOCITY._replace(kind=EndpointKind.PUBLISHER),
    "service": VELOCITY._replace(kind=EndpointKind.SERVICE_SERVER_SUBSCRIBER),
}
damages = pytest.mark.parametrize("damaged", DAMAGES.values(), ids=DAMAGES)
alone = pytest.mark.parametrize("is_alone", [False, True], ids=["all topics", "one topic"])


def with_damage(damaged: DeviceEndpoint) -> list[DeviceEndpoint]:
    return [damaged if info == VELOCITY else info for info in robot_topics()]


async def announce(device: ScriptedDevice, infos: list[DeviceEndpoint]) -> None:
    for info in infos:
        await device.send(info.kind, encode_topic_info(info))
    await device.send(Id.TIME, bytes(8))


async def driven(made: MemoryHub) -> ScriptedDevice:
    """A robot that is driven, seconds after its last topic request."""
    device = await made.connect()
    await asyncio.sleep(2.0)
    drive_gate(made.robot(), SLOW)
    await asyncio.sleep(0.1)
    assert velocities(device)[-1] == (0.1, 0.0)
    return device


@alone
@damages
def test_robot_receives_zero_at_once_and_is_driven_again_after_a_second_announcement(
    damaged: DeviceEndpoint, is_alone: bool
) -> None:
    async def test(made: MemoryHub) -> None:
        device = await driven(made)
        requests = device.link.session.counts.topic_requests
        device.heard.clear()
        await announce(device, [damaged] if is_alone else with_damage(damaged))
        await asyncio.sleep(LEASE_S + 0.15)
        assert velocities(device)[-1] == (0.0, 0.0)
        await asyncio.sleep(1.5)
        assert device.link.session.counts.topic_requests > requests
        assert made.robot().link is device.link
        drive_gate(made.robot(), ZERO)
        drive_gate(made.robot(), SLOW)
        await asyncio.sleep(0.05)
        assert velocities(device)[-1] == (0.1, 0.0)

    in_hub(test)


@damages
def test_all_of_its_zeros_are_sent_and_it_stays_guarded_while_the_damage_lasts(damaged: DeviceEndpoint) -> None:
    async def test(made: MemoryHub) -> None:
        device = await driven(made)
        (zero,) = device.link.last_frames
        device.infos = []  # it answers no topic request
        device.heard.clear()
        await announce(device, with_damage(damaged))
        await asyncio.sleep(LEASE_S + 0.3)
        after = velocities(device)
        assert after[after.index((0.0, 0.0)) :][:3] == [(0.0, 0.0)] * 3
        assert (0.1, 0.0) not in after[after.index((0.0, 0.0)) :]
        assert twist_zeros(100)[0] in made.guard.watched[device.link.number][0]
        assert zero in device.link.last_frames[0]

    in_hub(test)


@pytest.mark.parametrize("damage", ["md5", "type", "id", "publisher"])
def test_endpoint_is_given_up_after_its_zeros_if_a_second_announcement_is_the_same(damage: str) -> None:
    async def test(made: MemoryHub) -> None:
        device = await driven(made)
        device.infos = with_damage(DAMAGES[damage])
        device.heard.clear()
        await announce(device, device.infos)
        await asyncio.sleep(LEASE_S + 2.0)
        after = velocities(device)
        assert after[after.index((0.0, 0.0)) :] == [(0.0, 0.0)] * after.count((0.0, 0.0))
        assert after.count((0.0, 0.0)) >= 3
        assert twist_zeros(100)[0] not in made.guard.watched.get(device.link.number, ([], 0))[0]
        device.heard.clear()
        made.hub.robots.stop_all()
        await asyncio.sleep(0.05)
        assert velocities(device) == []

    in_hub(test)


STOPS: dict[str, Callable[[MemoryHub], object]] = {
    "stop all": lambda made: made.hub.robots.stop_all(),
    "stop": lambda made: made.robot().stop(),
    "lock": lambda made: made.robot().lock(),
    "zero": lambda made: drive_gate(made.robot(), ZERO),
}


@pytest.mark.parametrize("stop", STOPS.values(), ids=STOPS)
def test_every_stop_reaches_a_robot_whose_buffer_seems_too_small(stop: Callable[[MemoryHub], object]) -> None:
    async def test(made: MemoryHub) -> None:
        device = await driven(made)
        device.infos = with_damage(DAMAGES["buffer"])
        await announce(device, device.infos)
        await asyncio.sleep(0.5)
        device.heard.clear()
        stop(made)
        await asyncio.sleep(0.01)
        assert velocities(device) == [(0.0, 0.0)]
        with pytest.raises(HostlinkError):
            drive_gate(made.robot(), SLOW, owner="another")

    in_hub(test)


def test_no_zero_is_sent_to_an_id_with_another_meaning() -> None:
    async def test(made: MemoryHub) -> None:
        device = await driven(made)
        device.infos = [
            topic(EndpointKind.PUBLISHER, 125, "/text", "std_msgs/String"),
            topic(EndpointKind.SUBSCRIBER, 100, "/led", "std_msgs/Bool"),
        ]
        device.heard.clear()
        await announce(device, device.infos)
        await asyncio.sleep(2.0)
        assert device.payloads(100) == []
        assert device.link.number not in made.guard.watched
        assert device.link.last_frames == ()

    in_hub(test)


@damages
def test_source_that_drives_on_through_the_damage_must_let_go(damaged: DeviceEndpoint) -> None:
    async def test(made: MemoryHub) -> None:
        device = await driven(made)
        device.heard.clear()
        await announce(device, with_damage(damaged))
        for _ in range(30):
            with contextlib.suppress(HostlinkError):
                drive_gate(made.robot(), SLOW)
            await asyncio.sleep(0.1)
        assert made.robot().link is device.link
        after = velocities(device)
        assert (0.1, 0.0) not in after[after.index((0.0, 0.0)) :]
        await asyncio.sleep(LEASE_S)
        drive_gate(made.robot(), SLOW)
        await asyncio.sleep(0.01)
        assert velocities(device)[-1] == (0.1, 0.0)

    in_hub(test)
