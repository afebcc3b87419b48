"""Age of the velocities that a device receives while the API's port is under load, and the delay of its zero."""

import asyncio
import contextlib
import signal
import statistics
import time
from collections.abc import AsyncIterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import aiohttp

from tests.support.api_loads import age_s, command, encode_time
from tests.support.background import meanwhile
from tests.support.core_part import part_of_a_core
from tests.support.fake_device import FakeDevice, fake_device, pose, repeating, robot_topics
from tests.support.process import Process, serve
from tests.support.resources import resident_mib

ROOT = Path(__file__).resolve().parents[2]
DRIVE_S, AFTER_S = 3.0, 2.0
READ_TOKEN, DRIVE_TOKEN = "reader-of-the-tests-0000", "driver-of-the-tests-0000"
TOKENS = f"""
[[api.tokens]]
name = "reader"
role = "read"
token = "{READ_TOKEN}"

[[api.tokens]]
name = "driver"
role = "drive"
token = "{DRIVE_TOKEN}"
"""


@dataclass
class Heard:
    """Velocities that the device received."""

    velocities: list[tuple[float, float]] = field(default_factory=list)  # (time, m/s)

    def ages_s(self) -> list[float]:
        """Return the age of each velocity at its first arrival; the gate repeats it while its lease runs."""
        seen: dict[float, float] = {}
        for at_s, velocity in self.velocities:
            if velocity:
                seen.setdefault(velocity, age_s(velocity, at_s))
        return list(seen.values())

    def zero_after_s(self, killed_s: float) -> float:
        """Return the time from the driver's end until only zeros arrive."""
        moving = [at_s for at_s, velocity in self.velocities if velocity]
        zeros = [at_s for at_s, velocity in self.velocities if not velocity and at_s > max(moving)]
        return min(zeros) - killed_s if zeros else float("inf")


@dataclass(frozen=True)
class Outcome:
    """Effect of a load on the driver's velocities."""

    ages_s: list[float]
    zero_s: float  # from the driver's end
    stops_s: list[float]  # how long a stop took, by REST and by WebSocket
    before_mib: float
    most_mib: float

    def __str__(self) -> str:
        ages = sorted(self.ages_s) or [float("nan")]
        stops = ", ".join(f"{stop_s * 1000:.0f}" for stop_s in self.stops_s)
        return (
            f"{len(self.ages_s)} velocities obeyed; age: median {statistics.median(ages):.3f} s, "
            f"oldest {ages[-1]:.3f} s;"
            f" zero {self.zero_s:.2f} s after the driver's end; stops {stops or '-'} ms;"
            f" RSS {self.before_mib:.0f} -> {self.most_mib:.0f} MiB"
        )


@contextlib.asynccontextmanager
async def running(words: Sequence[str]) -> AsyncIterator[asyncio.subprocess.Process]:
    """A process of tests.support.api_loads, killed at the end of the block."""
    child = await asyncio.create_subprocess_exec(*words, cwd=ROOT, stdout=asyncio.subprocess.PIPE)
    try:
        yield child
    finally:
        if child.returncode is None:
            child.kill()
        await child.wait()


async def listen(device: FakeDevice, heard: Heard) -> None:
    """Note what the device receives, until its connection ends."""
    with contextlib.suppress(EOFError, OSError):
        while True:
            try:
                velocity, _ = await device.velocity()
            except TimeoutError:
                continue
            heard.velocities.append((time.monotonic(), velocity))


async def _watch(host: Process, most: list[float]) -> None:
    while True:
        most.append(resident_mib(host.pid))
        await asyncio.sleep(0.05)


async def _stops(host: Process) -> list[float]:
    """Measure stops: by REST on a new connection, and a driver's zero on an open WebSocket."""
    headers = {"Authorization": f"Bearer {DRIVE_TOKEN}"}
    async with aiohttp.ClientSession(headers=headers) as session:
        took_s = []
        for _ in range(3):
            began_s = time.monotonic()
            async with session.post(f"{host.url}/api/stop") as response:
                assert response.status == 200
            took_s.append(time.monotonic() - began_s)
        async with session.ws_connect(host.url) as socket:
            for _ in range(3):
                for linear in (encode_time(time.monotonic()), 0.0):
                    began_s = time.monotonic()
                    drive = {"op": "drive", "id": "s", "robot": "robot_0", "linear": linear, "angular": 0.0}
                    await socket.send_json(drive | {"priority": 60})
                    answer = await socket.receive_json()
                    assert answer["result"], answer
                took_s.append(time.monotonic() - began_s)
    return took_s


async def measure(
    load: Sequence[str] = (),
    *,
    folder: Path,
    connections: int = 60,
    part: float | None = None,
    drive_s: float = DRIVE_S,
    has_stops: bool = False,
) -> Outcome:
    """Drive at 20 Hz under the loads of these names, kill the driver, and look at what the device received."""
    config = folder / "hostlink.toml"
    config.write_text(TOKENS)
    heard, most = Heard(), list[float]()
    async with serve("--config", str(config)) as host, contextlib.AsyncExitStack() as stack:
        device = await stack.enter_async_context(fake_device(host.tcp, robot_topics()))
        await stack.enter_async_context(repeating(device, pose(0.0)))
        await host.read_log("robot.appeared")
        await stack.enter_async_context(meanwhile(listen(device, heard)))
        before_mib = resident_mib(host.pid)
        await stack.enter_async_context(meanwhile(_watch(host, most)))
        if part is not None:
            stack.enter_context(part_of_a_core(part, host.pid))
        driver = await stack.enter_async_context(running(command("publish", host.url, "--token", DRIVE_TOKEN)))
        assert driver.stdout is not None
        await driver.stdout.readline()
        for name in load:
            token = READ_TOKEN if name in ("uploads", "metrics") else DRIVE_TOKEN
            flags = ("--token", token, "--connections", str(connections))
            await stack.enter_async_context(running(command(name, host.url, *flags)))
        await asyncio.sleep(drive_s)
        stops_s = await _stops(host) if has_stops else []
        await asyncio.sleep(0.2 if has_stops else 0.0)
        killed_s = time.monotonic()
        driver.send_signal(signal.SIGKILL)
        await driver.wait()
        async with asyncio.timeout(30):
            while True:
                await asyncio.sleep(AFTER_S)
                recent = [each for each in heard.velocities if each[0] > time.monotonic() - AFTER_S and each[1]]
                if not recent:
                    break
    return Outcome(heard.ages_s(), heard.zero_after_s(killed_s), stops_s, before_mib, max(most))
