"""`make bench`, fourth part: what a message costs the daemon. Daemon, devices and program are processes of their own.

Each of 30 robots sends a pose and a voltage and is driven by a program on the WebSocket; the others send poses.
The yardstick, in the same minute: tools/bare_server.py, which reads the same crowd and does nothing with it.
Writes build/bench_messages.json and prints a table; ends with status 1 when the daemon costs more than its bound.
"""

import argparse
import asyncio
import contextlib
import itertools
import json
import sys
import tempfile
from collections.abc import AsyncIterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import aiohttp

from tests.support.process import HOSTLINK, Process, serve
from tools.bench_crowd import MANY, ROOT, cpu_s, read_away

RATE_HZ = 10
SETTLE_S = 1.0


@dataclass(frozen=True)
class Fleet:
    """Robots, what they send, and what the daemon may use for it."""

    what: str
    crowd: str
    count: int
    seconds: float
    is_driven: bool
    bound: float  # times what a bare server of asyncio costs


def fleets(share: float) -> list[Fleet]:
    """`share` 0.1 is a tenth of the time."""
    return [
        Fleet("30 robots, two topics up and one down", "fleet", 30, 20 * share, is_driven=True, bound=3.0),
        Fleet("1,000 robots, one topic up", "devices", 1000, 20 * share, is_driven=False, bound=3.5),
    ]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "bench_messages.json")
    parser.add_argument("--share", type=float, default=1.0, help="of the time: 0.1 for a quick run")
    parser.add_argument("--loop", default="asyncio", help="the daemon's event loop: asyncio or uvloop")
    parser.add_argument("--only", help="one of: fleet, devices")
    arguments = parser.parse_args()
    rows = [
        asyncio.run(measure(fleet, arguments.loop))
        for fleet in fleets(arguments.share)
        if arguments.only in (None, fleet.crowd)
    ]
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    arguments.out.write_text(json.dumps(rows, indent=1) + "\n")
    for row in rows:
        core = f"{row['core']:.1%} of a core"
        each = f"{row['message_us']:.1f} us each, {row['ratio']:.1f} times a bare server's (at most {row['bound']:g})"
        print(f"{row['what']:<42} {row['messages_s']:>8,.0f} messages/s {core:>16} {each}")
    missed = [row["what"] for row in rows if not row["is_enough"]]
    if missed:
        print("too expensive: " + ", ".join(missed))
    return 1 if missed else 0


async def measure(fleet: Fleet, loop: str) -> dict[str, Any]:
    """One row of the table."""
    bare_us = await bare_message_us(fleet)
    with tempfile.TemporaryDirectory() as folder:
        config = Path(folder) / "hostlink.toml"
        config.write_text(MANY)
        options = [] if loop == "asyncio" else ["--loop", loop]
        async with (
            serve("--config", str(config), *options, program=(HOSTLINK,)) as daemon,
            asyncio.TaskGroup() as tasks,
        ):
            reading = tasks.create_task(read_away(daemon))
            async with crowd(fleet, daemon.tcp), driving(fleet, daemon):
                await asyncio.sleep(SETTLE_S)
                before = await frames(daemon, fleet.count)
                before_s, began_s = cpu_s(daemon), asyncio.get_running_loop().time()
                await asyncio.sleep(fleet.seconds)
                used_s = cpu_s(daemon) - before_s
                seconds = asyncio.get_running_loop().time() - began_s
                messages = await frames(daemon, fleet.count) - before
            reading.cancel()
    message_us = used_s / messages * 1e6
    return {
        "what": fleet.what,
        "messages_s": messages / seconds,
        "core": used_s / seconds,
        "message_us": message_us,
        "bare_us": bare_us,
        "ratio": message_us / bare_us,
        "bound": fleet.bound,
        "is_enough": message_us <= fleet.bound * bare_us,
    }


async def bare_message_us(fleet: Fleet) -> float:
    """Measure the cost of a read or a write in a server that does nothing else."""
    rate_hz = RATE_HZ if fleet.is_driven else 0
    server = await asyncio.create_subprocess_exec(
        sys.executable, ROOT / "tools" / "bare_server.py", str(fleet.count), str(fleet.seconds / 2), str(rate_hz),
        stdout=asyncio.subprocess.PIPE,
    )  # fmt: skip
    if server.stdout is None:
        raise AssertionError("a pipe was requested")
    try:
        port = int(await server.stdout.readline())
        async with crowd(fleet, ("127.0.0.1", port)):
            found: float = json.loads(await server.stdout.readline())["message_us"]
            return found
    finally:
        if server.returncode is None:
            server.kill()
        await server.wait()


@contextlib.asynccontextmanager
async def crowd(fleet: Fleet, host: tuple[str, int]) -> AsyncIterator[None]:
    """The robots, all connected."""
    seconds = fleet.seconds + 10
    child = await asyncio.create_subprocess_exec(
        sys.executable, ROOT / "tools" / "crowd.py", fleet.crowd, str(fleet.count), "{}:{}".format(*host),
        str(seconds), stdout=asyncio.subprocess.PIPE,
    )  # fmt: skip
    if child.stdout is None:
        raise AssertionError("a pipe was requested")
    try:
        async with asyncio.timeout(60):
            await child.stdout.readline()
        yield
    finally:
        if child.returncode is None:
            child.kill()
        await child.wait()


@contextlib.asynccontextmanager
async def driving(fleet: Fleet, daemon: Process) -> AsyncIterator[None]:
    """A program that drives every robot, evenly over the period."""
    if not fleet.is_driven:
        yield
        return
    async with (
        aiohttp.ClientSession() as session,
        session.ws_connect(daemon.url) as program,
        asyncio.TaskGroup() as tasks,
    ):
        task = tasks.create_task(drive(program, fleet.count))
        yield
        task.cancel()


async def drive(program: aiohttp.ClientWebSocketResponse, count: int) -> None:
    """Publish one command after another."""
    loop = asyncio.get_running_loop()
    began_s = loop.time()
    for number in itertools.count():
        topic = f"/crowd_{number % count}/velocity_commands"
        await program.send_json({"op": "publish", "topic": topic, "msg": {"linear": {"x": 0.1}}})
        await asyncio.sleep(max(0.0, began_s + (number + 1) / (count * RATE_HZ) - loop.time()))


async def frames(daemon: Process, count: int) -> float:
    """Return how many messages the daemon received and sent. Every robot must be connected."""
    async with aiohttp.ClientSession() as session, session.get(f"{daemon.url}/metrics") as response:
        text = await response.text()
    if f"hostlink_links {count}.0" not in text.splitlines():
        raise AssertionError(f"not all {count} robots are there: the machine is too busy")
    names = ("hostlink_link_frames_from_device_total", "hostlink_link_frames_to_device_total")
    return sum(float(line.rpartition(" ")[2]) for line in text.splitlines() if line.startswith(names))


if __name__ == "__main__":
    sys.exit(main())
