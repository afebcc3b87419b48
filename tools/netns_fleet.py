"""A host that vanishes from a fleet: each daemon in a network namespace of its own, all on one bridge.

Needs root and iproute2. Each host has a daemon, a robot, and a program there that drives it with `drive`, which tells
when each command was sent. A program that is silent for a lease lets go of its robot, and may drive it again after a
stop: on a machine that is too busy, a program of this tool does so against its will. By the times of its own sending
this is told apart, in `let_go_s`: for how long it was silent. One host after the other
is cut off (`--fault cut`), also killed in the same moment (`power`), or half of them at once (`half`). Four seconds
later a healthy host stops every robot. Prints JSON: for how long healthy hosts did not hear each other, when the stop
reached their robots and how it was answered, when the hosts were seen again after the network was, and when the stop
was in force at those that were cut off; with the load of the machine in the last minute. Ends with status 1 when one of
them was later than promised.
"""

import argparse
import asyncio
import contextlib
import ctypes
import functools
import itertools
import json
import os
import signal
import socket
import struct
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import aiohttp

from hostlink.core.robot.admission import LEASE_S
from hostlink.errors import RefusalKind
from tests.support.background import meanwhile
from tests.support.fake_device import FakeDevice, pose, robot_topics
from tools.crowd import TIME

BIN = Path(sys.executable).parent
CLONE_NEWNET = 0x40000000
DEAF_S, STOPPED_S, AGAIN_S, IN_FORCE_S = 2.0, 1.0, 20.0, 3.0  # promised; the machine may be busy
STOP_AFTER_S, WATCH_S, POLL_S, COMMAND_S, TIMEOUT_S = 4.0, 12.0, 0.5, 0.1, 180.0
SPEED_M_S = 0.2
API, DEVICES = "http://127.0.0.1:9090", ("127.0.0.1", 11411)


def main() -> int:
    """Measure, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hosts", type=int, default=4)
    parser.add_argument("--times", type=int, default=3)
    parser.add_argument("--fault", choices=("cut", "power", "half"), default="cut")
    parser.add_argument("--settings", default="", help="more lines of [zenoh]")
    parser.add_argument("--prefix", default="fleet", help="of the namespaces, for several runs side by side")
    arguments = parser.parse_args()
    with namespaces(arguments.prefix, arguments.hosts), tempfile.TemporaryDirectory() as folder:
        runs = asyncio.run(measure(arguments, Path(folder)))
    worst = {name: max(run[name] for run in runs) for name in ("deaf_s", "stopped_s", "again_s", "in_force_s")}
    answers = sorted({run["answer"] for run in runs})
    print(json.dumps({"hosts": arguments.hosts, "fault": arguments.fault, "worst": worst, "answers": answers}))
    promised = {"deaf_s": DEAF_S, "stopped_s": STOPPED_S, "again_s": AGAIN_S, "in_force_s": IN_FORCE_S}
    return 1 if answers != [503] or any(worst[name] > limit for name, limit in promised.items()) else 0


class Host:
    """A daemon in its namespace, its robot, and a program that drives it."""

    def __init__(self, prefix: str, number: int, config: Path) -> None:
        self.number, self.namespace, self.robot = number, f"{prefix}-{number}", f"robot_{number}"
        self._hub = f"{prefix}-hub"
        self.velocities: list[tuple[float, float]] = []  # when, m/s
        self.sent_s: list[float] = []  # times of the program's commands
        self.is_driving = False
        self.may_arm = True  # until a stop is measured
        self._config = config
        self._child: subprocess.Popen[bytes] | None = None
        connector = aiohttp.TCPConnector(socket_factory=lambda _: self._socket())
        self._session = aiohttp.ClientSession(API, connector=connector, timeout=aiohttp.ClientTimeout(total=5))

    def start(self) -> None:
        """Start the daemon."""
        command = ("ip", "netns", "exec", self.namespace, str(BIN / "hostlink"), "serve", "--config", str(self._config))
        ends = ("--listen", f"{DEVICES[0]}:{DEVICES[1]}", "--api", API.removeprefix("http://"))
        self._child = subprocess.Popen([*command, *ends], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    def end(self, how: signal.Signals) -> None:
        """End the daemon; `ip netns exec` has become it."""
        if self._child is not None:
            self._child.send_signal(how)
            self._child.wait()

    def plug(self, *, is_in: bool) -> None:
        """Plug its cable into the switch, or pull it there: the other hosts notice nothing."""
        ip("-n", self._hub, "link", "set", f"port{self.number}", "up" if is_in else "down")

    async def aclose(self) -> None:
        """End everything."""
        self.end(signal.SIGTERM)
        await self._session.close()

    async def work(self) -> None:
        """Be the robot, and the program that drives it."""
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self._be_robot())
            tasks.create_task(self._drive())

    async def request(self, method: str, path: str, **options: Any) -> tuple[int, dict[str, Any]]:
        """Return status and answer; (0, {}) without one."""
        try:
            async with self._session.request(method, path, **options) as answer:
                return answer.status, await answer.json()
        except (aiohttp.ClientError, TimeoutError, OSError):
            return 0, {}

    async def connected(self) -> set[str]:
        """The robots that the daemon shows as connected, with a pose of the last moment."""
        robots = (await self.request("GET", "/api/robots"))[1].get("robots", ())
        return {each["name"] for each in robots if each["connected"]}

    def stopped_after_s(self, since_s: float) -> tuple[float, float]:
        """Return the seconds until the robot was stopped for good, and for how long its program was silent.

        They are infinite if it still moves, and 0 if it was at zero already. If it moves again because its program let
        go, what follows does not count; otherwise the silence is 0.
        """
        velocities, silence_s = self._until_let_go(since_s)
        last_s = max((at_s for at_s, speed in velocities if speed), default=since_s)
        zero_s = min((at_s for at_s, speed in velocities if not speed and at_s > last_s), default=float("inf"))
        return max(zero_s - since_s, 0.0), silence_s

    def _until_let_go(self, since_s: float) -> tuple[list[tuple[float, float]], float]:
        """Return the velocities until the robot begins to move after a lease in which its program sent nothing."""
        for number, ((_, before), (at_s, speed)) in enumerate(itertools.pairwise(self.velocities), 1):
            if at_s > since_s and speed and not before:
                silence_s = self.longest_silence_s(since_s, at_s)
                if silence_s >= LEASE_S:
                    return self.velocities[:number], silence_s
        return self.velocities, 0.0

    def longest_silence_s(self, since_s: float, until_s: float) -> float:
        """Return the longest time between two commands of the program, the second of which is of this time."""
        ends = itertools.pairwise(self.sent_s)
        return max((after_s - before_s for before_s, after_s in ends if since_s < after_s <= until_s), default=0.0)

    async def _be_robot(self) -> None:
        while True:
            with contextlib.suppress(OSError, EOFError, ExceptionGroup):
                made = self._socket()
                await asyncio.get_running_loop().sock_connect(made, DEVICES)
                reader, writer = await asyncio.open_connection(sock=made)
                device = FakeDevice(reader, writer)
                await device.announce(robot_topics(self.robot))
                async with meanwhile(self._talk(device)):
                    while True:
                        twist = struct.unpack("<6d", await device.frame(100))
                        self.velocities.append((now_s(), twist[0]))
            await asyncio.sleep(0.5)

    async def _talk(self, device: FakeDevice) -> None:
        for count in range(10**9):
            with contextlib.suppress(OSError):
                await device.send(pose(count * 0.001) + (TIME if count % 20 == 0 else b""))
            await asyncio.sleep(0.1)

    async def _drive(self) -> None:
        """Send commands without waiting for their answers."""
        while True:
            with contextlib.suppress(aiohttp.ClientError, OSError, ExceptionGroup):
                async with self._session.ws_connect("/") as socket, meanwhile(self._arm(socket)):
                    while not socket.closed:
                        if self.is_driving:
                            self.sent_s.append(now_s())
                            await self._send(socket, SPEED_M_S, self.sent_s[-1])
                        await asyncio.sleep(COMMAND_S)
            await asyncio.sleep(0.5)

    async def _arm(self, socket: aiohttp.ClientWebSocketResponse) -> None:
        """Read the answers. A pause of a busy daemon disarms its programs: let go, unless a stop is measured."""
        async for message in socket:
            if message.type is aiohttp.WSMsgType.TEXT:
                answer = json.loads(message.data)
                if answer.get("kind") == RefusalKind.DISARMED and self.may_arm:
                    await self._send(socket, 0.0, now_s())

    async def _send(self, socket: aiohttp.ClientWebSocketResponse, speed_m_s: float, sent_s: float) -> None:
        command = {"op": "drive", "id": "1", "robot": self.robot, "linear": speed_m_s, "angular": 0.0}
        await socket.send_str(json.dumps(command | {"sent_s": sent_s}))

    def _socket(self) -> socket.socket:
        with inside(self.namespace):
            made = socket.socket()
        made.setblocking(False)
        return made


async def measure(arguments: argparse.Namespace, folder: Path) -> list[dict[str, float]]:
    """Run a fleet, and let hosts vanish from it."""
    async with contextlib.AsyncExitStack() as stack:
        tasks = await stack.enter_async_context(asyncio.TaskGroup())
        hosts, working = [], []
        for number in range(arguments.hosts):
            config = folder / f"{number}.toml"
            connect = f'connect = ["tcp/{address(0)}:7447"]\n' if number else ""
            config.write_text(
                f'[zenoh]\nname = "host-{number}"\nlisten = ["tcp/{address(number)}:7447"]\n{connect}'
                f"multicast = false\n{arguments.settings}\n"
            )
            hosts.append(Host(arguments.prefix, number, config))
            stack.push_async_callback(hosts[-1].aclose)
            hosts[-1].start()
            working.append(tasks.create_task(hosts[-1].work()))
        try:
            await all_seen(hosts)
            return [await vanish(hosts, number, arguments.fault) for number in range(arguments.times)]
        finally:
            for task in working:
                task.cancel()


async def vanish(hosts: list[Host], number: int, fault: str) -> dict[str, float]:
    """Let one host or half of them vanish, watch the others, and let it come back."""
    count = len(hosts) // 2 if fault == "half" else 1
    gone = [hosts[(number + 1 + each) % len(hosts)] for each in range(count)]
    healthy = [host for host in hosts if host not in gone]
    for host in hosts:
        host.is_driving = True
    await until(lambda: asyncio.sleep(0, all(host.velocities and host.velocities[-1][1] for host in hosts)))
    for host in hosts:
        host.may_arm = False
    for host in gone:
        host.plug(is_in=False)
        if fault == "power":
            host.end(signal.SIGKILL)
    began_s = now_s()
    async with asyncio.TaskGroup() as tasks:
        watched = [tasks.create_task(deaf_s(host, healthy)) for host in healthy]
        await asyncio.sleep(STOP_AFTER_S)
        stop_s = now_s()
        status, _ = await healthy[0].request("POST", "/api/stop")
        await asyncio.sleep(1.0)
    stops = {host.robot: host.stopped_after_s(stop_s) for host in healthy}
    silent_s = [host.longest_silence_s(stop_s, now_s()) for host in healthy]
    up_s = now_s()
    for host in gone:
        host.plug(is_in=True)
        if fault == "power":
            host.is_driving = False
            host.start()
    await all_seen(hosts)
    again_s = now_s() - up_s
    await asyncio.sleep(IN_FORCE_S)
    later = {} if fault == "power" else {host.robot: host.stopped_after_s(up_s) for host in gone}
    in_force_s = max((after_s for after_s, _ in later.values()), default=0.0) - again_s
    for host in hosts:
        host.is_driving, host.may_arm = False, True
    await asyncio.sleep(1.0)
    found = {
        "deaf_s": max(each.result() for each in watched),
        "stopped_s": max(after_s for after_s, _ in stops.values()),
        "answer": status,
        "again_s": again_s,
        "in_force_s": max(in_force_s, 0.0),
    }
    shown = {name: round(value, 2) for name, value in found.items()}
    ran = {"gone": [host.number for host in gone], "watched_s": round(up_s - began_s, 1), "load": os.getloadavg()[0]}
    let_go = {robot: round(silence_s, 2) for robot, (_, silence_s) in (stops | later).items() if silence_s}
    steady = sum(silence_s < LEASE_S for silence_s in silent_s)  # programs that never were silent for a lease
    print(json.dumps({**ran, **shown, "let_go_s": let_go, "steady": f"{steady} of {len(healthy)}"}), flush=True)
    return found


async def deaf_s(host: Host, healthy: list[Host]) -> float:
    """The longest time for which a healthy host did not show the robot of another healthy one."""
    wanted, ends_s, longest_s, since_s = {each.robot for each in healthy}, now_s() + WATCH_S, 0.0, now_s()
    while now_s() < ends_s:
        if wanted <= await host.connected():
            since_s = now_s()
        longest_s = max(longest_s, now_s() - since_s)
        await asyncio.sleep(POLL_S)
    return longest_s


async def all_seen(hosts: list[Host]) -> None:
    """Wait until each host shows every robot."""
    wanted = {host.robot for host in hosts}
    for host in hosts:
        await until(functools.partial(sees, host, wanted))


async def sees(host: Host, wanted: set[str]) -> bool:
    return wanted <= await host.connected()


async def until(is_so: Callable[[], Any]) -> None:
    """Wait for it."""
    async with asyncio.timeout(TIMEOUT_S):
        while not await is_so():  # noqa: ASYNC110 - the state of other processes
            await asyncio.sleep(0.1)


def now_s() -> float:
    return asyncio.get_running_loop().time()


def address(number: int) -> str:
    return f"10.79.0.{number + 1}"


@contextlib.contextmanager
def inside(namespace: str) -> Iterator[None]:
    """Be in a network namespace; a socket stays in the one where it was made."""
    libc = ctypes.CDLL(None, use_errno=True)
    with Path("/proc/thread-self/ns/net").open() as own, Path("/run/netns", namespace).open() as other:
        if libc.setns(other.fileno(), CLONE_NEWNET):
            raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()), namespace)
        try:
            yield
        finally:
            libc.setns(own.fileno(), CLONE_NEWNET)


@contextlib.contextmanager
def namespaces(prefix: str, count: int) -> Iterator[None]:
    """One for each host, and one with the bridge between them, as a switch."""
    hub, names = f"{prefix}-hub", [f"{prefix}-{number}" for number in range(count)]
    with contextlib.ExitStack() as stack:
        for name in (hub, *names):
            ip("netns", "add", name)
            stack.callback(ip, "netns", "del", name)
        ip("-n", hub, "link", "add", "bridge0", "type", "bridge")
        ip("-n", hub, "link", "set", "bridge0", "up")
        for number, name in enumerate(names):
            port = f"port{number}"
            ip("link", "add", "eth0", "netns", name, "type", "veth", "peer", "name", port, "netns", hub)
            ip("-n", hub, "link", "set", port, "master", "bridge0")
            ip("-n", hub, "link", "set", port, "up")
            ip("-n", name, "address", "add", f"{address(number)}/24", "dev", "eth0")
            ip("-n", name, "link", "set", "lo", "up")
            ip("-n", name, "link", "set", "eth0", "up")
        yield


def ip(*arguments: str) -> None:
    """A command of iproute2."""
    subprocess.run(["ip", *arguments], check=True)


if __name__ == "__main__":
    sys.exit(main())
