"""Board that ignores a zero and stops by a service: its robot calls the service with each zero."""

import asyncio

import pytest

from hostlink.core.config import Config, RobotConfig
from hostlink.core.hub.reloader import places_of
from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind
from hostlink.core.protocol.rosserial.frame import encode
from hostlink.core.robot.admission import LEASE_S
from hostlink.core.robot.velocity import PlanarVelocity
from hostlink.core.robot.velocity_gate import ZEROS
from hostlink.errors import CommandRefused, RefusalKind
from tests.support.fake_device import service_server, topic
from tests.support.memory_hub import MemoryHub, in_hub
from tests.support.participants import ROBOT
from tests.support.scripted_device import ScriptedDevice

COMMAND, STOP, ANSWER = 100, 101, 125  # ids of the board's endpoints
VELOCITY = topic(EndpointKind.SUBSCRIBER, COMMAND, f"/{ROBOT}/cmd_vel", "geometry_msgs/Twist")
CONFIG = Config(robots={ROBOT: RobotConfig(stop_service="stop")})


def board(type_name: str = "std_srvs/Empty", name: str = "stop") -> list[DeviceEndpoint]:
    return [VELOCITY, *service_server(name, type_name, ANSWER, STOP)]


def heard(device: ScriptedDevice) -> list[int]:
    """Return the ids of the frames to the board's endpoints, in their order."""
    return [frame.topic_id for _, frame in device.heard if frame.topic_id in (COMMAND, STOP)]


async def drives(made: MemoryHub, device: ScriptedDevice) -> None:
    await asyncio.sleep(2 * LEASE_S)  # the zeros of the connection
    device.heard.clear()
    made.hub.join("driver").drive(made.robot(), PlanarVelocity(0.2))
    await asyncio.sleep(0.1)
    assert set(heard(device)) == {COMMAND}


@pytest.mark.parametrize(
    ("type_name", "name"), [("std_srvs/Empty", "stop"), ("std_srvs/Trigger", "stop"), ("std_srvs/Empty", "/stop")]
)
def test_every_zero_calls_the_service(type_name: str, name: str) -> None:
    async def test(made: MemoryHub) -> None:
        device = await made.connect(board(type_name, name))
        await asyncio.sleep(2 * LEASE_S)
        assert len(device.payloads(STOP)) >= ZEROS  # it may move when it connects
        await drives(made, device)
        await asyncio.sleep(2 * LEASE_S)  # the end of the lease
        assert device.payloads(STOP) == [b""] * ZEROS
        await drives(made, device)
        made.robot().stop()
        await asyncio.sleep(2 * LEASE_S)
        assert device.payloads(STOP) == [b""] * ZEROS
        made.robot().lock("a foot")
        device.heard.clear()
        await asyncio.sleep(4 * LEASE_S)
        assert len(device.payloads(STOP)) >= ZEROS
        made.robot().unlock()

    in_hub(test, CONFIG)


def test_answer_of_the_service_is_not_counted_as_late() -> None:
    async def test(made: MemoryHub) -> None:
        device = await made.connect(board())
        await asyncio.sleep(LEASE_S)
        await device.send(ANSWER, b"")
        await asyncio.sleep(0.1)
        assert made.hub.links.late_answers == 0
        assert not made.logged("service.late")

    in_hub(test, CONFIG)


@pytest.mark.parametrize("infos", [[VELOCITY], board(name="halt"), board("std_srvs/SetBool")])
def test_robot_whose_board_lacks_the_service_is_not_driven(infos: list[DeviceEndpoint]) -> None:
    async def test(made: MemoryHub) -> None:
        device = await made.connect(infos)
        await asyncio.sleep(LEASE_S)
        device.heard.clear()
        with pytest.raises(CommandRefused, match="its device has no service stop of type std_srvs/Empty or") as refused:
            made.hub.join("driver").drive(made.robot(), PlanarVelocity(0.2))
        assert refused.value.kind is RefusalKind.NOT_CONNECTED
        await asyncio.sleep(0.1)
        assert heard(device) == []
        assert "stop_service" in (made.robot().state(0.0).unreachable or "")

    in_hub(test, CONFIG)


def test_reload_adds_the_service() -> None:
    async def test(made: MemoryHub) -> None:
        device = await made.connect(board())
        await drives(made, device)
        made.hub.reconfigure(CONFIG, places_of(CONFIG))
        await asyncio.sleep(2 * LEASE_S)
        assert device.payloads(STOP) != []

    in_hub(test)


def test_last_frames_of_a_link_and_of_the_guardian_call_the_service() -> None:
    async def test(made: MemoryHub) -> None:
        device = await made.connect(board())
        stop = encode(STOP, b"")
        connection = made.hub.robots.device(device.link)
        assert connection is not None
        assert device.link.last_frames[0].endswith(stop)
        assert stop in connection.stop_frames

    in_hub(test, CONFIG)
