"""Recordings that are played to connected robots: no robot moves unless it was named."""

import asyncio
import contextlib
import dataclasses
import io
from collections.abc import AsyncIterator, Coroutine, Iterable
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from hostlink.cli import play
from hostlink.cli.demo import DemoDriver
from hostlink.cli.names import driver
from hostlink.client import connect
from hostlink.errors import BadRequest, ConfigError, HostlinkError
from hostlink.listening import spelled
from hostlink.messages.catalog import Catalog
from hostlink.protocol.frame import Id, encode
from hostlink.recording.channel import DEVICE, VELOCITY, Channel, ros_channel
from hostlink.recording.mcap_writer import McapWriter
from hostlink.robot.velocity import ZERO, PlanarVelocity
from hostlink.sim.run import SocketAddress, run_fleet
from tests.support.daemon import Daemon, daemon
from tests.support.fake_device import FakeDevice, fake_device, pose, robot_topics, topic
from tests.support.virtual_loop import run_virtual
from tests.support.waiting import expect

CATALOG = Catalog()
FORWARD = PlanarVelocity(x_m_s=0.2)
PLAYBACK = play.Playback(rate=1.0, start_s=0.0, is_looped=False, is_stepped=False)
POSE = bytes(24)


def channel(name: str, type_name: str, origin: str, robot: str = "robot_0") -> Channel:
    type_ = CATALOG.message(type_name)
    return ros_channel(name, type_name, type_, is_latched=False, robot=robot, origin=origin)


COMMANDS = channel("/robot_0/velocity_commands", "geometry_msgs/Twist", VELOCITY)
ODOMETRY = channel("/robot_0/odometry", "geometry_msgs/Pose2D", DEVICE)


def recording(folder: Path, messages: Iterable[tuple[float, Channel, bytes]], channels: Iterable[Channel] = ()) -> Path:
    path = folder / "run.mcap"
    writer = McapWriter(path, metadata={})
    for each in channels:
        writer.announce(each)
    for at_s, of, payload in messages:
        writer.write(of, 10**18 + int(at_s * 1e9), payload)
    writer.close()
    return path


@asynccontextmanager
async def robot(name: str = "robot_0") -> AsyncIterator[tuple[Daemon, FakeDevice]]:
    async with daemon() as host, fake_device(host.tcp, robot_topics(name)) as device:
        await expect(lambda: host.hub.robots.has(name))
        yield host, device


async def drive(host: Daemon, file: Path) -> None:
    await play.drive_robot(host.url, None, file, PLAYBACK, "robot_0", [])


@asynccontextmanager
async def beside(work: Coroutine[None, None, None]) -> AsyncIterator[asyncio.Task[None]]:
    """Run the work for the length of the block at most."""
    async with asyncio.TaskGroup() as tasks:
        task = tasks.create_task(work)
        yield task
        task.cancel()


async def refusal(host: Daemon, file: Path) -> str:
    """Return the reason why the play ended."""
    with pytest.raises(HostlinkError) as caught:
        await drive(host, file)
    return str(caught.value)


def is_driven(host: Daemon) -> bool:
    return not host.hub.robots.find("robot_0").gate.current.is_zero


async def test_a_velocity_that_nothing_follows_holds_for_a_lease(tmp_path: Path) -> None:
    """The recorded link was lost while its robot moved: there is no zero, and a minute of others' messages."""
    others = [(0.1 * number, ODOMETRY, POSE) for number in range(600)]
    file = recording(tmp_path, [(0.0, COMMANDS, FORWARD.encode()), *others])
    async with robot() as (host, _), beside(drive(host, file)):
        await expect(lambda: is_driven(host))
        await asyncio.sleep(0.8)
        assert not is_driven(host)


@pytest.mark.parametrize("way", ["stop", "lock"])
async def test_stop_of_a_driven_robot_ends_the_play(tmp_path: Path, way: str) -> None:
    file = recording(tmp_path, [(0.1 * number, COMMANDS, FORWARD.encode()) for number in range(600)])
    async with robot() as (host, _), asyncio.TaskGroup() as tasks:
        playing = tasks.create_task(refusal(host, file))
        await expect(lambda: is_driven(host))
        assert (await host.rest("POST", f"/api/robots/robot_0/{way}"))[0] == 200
        await host.rest("POST", "/api/robots/robot_0/unlock")
        for _ in range(40):
            assert not is_driven(host)
            await asyncio.sleep(0.01)
        assert "locked" in await playing


async def test_invalid_velocity_ends_the_play_with_one_line(tmp_path: Path) -> None:
    file = recording(tmp_path, [(0.0, COMMANDS, FORWARD.encode()), (0.1, COMMANDS, b"no twist")])
    async with robot() as (host, _):
        assert "instead of 48" in await refusal(host, file)
        await expect(lambda: not is_driven(host))


async def test_a_text_that_is_said_to_be_a_velocity_drives_nothing(tmp_path: Path) -> None:
    text = channel("/robot_0/velocity_commands", "std_msgs/String", VELOCITY)
    async with robot() as (host, _):
        assert "no velocities of any robot" in await refusal(host, recording(tmp_path, [(0.0, text, bytes(48))]))


async def test_unknown_robot_is_reported_before_the_recording_is_read(tmp_path: Path) -> None:
    async with robot("robot_7") as (host, _):
        assert await refusal(host, tmp_path / "none.mcap") == (
            "there is no robot named robot_0; similar names: robot_7; `hostlink robots` lists them"
        )


async def test_a_robot_that_nothing_drove_is_named_as_the_cause(tmp_path: Path) -> None:
    announced = recording(tmp_path, [(0.0, ODOMETRY, POSE)], [COMMANDS])
    async with robot() as (host, _):
        reason = await refusal(host, announced)
        assert "no velocities of robot_0, because nothing drove it during the recording" in reason
        assert "--start" not in reason
        with pytest.raises(BadRequest, match="none of the named robots; choose one of: robot_0  with --robot"):
            await play.drive_robot(host.url, None, announced, PLAYBACK, "robot_0", ["robot_7"])
        announced.unlink()
        empty = recording(tmp_path, [], [ODOMETRY, COMMANDS])
        with pytest.raises(BadRequest, match="has no messages of robot_0"):
            await play.play_devices(empty, PLAYBACK, host.tcp, [])


async def test_velocities_on_the_second_topic_of_a_robot_are_driven(tmp_path: Path) -> None:
    other = channel("/robot_0/a_silent_vel", "geometry_msgs/Twist", VELOCITY)
    file = recording(tmp_path, [(0.0, COMMANDS, FORWARD.encode()), (0.1, COMMANDS, FORWARD.encode())], [other])
    async with robot() as (host, device), beside(drive(host, file)):
        await device.velocity_of((0.2, 0.0))


async def test_the_demo_drives_its_own_robots_and_no_board_or_recording_that_connects_too() -> None:
    mark = topic(Id.PUBLISHER, 130, "/played/played", "std_msgs/String")
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


@pytest.mark.parametrize("is_looped", [False, True])
async def test_a_play_of_nothing_is_refused_and_a_loop_of_it_ends(tmp_path: Path, is_looped: bool) -> None:
    file = recording(tmp_path, [(0.0, COMMANDS, FORWARD.encode()), (2.0, ODOMETRY, POSE)])
    playback = play.Playback(rate=1.0, start_s=100.0, is_looped=is_looped, is_stepped=False)
    async with robot() as (host, _):
        with pytest.raises(HostlinkError, match="the recording has no velocities after 100 s"):
            await play.drive_robot(host.url, None, file, playback, "robot_0", [])
        with pytest.raises(HostlinkError, match="the recording has no messages after 100 s"):
            await play.publish_topics(host.url, None, file, playback, [ODOMETRY.topic])
        with pytest.raises(BadRequest, match="has no topic /x that may be published"):
            await play.publish_topics(host.url, None, file, playback, ["/x"])


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


@pytest.mark.parametrize(
    ("name", "type_name", "payload", "origin"),
    [
        ("/robot_0/velocity_commands", "geometry_msgs/Twist", FORWARD.encode(), ""),
        ("/robot_0/cmd_vel", "geometry_msgs/Twist", FORWARD.encode(), DEVICE),
        ("/robot_0/cmd_vel_stamped", "geometry_msgs/TwistStamped", bytes(16) + FORWARD.encode(), DEVICE),
    ],
)
async def test_recorded_velocity_that_no_gate_sent_is_not_published(
    tmp_path: Path, name: str, type_name: str, payload: bytes, origin: str
) -> None:
    """The velocity was recorded while the robot was disconnected, or from a device that drives another."""
    file = recording(tmp_path, [(0.1 * number, channel(name, type_name, origin), payload) for number in range(5)])
    async with robot() as (host, _):
        with pytest.raises(BadRequest, match="--drive plays velocities"):
            await play.publish_topics(host.url, None, file, PLAYBACK, ["*"])
        assert host.hub.robots.find("robot_0").gate.counts.commands == 0


@pytest.mark.parametrize("type_name", ["geometry_msgs/msg/Twist", ""])
async def test_recorded_velocity_of_another_programs_type_is_not_published(tmp_path: Path, type_name: str) -> None:
    theirs = dataclasses.replace(channel("/robot_0/cmd_vel", "geometry_msgs/Twist", ""), type_name=type_name)
    file = recording(tmp_path, [(0.1 * number, theirs, FORWARD.encode()) for number in range(5)])
    async with robot() as (host, _):
        with pytest.raises(BadRequest, match="--drive plays velocities"):
            await play.publish_topics(host.url, None, file, PLAYBACK, ["*"])
        assert host.hub.robots.find("robot_0").gate.counts.commands == 0


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
        topic(Id.SUBSCRIBER, 100, "/robot_0/drive", "geometry_msgs/Twist"),
        topic(Id.PUBLISHER, 125, "/robot_0/odometry", "geometry_msgs/Pose2D"),
    ]
    async with daemon() as host, fake_device(host.tcp, driven):
        await expect(lambda: host.hub.robots.has("robot_0"))
        await play.play_devices(recording(tmp_path, moving, odd), PLAYBACK, host.tcp, [])
        assert host.hub.topics.find("/robot_0/drive").publishers
        gate = host.hub.robots.find("robot_0").gate
        assert (gate.counts.commands, gate.current) == (0, ZERO)


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


MARK = topic(Id.PUBLISHER, 130, "/joystick/played", "std_msgs/String")
TO_ANOTHER = topic(Id.PUBLISHER, 131, "/robot_0/velocity_commands", "geometry_msgs/Twist")


@pytest.mark.parametrize("is_played", [False, True])
async def test_a_device_may_drive_another_unless_it_is_played(*, is_played: bool) -> None:
    topics = [*robot_topics("joystick"), TO_ANOTHER, *([MARK] if is_played else [])]
    async with robot() as (host, _), fake_device(host.tcp, topics) as joystick:
        await expect(lambda: host.hub.robots.has("joystick"))
        await joystick.send(encode(TO_ANOTHER.topic_id, FORWARD.encode()) + pose(1.0))
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
    mark = topic(Id.PUBLISHER, 130, "/robot_0/played", "std_msgs/String")
    async with daemon() as host:
        async with fake_device(host.tcp, [*robot_topics(), mark]):
            await expect(lambda: host.hub.robots.has("robot_0") and host.hub.robots.find("robot_0").is_played)
            (view,) = (await host.get("/api/robots"))["robots"]
            assert (view["played"], view["holder"], driver(view)) == (True, None, "a recording")
        async with fake_device(host.tcp, robot_topics()):
            await expect(lambda: host.hub.robots.find("robot_0").link)
            view = await host.get("/api/robots/robot_0")
            assert (view["played"], driver(view)) == (False, None)
