"""Recordings that are played to a connected robot: no robot moves unless it was named. In virtual time."""

import asyncio
import contextlib
import dataclasses
from collections.abc import AsyncIterator
from pathlib import Path
from typing import cast

import pytest

from hostlink.cli import play
from hostlink.client import Robot
from hostlink.components.recorder.channel import DEVICE, VELOCITY
from hostlink.core.robot.admission import LEASE_S
from hostlink.core.robot.velocity import PlanarVelocity
from hostlink.errors import BadRequest, HostlinkError
from tests.support.bench import Bench, bench, refused
from tests.support.fake_device import robot_topics
from tests.support.memory_hub import velocities
from tests.support.recorded import COMMANDS, FORWARD, ODOMETRY, PLAYBACK, POSE, channel, recording
from tests.support.scripted_device import ScriptedDevice
from tests.support.virtual_loop import virtual

STILL, MOVING = (0.0, 0.0), (FORWARD.x_m_s, 0.0)
STEADY = [(0.1 * number, COMMANDS, FORWARD.encode()) for number in range(100)]
SENT_S = 0.1


@contextlib.asynccontextmanager
async def robot(name: str = "robot_0") -> AsyncIterator[tuple[Bench, ScriptedDevice]]:
    """A bench whose robot is ready, and to which `play` connects."""
    with pytest.MonkeyPatch.context() as patch:
        async with bench() as here:
            patch.setattr(play, "connect", here.program)
            patch.setattr(play, "connected", here.program)
            yield here, await here.device(robot_topics(name))


async def drive(file: Path) -> None:
    await play.drive_robot("memory", None, file, PLAYBACK, "robot_0", [])


@virtual
async def test_velocity_that_nothing_follows_holds_for_a_lease(tmp_path: Path) -> None:
    """The recorded link was lost while its robot moved: there is no zero, and a minute of others' messages."""
    others = [(0.1 * number, ODOMETRY, POSE) for number in range(600)]
    file = recording(tmp_path, [(0.0, COMMANDS, FORWARD.encode()), *others])
    async with robot() as (here, device):
        playing = here.tasks.create_task(drive(file))
        await asyncio.sleep(SENT_S)
        assert velocities(device)[-1] == MOVING
        await asyncio.sleep(LEASE_S + SENT_S)
        assert velocities(device)[-1] == STILL
        playing.cancel()


class SlowRobot:
    """Robot of a host that answers each velocity after 10 ms."""

    name = "robot_0"

    def __init__(self) -> None:
        self.sent: list[tuple[float, float]] = []  # time and speed

    async def drive(self, linear_m_s: float, *_: float, take_over: bool) -> None:
        assert not take_over
        self.sent.append((asyncio.get_running_loop().time(), linear_m_s))
        await asyncio.sleep(0.01)

    async def stop(self, **_: float) -> None:
        self.sent.append((asyncio.get_running_loop().time(), 0.0))


@virtual
async def test_velocities_of_one_time_move_the_robot_for_one_lease(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    speeds = [0.2, -0.1] * 150 + [0.1]
    file = recording(tmp_path, [(1.0, COMMANDS, PlanarVelocity(each).encode()) for each in speeds])
    robot, began_s = SlowRobot(), asyncio.get_running_loop().time()
    await play.drive_as_recorded(cast(Robot, robot), file, PLAYBACK, "robot_0", COMMANDS.topic)
    assert [(round(at_s - began_s, 2), speed) for at_s, speed in robot.sent] == [(0.0, 0.1), (0.5, 0.0), (0.51, 0.0)]
    assert "300 velocities left out, because a newer one was due" in capsys.readouterr().err


@pytest.mark.parametrize("way", ["stop", "lock"])
@virtual
async def test_stop_of_a_driven_robot_ends_the_play(tmp_path: Path, way: str) -> None:
    async with robot() as (here, device):
        playing = here.tasks.create_task(refused(drive(recording(tmp_path, STEADY))))
        await asyncio.sleep(1.0)
        assert velocities(device)[-1] == MOVING
        other = here.other.robot("robot_0")
        await (other.stop(wait_s=0) if way == "stop" else other.lock("a cat", wait_s=0))
        await other.unlock()
        await asyncio.sleep(SENT_S)
        before = len(velocities(device))
        assert "locked" in await playing
        await asyncio.sleep(1.0)
        assert set(velocities(device)[before - 1 :]) == {STILL}


@virtual
async def test_invalid_velocity_ends_the_play_with_one_line(tmp_path: Path) -> None:
    file = recording(tmp_path, [(0.0, COMMANDS, FORWARD.encode()), (0.1, COMMANDS, b"no twist")])
    async with robot() as (here, _):
        assert "instead of 48" in await refused(drive(file))
        assert here.robot.gate.current.is_zero


@virtual
async def test_text_that_is_said_to_be_a_velocity_drives_nothing(tmp_path: Path) -> None:
    text = channel("/robot_0/velocity_commands", "std_msgs/String", VELOCITY)
    async with robot():
        assert "no velocities of any robot" in await refused(drive(recording(tmp_path, [(0.0, text, bytes(48))])))


@virtual
async def test_unknown_robot_is_reported_before_the_recording_is_read(tmp_path: Path) -> None:
    async with robot("robot_7"):
        assert await refused(drive(tmp_path / "none.mcap")) == (
            "there is no robot named robot_0; similar names: robot_7; `hostlink robots` lists them"
        )


@virtual
async def test_robot_that_nothing_drove_is_named_as_the_cause(tmp_path: Path) -> None:
    announced = recording(tmp_path, [(0.0, ODOMETRY, POSE)], [COMMANDS])
    async with robot():
        reason = await refused(drive(announced))
        assert "no velocities of robot_0, because nothing drove it during the recording" in reason
        assert "--start" not in reason
        with pytest.raises(BadRequest, match="none of the named robots; choose one with --robot: robot_0"):
            await play.drive_robot("memory", None, announced, PLAYBACK, "robot_0", ["robot_7"])
        announced.unlink()
        empty = recording(tmp_path, [], [ODOMETRY, COMMANDS])
        with pytest.raises(BadRequest, match="has no messages of robot_0"):
            await play.play_devices(empty, PLAYBACK, ("127.0.0.1", 1), [])


@virtual
async def test_velocities_on_the_second_topic_of_a_robot_are_driven(tmp_path: Path) -> None:
    other = channel("/robot_0/a_silent_vel", "geometry_msgs/Twist", VELOCITY)
    async with robot() as (_, device):
        await drive(recording(tmp_path, STEADY[:2], [other]))
        assert MOVING in velocities(device)


@pytest.mark.parametrize("is_looped", [False, True])
@virtual
async def test_play_of_nothing_is_refused_and_a_loop_of_it_ends(tmp_path: Path, is_looped: bool) -> None:
    file = recording(tmp_path, [(0.0, COMMANDS, FORWARD.encode()), (2.0, ODOMETRY, POSE)])
    playback = play.Playback(rate=1.0, start_s=100.0, is_looped=is_looped, is_stepped=False)
    async with robot():
        with pytest.raises(HostlinkError, match="the recording has no velocities after 100 s"):
            await play.drive_robot("memory", None, file, playback, "robot_0", [])
        with pytest.raises(HostlinkError, match="the recording has no messages after 100 s"):
            await play.publish_topics("memory", None, file, playback, [ODOMETRY.topic])
        with pytest.raises(BadRequest, match="has no topic /x that may be published"):
            await play.publish_topics("memory", None, file, playback, ["/x"])


TWIST = channel("/robot_0/cmd_vel", "geometry_msgs/Twist", "")


@pytest.mark.parametrize(
    ("recorded", "payload"),
    [
        (channel("/robot_0/velocity_commands", "geometry_msgs/Twist", ""), FORWARD.encode()),
        (channel("/robot_0/cmd_vel", "geometry_msgs/Twist", DEVICE), FORWARD.encode()),
        (channel("/robot_0/cmd_vel_stamped", "geometry_msgs/TwistStamped", DEVICE), bytes(16) + FORWARD.encode()),
        (dataclasses.replace(TWIST, type_name="geometry_msgs/msg/Twist"), FORWARD.encode()),
        (dataclasses.replace(TWIST, type_name=""), FORWARD.encode()),
    ],
    ids=["before a robot", "of a device", "stamped", "of ROS 2", "no type"],
)
@virtual
async def test_recorded_velocity_that_no_gate_sent_is_not_published(
    tmp_path: Path, recorded: play.Channel, payload: bytes
) -> None:
    """The robot was disconnected, a device drove another robot, or another program recorded it."""
    file = recording(tmp_path, [(0.1 * number, recorded, payload) for number in range(5)])
    async with robot() as (here, _):
        with pytest.raises(BadRequest, match="--drive plays velocities"):
            await play.publish_topics("memory", None, file, PLAYBACK, ["*"])
        assert here.robot.gate.counts.commands == 0
