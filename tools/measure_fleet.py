"""Cost of a fleet over Zenoh on one machine: traffic and CPU of each daemon, and the delay of a command.

Each daemon is a process, each robot a device that sends ten poses a second. A program at the first daemon drives a
robot of the last one 50 times a second; the latency is from its send to the robot's read, and to the answer. It drives
a robot of its own daemon in the same way, as the yardstick. `--pages` of the daemons have an open event stream, as of a
page. Prints JSON; with `--check` it ends with status 1 when the 99th percentile is over 10 ms.
"""

import argparse
import asyncio
import contextlib
import functools
import itertools
import json
import os
import re
import statistics
import subprocess
import sys
import tempfile
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import aiohttp

from hostlink.components.zenoh.fleet import READ_S
from tests.support.fake_device import fake_device, pose, robot_topics
from tests.support.process import HOSTLINK, Process, free_port, serve
from tools.crowd import TIME

P99_BOUND_MS = 10.0
POSE_INTERVAL_S = 0.1
COMMAND_INTERVAL_S = 0.02
STEP_M_S = 0.0001
FLEET_TIMEOUT_S = 60.0


def main() -> int:
    """Measure, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--daemons", type=int, default=3)
    parser.add_argument("--robots", type=int, default=10, help="of each daemon")
    parser.add_argument("--pages", type=int, default=1, help="daemons whose page is open")
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--check", action="store_true")
    arguments = parser.parse_args()
    measured = asyncio.run(measure(arguments.daemons, arguments.robots, arguments.pages, arguments.seconds))
    print(json.dumps(measured, indent=1))
    return 1 if arguments.check and measured["to_device_ms"]["p99"] > P99_BOUND_MS else 0


async def measure(daemons: int, robots: int, pages: int, seconds: float) -> dict[str, Any]:
    """A fleet, idle, then driven, then with pages."""
    async with populated(daemons, robots) as (hosts, session), asyncio.TaskGroup() as tasks:
        found_s = await all_known(session, hosts, daemons * robots)
        await asyncio.sleep(READ_S + 1)  # poses travel on for a while
        idle = await costs(hosts, seconds)
        driving = await drive(session, hosts, seconds)
        readers = [tasks.create_task(read_page(session, host)) for host in hosts[:pages]]
        await asyncio.sleep(2.0)
        with_pages = await costs(hosts, seconds)
        for task in readers:
            task.cancel()
    return {
        "daemons": daemons,
        "robots_each": robots,
        "load": os.getloadavg(),
        "all_known_after_s": round(found_s, 2),
        "idle": idle,
        f"{pages}_pages": with_pages,
        **driving,
    }


@contextlib.asynccontextmanager
async def populated(daemons: int, robots: int) -> AsyncIterator[tuple[list[Process], aiohttp.ClientSession]]:
    """A fleet whose daemons have so many robots each, and a session for their APIs."""
    async with fleet(daemons) as hosts, contextlib.AsyncExitStack() as stack:
        tasks = await stack.enter_async_context(asyncio.TaskGroup())
        running = []
        for number, host in enumerate(hosts):
            for robot in range(robots):
                name = f"robot_{number * robots + robot}"
                device = await stack.enter_async_context(fake_device(host.tcp, robot_topics(name)))
                running.append(tasks.create_task(talk(device)))
        yield hosts, await stack.enter_async_context(aiohttp.ClientSession())
        for task in running:
            task.cancel()


@contextlib.asynccontextmanager
async def fleet(count: int) -> AsyncIterator[list[Process]]:
    """Daemons that are connected to the first one, and find the others by it."""
    ports = [free_port() for _ in range(count)]
    with tempfile.TemporaryDirectory() as folder:
        async with contextlib.AsyncExitStack() as stack:
            tasks = await stack.enter_async_context(asyncio.TaskGroup())
            hosts, reading = [], []
            for number, port in enumerate(ports):
                config = Path(folder) / f"{number}.toml"
                connect = [f"tcp/127.0.0.1:{ports[0]}"] if number else []
                config.write_text(
                    f'[zenoh]\nname = "host-{number}"\nlisten = ["tcp/127.0.0.1:{port}"]\n'
                    f"connect = {json.dumps(connect)}\nmulticast = false\n"
                )
                host = await stack.enter_async_context(serve("--config", str(config), program=(HOSTLINK,)))
                hosts.append(host)
                reading.append(tasks.create_task(read_away(host)))
            yield hosts
            for task in reading:
                task.cancel()


async def read_away(host: Process) -> None:
    """Read the log, so that the pipe does not fill up."""
    stderr = host.child.stderr
    while stderr is not None and await stderr.read(1 << 16):
        pass


async def talk(device: Any) -> None:
    """Publish poses and request the time, as every robot does."""
    count = 0
    while True:
        count += 1
        with contextlib.suppress(ConnectionError):
            await device.send(pose(count * 0.001))
        if count % 20 == 0:
            with contextlib.suppress(ConnectionError):
                await device.send(TIME)
        await asyncio.sleep(POSE_INTERVAL_S)


async def all_known(session: aiohttp.ClientSession, hosts: list[Process], count: int) -> float:
    """Seconds until every daemon shows every robot as connected."""
    loop = asyncio.get_running_loop()
    began_s = loop.time()
    for host in hosts:
        await until(session, host, lambda robots: sum(robot["connected"] for robot in robots) >= count)
    return loop.time() - began_s


async def until(session: aiohttp.ClientSession, host: Process, is_so: Callable[[list[dict[str, Any]]], bool]) -> None:
    """Read a daemon's robots until they are as wanted."""
    async with asyncio.timeout(FLEET_TIMEOUT_S):
        for _ in itertools.count():
            if is_so(await robots_of(session, host)):
                return
            await asyncio.sleep(0.1)


async def robots_of(session: aiohttp.ClientSession, host: Process) -> list[dict[str, Any]]:
    """Return the robots that REST lists."""
    async with session.get(f"{host.url}/api/robots") as answer:
        listed: list[dict[str, Any]] = (await answer.json())["robots"]
        return listed


async def read_page(session: aiohttp.ClientSession, host: Process) -> None:
    """The events of an open page."""
    async with session.get(f"{host.url}/api/events", timeout=aiohttp.ClientTimeout(total=None)) as answer:
        async for _ in answer.content.iter_any():
            pass


async def costs(hosts: list[Process], seconds: float) -> dict[str, Any]:
    """CPU, memory and Zenoh's traffic of a daemon, over this time."""
    pids = [host.child.pid for host in hosts]
    cpu_before, sent_before = [cpu_s(pid) for pid in pids], traffic(pids)
    await asyncio.sleep(seconds)
    cpu = [100 * (cpu_s(pid) - before) / seconds for pid, before in zip(pids, cpu_before, strict=True)]
    sent = {pid: (after - sent_before.get(pid, 0)) / seconds / 1000 for pid, after in traffic(pids).items()}
    return {
        "core_percent": {"mean": round(statistics.mean(cpu), 2), "most": round(max(cpu), 2)},
        "sent_kB_s": {"mean": round(statistics.mean(sent.values()), 2), "most": round(max(sent.values()), 2)},
        "memory_MiB": round(statistics.mean(memory_mib(pid) for pid in pids), 1),
    }


def cpu_s(pid: int) -> float:
    """Return the CPU time of a process."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def memory_mib(pid: int) -> float:
    """Return the resident memory of a process."""
    found = re.search(r"VmRSS:\s+(\d+)", Path(f"/proc/{pid}/status").read_text())
    return int(found[1]) / 1024 if found else 0.0


def traffic(pids: list[int]) -> dict[int, int]:
    """Bytes that each process has sent to the others of them, by the kernel's counts."""
    listed = subprocess.run(["ss", "-tinpOH", "state", "established"], capture_output=True, text=True, check=True)
    rows = []
    for line in listed.stdout.splitlines():
        pid, sent = re.search(r"pid=(\d+)", line), re.search(r"bytes_sent:(\d+)", line)
        ends = line.split()[2:4]
        if pid and int(pid[1]) in pids and len(ends) > 1:
            rows.append((int(pid[1]), ends[0], ends[1], int(sent[1]) if sent else 0))
    own = {local: pid for pid, local, _, _ in rows}
    total = dict.fromkeys(pids, 0)
    for pid, _, other, sent_bytes in rows:
        if other in own:
            total[pid] += sent_bytes
    return total


async def drive(session: aiohttp.ClientSession, hosts: list[Process], seconds: float) -> dict[str, Any]:
    """Drive a robot of the last daemon from the first one and, as the yardstick, a robot of the first one itself."""
    answers: dict[str, Callable[[], None]] = {}
    async with session.ws_connect(hosts[0].url) as program, asyncio.TaskGroup() as reading:
        reader = reading.create_task(_read_answers(program, answers))
        async with asyncio.TaskGroup() as driving:
            far, near = [
                driving.create_task(_drive_one(session, (hosts[0], host), name, program, answers, seconds))
                for host, name in ((hosts[-1], "driven_far"), (hosts[0], "driven_near"))
            ]
        reader.cancel()
    return {**far.result(), "near": near.result()}


async def _read_answers(program: aiohttp.ClientWebSocketResponse, answers: dict[str, Callable[[], None]]) -> None:
    async for message in program:
        answer = message.json()
        if answer.get("op") == "drive_result" and answer["result"]:
            answers.pop(answer["id"])()


async def _drive_one(
    session: aiohttp.ClientSession,
    ends: tuple[Process, Process],
    name: str,
    program: aiohttp.ClientWebSocketResponse,
    answers: dict[str, Callable[[], None]],
    seconds: float,
) -> dict[str, Any]:
    """The latencies of commands from a program at the first daemon to a device at the second one."""
    loop = asyncio.get_running_loop()
    first, last = ends
    not_arrived: dict[int, float] = {}  # a velocity is repeated towards the device
    to_device: list[float] = []
    to_answer: list[float] = []
    async with fake_device(last.tcp, robot_topics(name)) as device, asyncio.TaskGroup() as tasks:
        await until(session, first, lambda robots: any(each["name"] == name and each["connected"] for each in robots))

        async def arrive() -> None:
            while True:
                linear, _ = await device.velocity()
                begun_s = not_arrived.pop(round(linear / STEP_M_S), None)
                if begun_s is not None:
                    to_device.append(1000 * (loop.time() - begun_s))

        def answered(sent_s: float) -> None:
            to_answer.append(1000 * (loop.time() - sent_s))

        arriving = tasks.create_task(arrive())
        for number in range(1, round(seconds / COMMAND_INTERVAL_S) + 1):
            command = f"{name} {number}"
            not_arrived[number] = loop.time()
            answers[command] = functools.partial(answered, not_arrived[number])
            await program.send_json(
                {"op": "drive", "id": command, "robot": name, "linear": number * STEP_M_S, "angular": 0.0}
            )
            await asyncio.sleep(COMMAND_INTERVAL_S)
        await asyncio.sleep(0.5)
        arriving.cancel()
    return {"to_device_ms": _spread(to_device), "to_answer_ms": _spread(to_answer)}


def _spread(values: list[float]) -> dict[str, float]:
    hundredths = statistics.quantiles(values, n=100)
    return {
        "count": len(values),
        "median": round(hundredths[49], 2),
        "p99": round(hundredths[98], 2),
        "longest": round(max(values), 2),
    }


if __name__ == "__main__":
    sys.exit(main())
