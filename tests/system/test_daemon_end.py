"""Every end of the daemon: the last velocity at the robot is zero."""

import asyncio
import contextlib
import os
import signal
import struct
from collections.abc import AsyncIterator
from pathlib import Path

import aiohttp
import pytest

from hostlink.core.protocol.rosserial.frame import Id
from tests.support.background import meanwhile
from tests.support.fake_device import FakeDevice, fake_device, robot_topics
from tests.support.process import HOSTLINK, Process, free_port, serve
from tests.support.pty_pair import pty_pair, pty_streams
from tests.support.stopwatch import Stopwatch
from tests.support.waiting import TIMEOUT_S

ZERO = (0.0, 0.0)
END_S = 1.5


@contextlib.asynccontextmanager
async def driven(daemon: Process, rate_hz: float) -> AsyncIterator[None]:
    """A program that publishes velocities for as long as the daemon takes them."""

    async def publish(program: aiohttp.ClientWebSocketResponse) -> None:
        with contextlib.suppress(ConnectionError):
            while not program.closed:
                message = {"linear": {"x": 0.2}}
                await program.send_json({"op": "publish", "topic": "/robot_0/velocity_commands", "msg": message})
                await asyncio.sleep(1 / rate_hz)

    async with (
        aiohttp.ClientSession() as session,
        session.ws_connect(daemon.url) as program,
        meanwhile(publish(program)),
    ):
        yield


async def velocities_to_the_stop(device: FakeDevice) -> list[tuple[float, float]]:
    """Every velocity up to the request to fall silent."""
    found = []
    while (frame := await device.next()).topic_id != Id.STOP:
        if frame.topic_id == 100:
            twist = struct.unpack("<6d", frame.payload)
            found.append((twist[0], twist[5]))
    return found


async def velocities_to_the_end(device: FakeDevice) -> list[tuple[float, float]]:
    """Every velocity up to the request to fall silent, after which the link must end."""
    found = await velocities_to_the_stop(device)
    with pytest.raises((EOFError, ConnectionError)):
        await device.next()
    return found


@pytest.mark.parametrize(
    ("number", "rate_hz"),
    [
        pytest.param(signal.SIGTERM, 10, marks=pytest.mark.long),
        (signal.SIGTERM, 50),
        pytest.param(signal.SIGTERM, 200, marks=pytest.mark.long),
        (signal.SIGINT, 50),
        (signal.SIGHUP, 50),
        (signal.SIGQUIT, 50),
    ],
)
async def test_a_robot_that_is_driven_while_the_daemon_ends_receives_zero_last(
    number: signal.Signals, rate_hz: float
) -> None:
    async with serve() as daemon, fake_device(daemon.tcp, robot_topics()) as device, driven(daemon, rate_hz):
        assert await device.velocity_other_than(ZERO) == (0.2, 0.0)
        watch = Stopwatch(daemon.pid)
        async with meanwhile(watch.sampling()):
            daemon.child.send_signal(number)
            sent = await velocities_to_the_end(device)
            assert await daemon.child.wait() == 0
        assert watch.seconds < 1.0
        assert sent[-3:] == [ZERO, ZERO, ZERO]
        first = sent.index(ZERO)
        assert set(sent[first:]) == {ZERO}  # from the first zero on nothing moves it
        line = await daemon.read_log("daemon.stop_requested")
        assert line["cause"] == number.name


async def test_a_second_signal_during_the_farewell_does_not_shorten_it() -> None:
    async with serve() as daemon, fake_device(daemon.tcp, robot_topics()) as device, driven(daemon, 50):
        assert await device.velocity_other_than(ZERO) == (0.2, 0.0)
        for number in (signal.SIGTERM, signal.SIGTERM, signal.SIGINT, signal.SIGQUIT):
            daemon.child.send_signal(number)
            await asyncio.sleep(0.02)
        assert (await velocities_to_the_end(device))[-3:] == [ZERO, ZERO, ZERO]
        assert await daemon.child.wait() == 0


# -- a device on a serial port ----------------------------------------------------------------------------------------


async def test_a_serial_robot_receives_zero_last_too() -> None:
    async with pty_streams() as (reader, writer, path), serve("--serial", f"{path}@115200") as daemon:
        robot = FakeDevice(reader, writer)
        await robot.announce(robot_topics())
        await daemon.read_log("robot.appeared")
        async with driven(daemon, 50):
            await robot.velocity_of((0.2, 0.0))
            daemon.child.send_signal(signal.SIGTERM)
            assert (await velocities_to_the_stop(robot))[-3:] == [ZERO, ZERO, ZERO]
        assert await daemon.child.wait() == 0


@pytest.mark.parametrize("delay_s", [0.0, 0.0005, 0.002, 0.01])
async def test_a_signal_in_the_moment_in_which_a_serial_port_vanishes_ends_the_daemon(delay_s: float) -> None:
    with contextlib.ExitStack() as ports:
        pairs = [ports.enter_context(pty_pair()) for _ in range(4)]
        arguments = [word for _, path in pairs for word in ("--serial", f"{path}@115200")]
        async with serve(*arguments) as daemon:
            await daemon.logged("link.opened", len(pairs))
            for number, (descriptor, _) in enumerate(pairs):
                if number == 2:
                    daemon.child.send_signal(signal.SIGTERM)
                os.close(descriptor)
                await asyncio.sleep(delay_s)
            watch = Stopwatch(daemon.pid)
            async with asyncio.timeout(TIMEOUT_S), meanwhile(watch.sampling()):
                assert await daemon.child.wait() == 0
            assert watch.seconds < END_S + 1.0


# -- a log that cannot be written -------------------------------------------------------------------------------------


@contextlib.asynccontextmanager
async def serve_with_stderr(stderr: int | None, folder: Path, *, shell: str = "") -> AsyncIterator[Process]:
    """A daemon whose log is written to this descriptor, or to the target of the shell's words. Its ports are known."""
    ports = (free_port(), free_port())
    config = folder / "hostlink.toml"
    config.write_text(f'[tcp]\nhost = "127.0.0.1"\nport = {ports[0]}\n[api]\nport = {ports[1]}\n')
    words = [HOSTLINK, "serve", "--config", str(config)]
    command = ["sh", "-c", f'exec "$@" {shell}', "sh", *words] if shell else words
    child = await asyncio.create_subprocess_exec(*command, stderr=stderr)
    process = Process(child, tcp=("127.0.0.1", ports[0]), url=f"http://127.0.0.1:{ports[1]}")
    try:
        async with asyncio.timeout(TIMEOUT_S):
            await answers(process)
        yield process
    finally:
        if child.returncode is None:
            child.kill()
        await child.wait()


async def answers(process: Process) -> None:
    async with aiohttp.ClientSession() as session:
        while True:
            with contextlib.suppress(aiohttp.ClientError):
                async with session.get(f"{process.url}/healthz") as response:
                    if response.status == 200:
                        return
            assert process.child.returncode is None
            await asyncio.sleep(0.05)


async def drives_and_ends_well(daemon: Process) -> None:
    """Eleven devices come and go, which is told in the log, a robot is driven; a signal ends all in order."""
    async with fake_device(daemon.tcp, robot_topics()) as device, driven(daemon, 50):
        for _ in range(10):
            async with fake_device(daemon.tcp, robot_topics("other"), local_host="127.0.0.9"):
                assert await device.velocity_other_than(ZERO) == (0.2, 0.0)
        assert daemon.child.returncode is None
        daemon.child.send_signal(signal.SIGTERM)
        assert (await velocities_to_the_end(device))[-3:] == [ZERO, ZERO, ZERO]
        async with asyncio.timeout(10):
            assert await daemon.child.wait() == 0


@pytest.mark.parametrize(
    "shell", ["2>/dev/full", *(pytest.param(each, marks=pytest.mark.long) for each in ("2>&-", "0<&- 1>&- 2>&-"))]
)
async def test_a_log_that_cannot_be_written_harms_nothing(shell: str, tmp_path: Path) -> None:
    async with serve_with_stderr(None, tmp_path, shell=shell) as daemon:
        await drives_and_ends_well(daemon)


@pytest.mark.long
async def test_a_reader_of_the_log_that_is_gone_harms_nothing(tmp_path: Path) -> None:
    reading, writing = os.pipe()
    async with serve_with_stderr(writing, tmp_path) as daemon:
        os.close(writing)
        os.close(reading)
        await drives_and_ends_well(daemon)


async def test_a_reader_of_the_log_that_sleeps_stops_nothing(tmp_path: Path) -> None:
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(writing, bytes(4096))
    os.set_blocking(writing, True)  # it is full: a write blocks now
    async with serve_with_stderr(writing, tmp_path) as daemon:
        await drives_and_ends_well(daemon)
    os.close(writing)
    os.close(reading)
