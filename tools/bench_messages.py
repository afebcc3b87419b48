"""`make bench`: cost of a message, a start and a robot's memory, compared with a server that does nothing.

Each of 30 robots sends a pose and a voltage and is driven by a program on the WebSocket; 1,000 others send poses. The
yardstick: tools/bare_server.py, which reads the same crowd, and for 30 robots writes as often. Both are measured in
turn ROUNDS times, because a virtual machine has minutes in which everything costs twice as much; a row has the median,
and in its note the smallest and the largest ratio, and the aim. The bound shows that a change made messages dearer.
A C++ host (rosserial_server) takes 2.0 to 2.8 times as much of a core for the 30 robots as a bare server that only
reads them, measured in one run on another machine. The row "of a core" has the same ratio of the daemon.
"""

import asyncio
import contextlib
import itertools
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import aiohttp

from tests.support.process import HOSTLINK, Process, serve
from tools.bench import Row, bare, cpu_s, crowd, memory_mib, parser, report
from tools.bench_crowd import MANY

RATE_HZ = 10
ROUNDS = 5
SETTLE_S = 1.0
STARTS = 5
IDLE_S = 2.0
EMPTY = ("-c", "import asyncio")
IDLE = ("-c", "import asyncio; asyncio.run(asyncio.sleep(60))")


@dataclass(frozen=True)
class Fleet:
    """Robots, what they send, and what the daemon may use for it, as a multiple of the bare server's cost."""

    what: str
    crowd: str
    count: int
    is_driven: bool
    message_aim: float
    message_bound: float
    memory_bound: float


FLEETS = (
    Fleet(
        "30 robots, two topics up and one down",
        "fleet",
        30,
        is_driven=True,
        message_aim=3.0,
        message_bound=4.0,
        memory_bound=6.0,
    ),
    Fleet(
        "1,000 robots, one topic up",
        "devices",
        1000,
        is_driven=False,
        message_aim=3.5,
        message_bound=5.5,
        memory_bound=10.0,
    ),
)


def main() -> int:
    arguments = parser(__doc__, "messages")
    arguments.add_argument("--loop", default="auto", help="event loop of the daemon: auto, asyncio or uvloop")
    arguments.add_argument("--only", help="one of: fleet, devices, start")
    chosen = arguments.parse_args()
    rows: list[Row] = []
    for fleet in FLEETS:
        if chosen.only in (None, fleet.crowd):
            rows += asyncio.run(measure(fleet, chosen.loop, 50 * chosen.share))
    if chosen.only in (None, "start"):
        rows += asyncio.run(starts())
    return report(rows, chosen.out)


# -- crowds -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Cost:
    """Cost of one round of the daemon, as it is and as multiples of the bare server's in the same round."""

    message_us: float
    core: float
    memory_mib: float
    messages_s: float
    of_message: float
    of_core: float
    of_memory: float


async def measure(fleet: Fleet, loop: str, seconds: float) -> list[Row]:
    """Measure the daemon and the bare server in turn, each with a crowd of its own."""
    rounds = [await one_round(fleet, loop, seconds / ROUNDS) for _ in range(ROUNDS)]
    name = rounds[0][0]
    costs = [cost for _, cost in rounds]

    def middle(value: Callable[[Cost], float]) -> float:
        return statistics.median(map(value, costs))

    of_message = middle(lambda each: each.of_message)
    spread = f"{min(each.of_message for each in costs):.2g} to {max(each.of_message for each in costs):.2g}"
    aim = f"aim {fleet.message_aim:g}: {'met' if of_message <= fleet.message_aim else 'missed'}"
    return [
        Row(
            f"{fleet.what}, {name}: a message", middle(lambda each: each.message_us), "us",
            "times a bare server's", of_message, at_most=fleet.message_bound,
            note=f"{aim}; {spread} in {ROUNDS} rounds; {middle(lambda each: each.messages_s):,.0f} messages/s",
        ),
        Row(
            f"{fleet.what}, {name}: of a core", 100 * middle(lambda each: each.core), "%",
            "times a bare server that only reads", middle(lambda each: each.of_core),
            note="a C++ host: 2.0 to 2.8" if fleet.is_driven else "",
        ),
        Row(
            f"{fleet.what}, {name}: memory", middle(lambda each: each.memory_mib), "MiB",
            "times a bare server's", middle(lambda each: each.of_memory), at_most=fleet.memory_bound,
        ),
    ]  # fmt: skip


async def one_round(fleet: Fleet, loop: str, seconds: float) -> tuple[str, Cost]:
    """Measure the bare server and then the daemon; returns the name of the daemon's loop, too."""
    alone = await bare(fleet.crowd, fleet.count, seconds, RATE_HZ if fleet.is_driven else 0)
    reads = await bare(fleet.crowd, fleet.count, seconds, 0) if fleet.is_driven else alone
    with tempfile.TemporaryDirectory() as folder:
        config = Path(folder) / "hostlink.toml"
        config.write_text(MANY)
        async with (
            serve("--config", str(config), "--loop", loop, program=(HOSTLINK,)) as daemon,
            crowd(fleet.crowd, fleet.count, daemon.tcp, seconds + 15),
            driving(fleet, daemon),
        ):
            await asyncio.sleep(SETTLE_S)
            before = await frames(daemon, fleet.count)
            before_s, began_s = cpu_s(daemon.pid), asyncio.get_running_loop().time()
            await asyncio.sleep(seconds)
            used_s = cpu_s(daemon.pid) - before_s
            lasted_s = asyncio.get_running_loop().time() - began_s
            messages = await frames(daemon, fleet.count) - before
            held_mib = memory_mib(daemon.pid, "VmHWM")
            name = daemon.lines("daemon.started")[0]["loop"]
    message_us, core = used_s / messages * 1e6, used_s / lasted_s
    return name, Cost(
        message_us,
        core,
        held_mib,
        messages / lasted_s,
        message_us / alone["message_us"],
        core / reads["core"],
        held_mib / alone["memory_mib"],
    )


@contextlib.asynccontextmanager
async def driving(fleet: Fleet, daemon: Process) -> AsyncIterator[None]:
    """Run a program that drives every robot, evenly over the period."""
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
    text = ""
    with contextlib.suppress(aiohttp.ServerDisconnectedError):  # the daemon had too little of a core to answer in time
        async with aiohttp.ClientSession() as session, session.get(f"{daemon.url}/metrics") as response:
            text = await response.text()
    if f"hostlink_links {count}.0" not in text.splitlines():
        raise AssertionError(f"not all {count} robots are connected: the machine is too busy")
    names = ("hostlink_link_frames_from_device_total", "hostlink_link_frames_to_device_total")
    return sum(float(line.rpartition(" ")[2]) for line in text.splitlines() if line.startswith(names))


# -- start ------------------------------------------------------------------------------------------------------------


async def starts() -> list[Row]:
    """Measure the CPU time of starts, and the memory of a daemon without devices, its guardian included."""
    empty_s = min(run_s(sys.executable, *EMPTY) for _ in range(STARTS))
    serve_s: list[float] = []
    for _ in range(STARTS):
        async with serve(program=(HOSTLINK,)) as daemon, aiohttp.ClientSession() as session:
            async with session.get(f"{daemon.url}/healthz") as answer:
                await answer.read()
            serve_s.append(cpu_s(daemon.pid))
    async with serve(program=(HOSTLINK,)) as daemon:
        topics_s = min([await asyncio.to_thread(run_s, HOSTLINK, "topics", "--url", daemon.url) for _ in range(STARTS)])
        await asyncio.sleep(IDLE_S)
        guardian = int((await daemon.logged("guardian.started"))["pid"])
        held_mib = memory_mib(daemon.pid) + memory_mib(guardian)
    child = await asyncio.create_subprocess_exec(sys.executable, *IDLE)
    await asyncio.sleep(IDLE_S)
    idle_mib = memory_mib(child.pid)
    child.kill()
    await child.wait()
    yardstick = "times python -c 'import asyncio'"
    return [
        Row("start of `hostlink topics`, CPU", topics_s, "s", yardstick, topics_s / empty_s, at_most=7.0),
        Row("start of `hostlink serve` until it answers, CPU", min(serve_s), "s", yardstick, min(serve_s) / empty_s,
            at_most=13.0),
        Row("daemon without devices and its guardian, memory", held_mib, "MiB", "times an idle asyncio program's",
            held_mib / idle_mib, at_most=6.0),
    ]  # fmt: skip


def run_s(*command: str) -> float:
    """Return the CPU time of a program."""
    child = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode:
        raise AssertionError(f"{command} ended with {child.returncode}")
    return usage.ru_utime + usage.ru_stime


if __name__ == "__main__":
    sys.exit(main())
