"""`hostlink play`: play a recording as its robots, as a program that publishes its topics, or to drive a robot."""

import asyncio
import contextlib
import fnmatch
import math
import os
import sys
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, TypeVar

import typer

from hostlink.cli.addresses import DEFAULT_HOST, HostAddress, parse_address
from hostlink.cli.arguments import Token, Url, not_empty
from hostlink.cli.connecting import connected
from hostlink.cli.output import quantity, show_progress, show_question, write_error
from hostlink.cli.robots import require_robot
from hostlink.client import DEFAULT_URL, Robot, connect
from hostlink.components.recorder.channel import DEVICE, VELOCITY, Channel
from hostlink.components.recorder.playing import (
    Due,
    DueVelocity,
    NewestDue,
    drives,
    is_drive,
    is_playable,
    may_move,
    robots_of,
    schedule,
)
from hostlink.components.recorder.reader import McapReader, StoredMessage, Wanted
from hostlink.components.recorder.tables import Decoders
from hostlink.core.runtime.cancellation import meanwhile, raise_if_cancelled
from hostlink.errors import BadRequest, ConfigError, HostlinkError, system_text
from hostlink.workbench.sim.played_device import PlayedDevice, PlayedTopic

TWIST = "geometry_msgs/Twist"
NO_MD5 = "*"
READY_TIMEOUT_S = 5.0
SETTLE_S = 1.0  # until the robots' topics are in every graph: earlier messages would have no subscriber
PROGRESS_S = 0.5
SOON_S = 0.001

Put = Callable[[StoredMessage], Awaitable[None]]
AnyDue = TypeVar("AnyDue", Due, DueVelocity)


@dataclass(frozen=True, slots=True)
class Playback:
    """Speed, range and order in which a recording is played."""

    rate: float
    start_s: float
    is_looped: bool
    is_stepped: bool
    max_pause_s: float = math.inf  # a longer pause of the recording is shortened to this


def command(
    file: Annotated[Path, typer.Argument(help="A recording of `hostlink record`.")],
    topics: Annotated[list[str] | None, typer.Argument(help="With --as-program: names of topics, or patterns.")] = None,
    *,
    to: HostAddress = DEFAULT_HOST,
    robot: Annotated[
        list[str] | None, typer.Option(help="Play this robot only, of a recording of several. May be repeated.")
    ] = None,
    rate: Annotated[
        float,
        typer.Option(
            "--rate", "-r", min=0.01, max=100.0, help="Speed: 2 is twice as fast, 0.5 shows a moment in slow motion."
        ),
    ] = 1.0,
    start: Annotated[float, typer.Option("--start", "-s", min=0.0, help="Seconds to skip at the beginning.")] = 0.0,
    loop: Annotated[
        bool, typer.Option("--loop", "-l", help="Repeat until Ctrl-C, for a demonstration or a long test.")
    ] = False,
    max_pause: Annotated[
        float,
        typer.Option(min=0.0, help="Shorten longer pauses of the recording to so many seconds; 0: keep every pause."),
    ] = 60.0,
    step: Annotated[
        bool, typer.Option("--step", help="Send the next message when you press Enter, to examine a moment.")
    ] = False,
    as_program: Annotated[
        bool,
        typer.Option(
            "--as-program", help="Publish the topics to connected robots, except velocities, instead of playing robots."
        ),
    ] = False,
    drive: Annotated[
        str | None,
        typer.Option(
            metavar="ROBOT",
            help="Drive this robot as the recorded one was driven. The robot moves!",
            callback=not_empty,
        ),
    ] = None,
    take_over: Annotated[
        bool, typer.Option("--take-over", help="With --drive: take the robot over from another program.")
    ] = False,
    url: Url = DEFAULT_URL,
    token: Token = None,
) -> None:
    """Play a recording: its robots connect as devices do, marked as played, and every program sees them.

    Played robots obey no command. With --as-program or --drive, messages go to connected robots instead.
    """
    playback = Playback(rate, start, loop, step, max_pause or math.inf)
    if drive is not None and (step or as_program):
        raise ConfigError(
            "--drive",
            "cannot be combined with --step or --as-program, because the robot is driven at the recorded times",
        )
    if drive is not None:
        asyncio.run(drive_robot(url, token, file, playback, drive, robot or [], take_over=take_over))
    elif as_program:
        if not topics:
            raise ConfigError(
                "--as-program", "no topic is named; name the topics to publish, or a pattern: '/chat' '/robot_0/led*'"
            )
        asyncio.run(publish_topics(url, token, file, playback, topics))
    elif topics:
        raise ConfigError("topics", "they need --as-program; choose robots with --robot")
    else:
        asyncio.run(play_devices(file, playback, parse_address("--connect", to, "127.0.0.1"), robot or []))


async def play_devices(file: Path, playback: Playback, address: tuple[str, int], wanted: list[str]) -> None:
    channels = _channels_of(file)
    robots = {name: found for name, found in robots_of(channels).items() if not wanted or name in wanted}
    if robots and _first_of(file, lambda each: each.robot in robots and each.origin == DEVICE) is None:
        raise BadRequest(
            f"{file} has no messages of {', '.join(sorted(robots))}; `hostlink info {file}` lists what it has"
        )
    if not robots:
        known = ", ".join(sorted(robots_of(channels)))
        named = ", ".join(wanted)
        raise BadRequest(
            f"{file} has no robot named {named}; choose one of: {known}"
            if known
            else f"{file} has no robots, because no device was recorded; --as-program plays topics of programs"
        )
    devices = {name: _device(name, file, found) for name, found in robots.items()}

    def is_wanted(channel: Channel) -> bool:
        return channel.robot in devices and channel.origin == DEVICE and is_playable(channel)

    async def put(message: StoredMessage) -> None:
        device = devices[message.channel.robot]
        device.publish(message.channel.topic, message.payload)
        await device.drained()

    for channel in channels:
        if channel.robot in devices and channel.origin == DEVICE and not is_playable(channel):
            write_error(
                f"{channel.topic} is left out: its messages are {channel.encoding}, because {channel.type_name} had no "
                "definition when it was recorded; record it with --messages FOLDER"
            )
    async with _connected(devices, address):
        write_error(f"playing {', '.join(sorted(devices))}; `hostlink robots` shows their names there; Ctrl-C ends")
        count = await _play_messages(file, playback, is_wanted, put)
    dropped = sum(device.dropped for device in devices.values())
    left_out = sum(device.left_out for device in devices.values())
    without = f", {dropped} of them without a connection to the host" if dropped else ""
    write_error(f"{quantity(count, 'message')} played{without}{f', {left_out} left out' if left_out else ''}")


@contextlib.asynccontextmanager
async def _connected(devices: dict[str, PlayedDevice], address: tuple[str, int]) -> AsyncIterator[None]:
    """Connect the devices to the host for the length of the block.

    Raises:
        HostlinkError: no host answers, or the host requests no topics.
    """
    problem: BaseException | None = None
    at = "{}:{}".format(*address)
    try:
        async with meanwhile(*((name, device.run(*address)) for name, device in devices.items())):
            async with asyncio.timeout(READY_TIMEOUT_S):
                for device in devices.values():
                    await device.is_ready.wait()
            await asyncio.sleep(SETTLE_S)
            yield
    except* TimeoutError:
        advice = "is it hostlink? `hostlink doctor` examines it"
        problem = HostlinkError(f"the program at {at} does not request topics; {advice}")
    except* OSError as error:
        first = error.exceptions[0]
        why = system_text(first) if isinstance(first, OSError) else str(first)
        advice = "start one with `hostlink serve`, or name another with --connect"
        problem = HostlinkError(f"no host answers at {at} ({why}); {advice}")
    except* HostlinkError as error:
        problem = error.exceptions[0]
    raise_if_cancelled()
    if problem is not None:
        raise problem


def _device(name: str, file: Path, channels: list[Channel]) -> PlayedDevice:
    topics = [
        PlayedTopic(
            channel.topic,
            channel.type_name,
            dict(channel.metadata).get("md5sum", NO_MD5),
            is_velocity=channel.origin == VELOCITY,
        )
        for channel in channels
        if channel.origin == DEVICE or channel.type_name == TWIST
    ]
    return PlayedDevice(name, file.name, topics)


async def publish_topics(url: str, token: str | None, file: Path, playback: Playback, topics: list[str]) -> None:
    decoders = Decoders()

    def is_wanted(channel: Channel) -> bool:
        is_readable = is_playable(channel) and not channel.content
        return (
            is_readable and not may_move(channel) and any(fnmatch.fnmatchcase(channel.topic, each) for each in topics)
        )

    if not any(map(is_wanted, _channels_of(file))):
        raise BadRequest(
            f"{file} has no topic {' '.join(topics)} that may be published; `hostlink info {file}` lists "
            "its topics, and --drive plays velocities"
        )
    async with connect(url, token=token, reconnect=False, name="play") as host:

        async def put(message: StoredMessage) -> None:
            fields = decoders.decode(message)
            if fields is not None:
                await host.publish(message.channel.topic, fields, type_name=message.channel.type_name)

        write_error(
            f"{quantity(await _play_messages(file, playback, is_wanted, put), 'message')} of {' '.join(topics)} played"
        )


async def drive_robot(
    url: str,
    token: str | None,
    file: Path,
    playback: Playback,
    robot: str,
    recorded: list[str],
    *,
    take_over: bool = False,
) -> None:
    """Drive a robot through its gate as the recorded one was driven; the robot stops at the end."""
    async with connected(url, token) as host:  # ends before the file is read, which blocks
        await require_robot(host, robot)
    velocities = [channel for channel in _channels_of(file) if is_drive(channel)]
    names = sorted({channel.robot for channel in velocities if not recorded or channel.robot in recorded})
    if len(names) != 1:
        raise BadRequest(_not_one(file, names, {channel.robot for channel in velocities}))
    topic = _first_of(file, lambda channel: is_drive(channel) and channel.robot == names[0])
    if topic is None:
        raise BadRequest(_undriven(file, names[0]))
    async with connect(url, token=token, reconnect=False, name="play") as host:
        driven = host.robot(robot)
        write_error(f"driving {robot} as {names[0]} was driven; Ctrl-C stops the robot, and so does `hostlink stop`")
        count = await drive_as_recorded(driven, file, playback, names[0], topic, take_over=take_over)
    write_error(f"{quantity(count, 'velocity', 'velocities')} driven")


def _undriven(file: Path, robot: str) -> str:
    """Return why there is nothing to drive by."""
    return (
        f"{file} has no velocities of {robot}, because nothing drove it during the recording; choose another recording "
        f"(`hostlink info {file}` lists what it has), or record while the robot is driven: hostlink record"
    )


def _not_one(file: Path, names: list[str], driven: set[str]) -> str:
    """Return why the recorded robot is not known: there is none, or none of that name, or several."""
    if not driven:
        return _undriven(file, "any robot")
    found = f"has velocities of {', '.join(names)}" if names else "has none of the named robots"
    return f"{file} {found}; choose one with --robot: {', '.join(sorted(driven))}"


def _first_of(file: Path, wanted: Wanted) -> str | None:
    """Return the topic of the first message of these channels; None: they have none."""
    return next((message.channel.topic for message in McapReader(file).messages(wanted)), None)


async def drive_as_recorded(
    driven: Robot, file: Path, playback: Playback, recorded: str, topic: str, *, take_over: bool = False
) -> int:
    """Drive as a robot of the recording was driven by this topic, then stop; return the number of sent velocities.

    Raises:
        HostlinkError: a velocity is refused.
    """

    newest = NewestDue()

    async def drive(due: DueVelocity) -> None:
        nonlocal take_over
        await driven.drive(due.velocity.x_m_s, due.velocity.yaw_rad_s, due.velocity.y_m_s, take_over=take_over)
        take_over &= due.velocity.is_zero  # until it drives: who drives afterwards keeps the robot

    def due_velocities(clock: PlaybackClock) -> Iterator[DueVelocity]:
        found = drives(_schedule(file, playback, is_drive), recorded, topic, rate=playback.rate)
        return newest.of(found, lambda: clock.now_s)

    count = await _play(playback, "velocities", due_velocities, drive)
    await driven.stop(wait_s=0.0)
    if newest.left_out:
        left_out = quantity(newest.left_out, "velocity", "velocities")
        write_error(f"{left_out} left out, because a newer one was due")
    return count


class PlaybackClock:
    """PlaybackClock of one run through a recording, with its progress on a terminal."""

    def __init__(self, playback: Playback, what: str) -> None:
        self.count = 0
        self._playback, self._what = playback, what
        self._began_s, self._shown_s = asyncio.get_running_loop().time(), float("-inf")

    @property
    def now_s(self) -> float:
        """Time since the start of the playback."""
        return asyncio.get_running_loop().time() - self._began_s

    async def reach(self, at_s: float) -> None:
        """Sleep until a time of the recording; show the progress in long pauses, too."""
        while (wait_s := at_s - self.now_s) > SOON_S:
            await self.show()
            await asyncio.sleep(min(wait_s, PROGRESS_S))

    async def show(self) -> None:
        """Show the progress, at most twice a second."""
        loop = asyncio.get_running_loop()
        if loop.time() >= self._shown_s + PROGRESS_S:
            self._shown_s = loop.time()
            at_s = (self._shown_s - self._began_s) * self._playback.rate + self._playback.start_s
            show_progress(f"{at_s:.1f} s  {self.count} {self._what}")
            await asyncio.sleep(0)  # lets the devices run, if the file has no pauses

    def done(self) -> int:
        """Return the number of messages.

        Raises:
            BadRequest: there was none, so that a loop would run for ever without waiting.
        """
        if not self.count:
            raise BadRequest(
                f"the recording has no {self._what} after {self._playback.start_s:g} s; use a smaller --start"
            )
        return self.count


def _schedule(file: Path, playback: Playback, wanted: Wanted) -> Iterator[Due]:
    """Yield the messages of the wanted channels by monotonic time; report each pause that is shortened."""
    begin_ns = next((message.steady_ns for message in McapReader(file).messages()), None)
    messages = McapReader(file).messages(wanted, after_s=playback.start_s)
    for due in schedule(
        messages, begin_ns=begin_ns, rate=playback.rate, start_s=playback.start_s, max_pause_s=playback.max_pause_s
    ):
        if due.cut_s:
            whole_s = due.cut_s + playback.max_pause_s
            write_error(f"a pause of {whole_s:.1f} s is shortened to {playback.max_pause_s:g} s (--max-pause)")
        yield due


async def _play_messages(file: Path, playback: Playback, wanted: Wanted, put: Put) -> int:
    """Send every wanted message when it is due, or when Enter is pressed; return their number.

    Raises:
        RecordingFailed: the file cannot be read.
    """

    async def send(due: Due) -> None:
        if playback.is_stepped:
            await _ask(due)
        await put(due.message)

    return await _play(playback, "messages", lambda _: _schedule(file, playback, wanted), send)


async def _play(
    playback: Playback,
    what: str,
    read: Callable[[PlaybackClock], Iterator[AnyDue]],
    put: Callable[[AnyDue], Awaitable[None]],
) -> int:
    """Put what is read when it is due, again and again if the playback is looped; return the number."""
    count = 0
    while True:
        clock = PlaybackClock(playback, what)
        for due in read(clock):
            if not playback.is_stepped:
                await clock.reach(due.at_s)
            await put(due)
            clock.count += 1
            await clock.show()
        count += clock.done()
        if not playback.is_looped:
            return count


async def _ask(due: Due) -> None:
    message = due.message
    show_question(
        f"{due.at_s:9.3f} s  {message.channel.topic}  {quantity(len(message.payload), 'byte')}; Enter sends it "
    )
    if not await _read_line():
        write_error("")  # the question has no end of a line
        raise HostlinkError("--step: standard input is closed; run this command in a terminal")


async def _read_line() -> bytes:
    """Read a line of standard input, empty at its end, without a thread: the process would wait for it after Ctrl-C."""
    loop, line, is_readable = asyncio.get_running_loop(), b"", asyncio.Event()
    number = sys.stdin.fileno()
    try:
        loop.add_reader(number, is_readable.set)
    except PermissionError:  # a file, which can be read at once
        return sys.stdin.buffer.readline()
    try:
        while not line.endswith(b"\n"):
            await is_readable.wait()
            is_readable.clear()
            byte = os.read(number, 1)
            if not byte:
                break
            line += byte
    finally:
        loop.remove_reader(number)
    return line


def _channels_of(file: Path) -> list[Channel]:
    """Read the channels of the file, with progress."""
    show_progress(f"reading {file}")
    return McapReader(file).read_channels()
