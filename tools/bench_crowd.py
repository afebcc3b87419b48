"""`make bench`, third part: one driven robot while a crowd connects. Daemon, crowd and robot are separate processes.

A program on the WebSocket drives the robot 50 times a second; the latency is from its send to the robot's read. Writes
build/bench_crowd.json and prints a table; ends with status 1 when the 99th percentile or the memory is over its bound.
The bounds of the latency are milliseconds: what a person who stops a robot may wait does not grow with the machine.
"""

import asyncio
import contextlib
import json
import os
import re
import statistics
import struct
import sys
import tempfile
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import aiohttp

from hostlink.core.protocol.rosserial.frame import Frame, Id
from hostlink.core.protocol.rosserial.stream import FrameStream
from tests.support.process import HOSTLINK, Process, free_port, serve
from tests.support.stopwatch import kept_waiting_s
from tests.support.waiting import is_true_within
from tools.bench import Row, cpu_s, crowd, memory_mib, p99, parser, report
from tools.crowd import TIME, hello
from tools.sent_commands import SentCommands

P99_BOUND_S = 0.020
MEMORY_BOUND = 5.0  # times the daemon's with one robot
COMMAND_INTERVAL_S = 0.02
STOP_TIMEOUT_S = 30.0
FEWEST, FEWEST_STOPS, LONGEST = (
    20,
    4,
    10,
)  # commands and stops that tell the median; how much longer a busy machine takes for them
STOP_EVERY = 25  # commands, so twice a second: a zero, on the way that all take
VELOCITY = struct.Struct("<6d")
SPEEDS = 9000  # a command is told by its speed, in steps of 0.1 mm/s
STEP_M_S = 0.0001
MANY = "[tcp]\nmax_connections = 4000\nmax_connections_per_address = 100\n"
MANY_BOARDS = "[micro_ros.udp]\nport = {port}\nmax_connections = 1200\n"


@dataclass(frozen=True)
class Load:
    """A crowd, and for how long it stays. `port`: where it connects; 0: where rosserial devices do."""

    what: str
    crowd: str | None
    count: int
    seconds: float
    config: str = ""
    p99_bound_s: float = P99_BOUND_S
    subscribes: str = ""  # to this topic, by a program of its own
    port: int = 0


def loads(share: float) -> list[Load]:
    """Measure the figures of docs/reliability.md; `share` 0.1 measures a tenth of the crowd."""
    return [
        Load("nobody else", None, 0, 10 * share),
        Load("devices at once, 10 Hz each", "devices", round(1000 * share), 30 * share, MANY),
        boards(round(1000 * share), 30 * share),
        Load("connect and vanish each second", "vanish", round(200 * share), 60 * share),
        Load("connections that say nothing", "silent", round(10_000 * share), 30 * share),
        Load("device that floods", "flood", 1, 20 * share, p99_bound_s=0.005),
        Load("device that floods, with a subscriber", "flood", 1, 20 * share, "", 0.015, "/flood_0/odometry"),
        Load("connections that send any kind of frame", "mixed", 16, 20 * share),
    ]


def boards(count: int, seconds: float) -> Load:
    """Return a crowd of micro-ROS boards at twenty addresses."""
    port = free_port()
    return Load(
        "micro-ROS boards at once, 1 Hz each", "boards", count, seconds, MANY_BOARDS.format(port=port), port=port
    )


def main() -> int:
    arguments = parser(__doc__, "crowd")
    arguments.add_argument("--only", help="one of: devices, boards, vanish, silent, flood, mixed")
    chosen = arguments.parse_args()
    alone = asyncio.run(measure(loads(chosen.share)[0]))
    rows = [*rows_of(alone, alone)]
    for load in loads(chosen.share)[1:]:
        if chosen.only in (None, load.crowd):
            rows += rows_of(asyncio.run(measure(load)), alone)
    return report(rows, chosen.out)


def rows_of(found: dict[str, Any], alone: dict[str, Any]) -> list[Row]:
    """Return the figures of a crowd, compared with those of the robot without one in the same run."""
    count = f"{found['count']:,} " if found["count"] else ""
    what, of_alone = f"{count}{found['what']}: a command", "times that without a crowd"
    late_ms = max(found["p99_ms"], found["stop_p95_ms"])
    longest, core = f"longest {found['longest_ms']:.1f} ms", f"{found['core_percent']:.0f} % of a core"
    note = f"{longest}, {core}, {found['superseded']} superseded"
    return [
        Row(f"{what}, median", found["median_ms"], "ms", of_alone, found["median_ms"] / alone["median_ms"],
            note=f"{found['crowd']}"),
        Row(f"{what}, p99 or p95 of its stops", late_ms, "ms", at_most=found["p99_bound_ms"], note=note),
        Row(f"{count}{found['what']}: memory", found["memory_mib"], "MiB", "times that without a crowd",
            found["memory_mib"] / alone["memory_mib"], at_most=MEMORY_BOUND),
    ]  # fmt: skip


async def measure(load: Load) -> dict[str, Any]:
    """Drive a robot while the crowd is there."""
    with tempfile.TemporaryDirectory() as folder:
        config = Path(folder) / "hostlink.toml"
        config.write_text(load.config)
        async with serve("--config", str(config), program=(HOSTLINK,)) as daemon:
            async with driven(daemon) as robot, subscribed(load, daemon), visitors_of(load, daemon) as visitors:
                before_s, kept_before_s = cpu_s(daemon.pid), kept_s(daemon)
                began_s = time.monotonic()
                latencies = await robot.drive(load.seconds)
                lasted_s = time.monotonic() - began_s
                busy_s, kept_now_s = cpu_s(daemon.pid) - before_s, kept_s(daemon) - kept_before_s
                counts = await visitors()
                sent = robot.sent
            held_mib = memory_mib(daemon.pid, "VmHWM")
    return {
        "what": load.what,
        "p99_bound_ms": load.p99_bound_s * 1000,
        "count": load.count,
        "median_ms": statistics.median(latencies) * 1000,
        "p99_ms": p99(latencies) * 1000,
        "longest_ms": max(latencies) * 1000,
        "stop_p95_ms": statistics.quantiles(sent.stops_s, n=20)[18] * 1000,
        "kept_ms": 1000 * kept_now_s / len(latencies),  # of a command, on average, by other programs
        "commands": len(latencies),
        "superseded": sent.superseded,
        "memory_mib": held_mib,
        "core_percent": 100 * busy_s / lasted_s,
        "crowd": counts,
    }


REPLACED, GATE = "hostlink_velocities_replaced_total", "hostlink_robot_gate_total"
SETTLED_S = 0.6  # a program that advertised before its robot connected lets go for a lease


class Robot:
    """The robot and the program that drives it."""

    def __init__(
        self,
        reader: asyncio.StreamReader,
        writer: asyncio.StreamWriter,
        program: aiohttp.ClientWebSocketResponse,
        session: aiohttp.ClientSession,
    ) -> None:
        self._reader, self._writer, self._program, self._session = reader, writer, program, session
        self.sent = SentCommands()
        self._is_known = asyncio.Event()

    async def listen(self) -> None:
        """Be a device: tell topics, ask for the time, look at commands."""
        stream = FrameStream()
        loop = asyncio.get_running_loop()
        while data := await self._reader.read(1 << 16):
            now_s = loop.time()
            for item in stream.feed(data):
                if isinstance(item, Frame) and item.topic_id == Id.PUBLISHER:
                    self._writer.write(hello("robot_0"))
                elif isinstance(item, Frame) and item.topic_id == 100:
                    self._is_known.set()
                    number = round(VELOCITY.unpack(item.payload)[0] / STEP_M_S)
                    self.sent.receive(number, now_s)

    async def keep_time(self) -> None:
        """A device that asks for no time is dead."""
        while True:
            self._writer.write(TIME)
            await asyncio.sleep(2.0)

    async def read_answers(self) -> None:
        """Read what the daemon sends to the program, so that its pings are answered."""
        async for _ in self._program:
            pass

    async def drive(self, seconds: float) -> list[float]:
        """Latencies of the commands that came; AssertionError when one was lost.

        Of several that the daemon reads in one turn of its loop the newest is sent on, and it counts the others. While
        other programs keep the daemon from running, no command is in time; the drive is longer then.
        """
        await self._is_known.wait()
        await asyncio.sleep(SETTLED_S)
        loop = asyncio.get_running_loop()
        self.sent = sent = SentCommands()
        replaced = await self._replaced()
        least = round(seconds / COMMAND_INTERVAL_S)
        began_s = loop.time()
        count = 0
        while count < least or (count < least * LONGEST and not sent.is_told(FEWEST, FEWEST_STOPS)):
            speed = 0 if count % STOP_EVERY == STOP_EVERY - 1 else count % SPEEDS + 1
            sent.send(speed, loop.time())
            message = {"linear": {"x": speed * STEP_M_S}}
            await self._program.send_json({"op": "publish", "topic": "/robot_0/velocity_commands", "msg": message})
            await asyncio.sleep(max(0.0, began_s + (count + 1) * COMMAND_INTERVAL_S - loop.time()))
            count += 1
        await self._stop(sent)
        count += 1
        replaced = await self._replaced() - replaced
        came = len(sent.latencies_s) + len(sent.stops_s)
        if came + replaced < 0.9 * count or sent.lost or sent.superseded > replaced:
            text = f"{sent.superseded} were superseded by newer ones (the daemon has replaced {replaced})"
            raise AssertionError(f"{came} of {count} commands came, {text}, {sent.lost} were lost")
        return sent.latencies_s

    async def _stop(self, sent: SentCommands) -> None:
        """Send a stop, which is always admitted, and wait until the robot has it: earlier commands are lost then."""
        stops = len(sent.stops_s)
        sent.send(0, asyncio.get_running_loop().time())
        await self._program.send_json({"op": "publish", "topic": "/robot_0/velocity_commands", "msg": {}})
        await is_true_within(lambda: len(sent.stops_s) > stops and not sent.lost, STOP_TIMEOUT_S)  # else it is lost

    async def _replaced(self) -> int:
        """Commands to the robot that the daemon has not sent, because a newer one came or they were late.

        A source with a late command is disarmed until it lets go; without a late one nothing may disarm it.
        """
        async with self._session.get("/api/links") as answer:
            links = (await answer.json())["links"]
        async with self._session.get("/metrics") as answer:
            lines = (await answer.text()).splitlines()
        late, disarmed, in_api = (
            sum(float(line.rpartition(" ")[2]) for line in lines if re.match(pattern, line))
            for pattern in (f'{GATE}{{.*outcome="refused_late"', f'{GATE}{{.*outcome="refused_disarmed"', REPLACED)
        )
        of_link = next(link["replaced"] for link in links if link["robot"] == "robot_0")
        return int(of_link + in_api + late + (disarmed if late else 0))


@contextlib.asynccontextmanager
async def driven(daemon: Process) -> AsyncIterator[Robot]:
    """The robot on its link, and a program on the WebSocket."""
    reader, writer = await asyncio.open_connection(*daemon.tcp)
    async with (
        aiohttp.ClientSession(daemon.url) as session,
        session.ws_connect("/") as program,
        asyncio.TaskGroup() as tasks,
    ):
        robot = Robot(reader, writer, program, session)
        running = [tasks.create_task(each) for each in (robot.listen(), robot.keep_time(), robot.read_answers())]
        await program.send_json(
            {"op": "advertise", "topic": "/robot_0/velocity_commands", "type": "geometry_msgs/Twist"}
        )
        try:
            yield robot
        finally:
            writer.close()
            for task in running:
                task.cancel()


@contextlib.asynccontextmanager
async def visitors_of(load: Load, daemon: Process) -> AsyncIterator[Callable[[], Awaitable[dict[str, int]]]]:
    """Run the crowd, once it is ready; the call waits for its end and returns its counts."""
    if load.crowd is None:
        yield nobody
        return
    host = ("127.0.0.1", load.port) if load.port else daemon.tcp
    async with crowd(load.crowd, load.count, host, load.seconds) as output:

        async def counts() -> dict[str, int]:
            found: dict[str, int] = json.loads(await output.read())
            return found

        yield counts


@contextlib.asynccontextmanager
async def subscribed(load: Load, daemon: Process) -> AsyncIterator[None]:
    """Program that receives every message of the load's topic."""
    if not load.subscribes:
        yield
        return
    child = await asyncio.create_subprocess_exec(
        HOSTLINK, "echo", load.subscribes, "--url", daemon.url, stdout=asyncio.subprocess.DEVNULL
    )
    try:
        yield
    finally:
        child.terminate()
        await child.wait()


async def nobody() -> dict[str, int]:
    return {}


def kept_s(daemon: Process) -> float:
    """Return how long other programs of the machine kept the daemon and this program from running."""
    return kept_waiting_s(os.getpid()) + kept_waiting_s(daemon.child.pid)


if __name__ == "__main__":
    sys.exit(main())
