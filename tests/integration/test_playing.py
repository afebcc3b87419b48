"""Recordings that are played to connected robots: no robot moves unless it was named."""

import asyncio
import contextlib
import io
from collections.abc import AsyncIterator, Coroutine
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from hostlink.cli import play
from hostlink.cli.demo import DemoDriver
from hostlink.cli.names import driver
from hostlink.client import connect
from hostlink.components.recorder.channel import CDR, DEVICE, VELOCITY, ros_channel
from hostlink.core.protocol.endpoint import EndpointKind
from hostlink.core.protocol.rosserial.frame import encode
from hostlink.core.robot.velocity import ZERO
from hostlink.core.runtime.listening import spelled
from hostlink.errors import BadRequest, ConfigError
from hostlink.workbench.sim.run import SocketAddress, run_fleet
from tests.support.daemon import Daemon, daemon
from tests.support.fake_device import FakeDevice, fake_device, pose, robot_topics, topic
from tests.support.recorded import COMMANDS, FORWARD, ODOMETRY, PLAYBACK, POSE, channel, recording
from tests.support.virtual_loop import run_virtual
from tests.support.waiting import expect


@asynccontextmanager
async def robot(name: str = "robot_0") -> AsyncIterator[tuple[Daemon, FakeDevice]]:
    async with daemon() as host, fake_device(host.tcp, robot_topics(name)) as device:
        await expect(lambda: host.hub.robots.has(name))
        yield host, device


@asynccontextmanager
async def beside(work: Coroutine[None, None, None]) -> AsyncIterator[asyncio.Task[None]]:
    """Run the work for the length of the block at most."""
    async with asyncio.TaskGroup() as tasks:
        task = tasks.create_task(work)
        yield task
        task.cancel()


def is_driven(host: Daemon) -> bool:
    return not host.hub.robots.find("robot_0").gate.current.is_zero


async def test_the_demo_drives_its_own_robots_and_no_board_or_recording_that_connects_too() -> None:
    mark = topic(EndpointKind.PUBLISHER, 130, "/played/played", "hostlink_msgs/PlayedRecording")
    played = [*robot_topics("played"), mark]
    own: dict[str, SocketAddress] = {}
    async with (
        daemon() as host,
        fake_device(host.tcp, robot_topics("board")),
        fake_device(host.tcp, played),
        beside(run_fleet(*host.tcp, on_connected=own.__setitem__)),
    ):
        await expect(lambda: all(host.hub.robots.has(name) for name in ("robot_0", "played", "board")))
        demo = DemoDriver(
            host.hub, host.hub.join("demo"), lambda peer: peer in {spelled(*each[:2]) for each in own.values()}
        )
        async with beside(demo.run()):
            await expect(lambda: host.hub.robots.find("robot_0").gate.owner_name == "demo")
        assert [host.hub.robots.find(name).gate.counts.commands for name in ("played", "board")] == [0, 0]


class Terminal(io.StringIO):
    """Standard error of a terminal."""

    def isatty(self) -> bool:
        return True


def test_a_play_shows_how_far_it_is_also_where_nothing_is_due() -> None:
    async def wait() -> None:
        clock = play.PlaybackClock(
            play.Playback(rate=2.0, start_s=10.0, is_looped=False, is_stepped=False), "velocities"
        )
        clock.count = 7
        await clock.reach(3.1)

    with contextlib.redirect_stderr(Terminal()) as shown:
        run_virtual(wait())
    lines = shown.getvalue().replace("\r\x1b[2K", "\n").split("\n")
    assert lines[1:] == [f"{at_s}.0 s  7 velocities" for at_s in range(10, 17)]


def test_a_robot_is_not_driven_by_the_enter_key(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="--step"):
        play.command(tmp_path / "run.mcap", drive="robot_0", step=True)


async def test_a_played_device_drives_no_robot(tmp_path: Path) -> None:
    """A device may drive another robot; one that is played may not."""
    twist = channel("/robot_0/velocity_commands", "geometry_msgs/Twist", DEVICE, robot="joystick")
    odometry = channel("/joystick/odometry", "geometry_msgs/Pose2D", DEVICE, robot="joystick")
    own = channel("/joystick/velocity_commands", "geometry_msgs/Twist", VELOCITY, robot="joystick")
    moving = [
        (0.1 * number, each, payload)
        for number in range(10)
        for each, payload in ((odometry, POSE), (twist, FORWARD.encode()))
    ]
    async with robot() as (host, _):
        await play.play_devices(recording(tmp_path, moving, [own]), PLAYBACK, host.tcp, [])
        gate = host.hub.robots.find("robot_0").gate
        assert (gate.counts.commands, gate.current) == (0, ZERO)


@pytest.mark.parametrize("name", ["joy stick", "x" * 70_000])
async def test_a_played_device_whose_name_is_none_drives_no_robot(tmp_path: Path, name: str) -> None:
    """The topic that marks the device as played contains its name, too."""
    twist = channel("/robot_0/drive", "geometry_msgs/Twist", DEVICE, robot=name)
    odometry = channel("/joystick/odometry", "geometry_msgs/Pose2D", DEVICE, robot=name)
    odd = [channel(each, "std_msgs/String", DEVICE, robot=name) for each in ("/a b", "", "/" + "x" * 70_000)]
    moving = [(0.1 * number, each, FORWARD.encode()) for number in range(10) for each in (odometry, twist)]
    driven = [
        topic(EndpointKind.SUBSCRIBER, 100, "/robot_0/drive", "geometry_msgs/Twist"),
        topic(EndpointKind.PUBLISHER, 125, "/robot_0/odometry", "geometry_msgs/Pose2D"),
    ]
    async with daemon() as host, fake_device(host.tcp, driven):
        await expect(lambda: host.hub.robots.has("robot_0"))
        await play.play_devices(recording(tmp_path, moving, odd), PLAYBACK, host.tcp, [])
        assert host.hub.topics.find("/robot_0/drive").publishers
        gate = host.hub.robots.find("robot_0").gate
        assert (gate.counts.commands, gate.current) == (0, ZERO)


async def test_cdr_of_a_type_without_a_definition_is_not_played_and_says_why(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A played device sends as rosserial does: its programs would take the bytes for those of ROS 1."""
    raw = ros_channel(
        "/robot_0/talk", "my_msgs/Own", None, is_latched=False, robot="robot_0", origin=DEVICE, encoding=CDR
    )
    file = recording(tmp_path, [(0.1 * number, each, POSE) for number in range(5) for each in (ODOMETRY, raw)])
    async with daemon() as host:
        received: list[bytes] = []
        host.hub.join("program").subscribe("/robot_0/talk", lambda message: received.append(message.payload))
        await play.play_devices(file, PLAYBACK, host.tcp, [])
        with pytest.raises(BadRequest, match="has no topic /robot_0/talk that may be published"):
            await play.publish_topics(host.url, None, file, PLAYBACK, ["/robot_0/talk"])
        assert received == []
    shown = capsys.readouterr().err
    assert "/robot_0/talk is left out: its messages are cdr, because my_msgs/msg/Own had no definition" in shown
    assert "5 messages" in shown


async def test_a_message_that_no_device_can_send_is_left_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = channel("/robot_0/text", "std_msgs/String", DEVICE)
    long = (100_000).to_bytes(4, "little") + bytes(100_000)
    file = recording(tmp_path, [(0.0, text, long), (0.1, ODOMETRY, POSE), (0.2, ODOMETRY, POSE)], [COMMANDS])
    async with daemon() as host:
        await play.play_devices(file, PLAYBACK, host.tcp, [])
        assert host.hub.topics.find("/robot_0/odometry").messages == 2
    assert capsys.readouterr().err.endswith("3 messages played, 1 left out\n")


MARK = topic(EndpointKind.PUBLISHER, 130, "/joystick/played", "hostlink_msgs/PlayedRecording")
TO_ANOTHER = topic(EndpointKind.PUBLISHER, 131, "/robot_0/velocity_commands", "geometry_msgs/Twist")


@pytest.mark.parametrize("is_played", [False, True])
async def test_a_device_may_drive_another_unless_it_is_played(*, is_played: bool) -> None:
    topics = [*robot_topics("joystick"), TO_ANOTHER, *([MARK] if is_played else [])]
    async with robot() as (host, _), fake_device(host.tcp, topics) as joystick:
        await expect(lambda: host.hub.robots.has("joystick"))
        await joystick.send(encode(TO_ANOTHER.id, FORWARD.encode()) + pose(1.0))
        await expect(lambda: host.hub.topics.find("/joystick/odometry").messages == 1)
        assert is_driven(host) is not is_played


async def test_robot_that_connects_takes_its_name_from_the_played_robot(tmp_path: Path) -> None:
    file = recording(tmp_path, [(0.05 * number, ODOMETRY, POSE) for number in range(200)], [COMMANDS])
    async with daemon() as host, beside(play.play_devices(file, PLAYBACK, host.tcp, [])):
        await expect(lambda: host.hub.topics.find_or_none("/robot_0/odometry") is not None)
        async with fake_device(host.tcp, robot_topics()) as device, connect(host.url) as program:
            await expect(lambda: {robot.name for robot in host.hub.robots.all()} == {"robot_0", "robot_0_2"})
            await program.robot("robot_0").drive(0.2, 0.0)
            assert await device.velocity_other_than((0.0, 0.0)) == (0.2, 0.0)


async def test_played_robot_is_marked_as_played_until_the_robot_itself_connects() -> None:
    mark = topic(EndpointKind.PUBLISHER, 130, "/robot_0/played", "hostlink_msgs/PlayedRecording")
    async with daemon() as host:
        async with fake_device(host.tcp, [*robot_topics(), mark]):
            await expect(lambda: host.hub.robots.has("robot_0") and host.hub.robots.find("robot_0").is_played)
            (view,) = (await host.get("/api/robots"))["robots"]
            assert (view["played"], view["holder"], driver(view)) == (True, None, "a recording")
        async with fake_device(host.tcp, robot_topics()):
            await expect(lambda: host.hub.robots.find("robot_0").link)
            view = await host.get("/api/robots/robot_0")
            assert (view["played"], driver(view)) == (False, None)
