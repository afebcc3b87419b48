"""Real network faults: the robot in a network namespace of its own, and the air between it and the host in here.

Needs root, iproute2 and /dev/net/tun, no module of the kernel: each end of the air is a TUN device, and what one
gives the other gets, unless it is lost, and as late as is wanted. What TCP makes of that is the kernel's own. The robot
is driven meanwhile. Prints a JSON object a fault.
"""

import argparse
import asyncio
import contextlib
import fcntl
import itertools
import json
import os
import random
import struct
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from hostlink.client import Host, connect
from hostlink.errors import HostlinkError

BIN = Path(sys.executable).parent
NAMESPACE = "hostlink-robot"
HOST_IP, ROBOT_IP, OTHER_IP = "10.77.0.1", "10.77.0.2", "10.77.0.3"
API = "127.0.0.1:19090"
TUNSETIFF, IFF_TUN, IFF_NO_PI = 0x400454CA, 0x0001, 0x1000
PACKET_BYTES = 2048
SETTLE_S = 3.0
TIMEOUT_S = 60.0
READY_GAP_S = 0.5  # odometry has recovered when it arrives as often as this


class Air:
    """Carries packets between two TUN devices."""

    def __init__(self, seed: int) -> None:
        self.loss = 0.0
        self.delay_s = (0.0, 0.0)  # from, to; what is delayed differently arrives in another order
        self.is_cut = False
        self.lost = self.carried = 0
        self._random = random.Random(seed)  # noqa: S311 - to be repeated, not to be secret

    def carry(self, source: int, target: int) -> None:
        """A packet is there."""
        packet = os.read(source, PACKET_BYTES)
        if self.is_cut or self._random.random() < self.loss:
            self.lost += 1
            return
        self.carried += 1
        delay_s = self._random.uniform(*self.delay_s)
        asyncio.get_running_loop().call_later(delay_s, _put, target, packet)


def _put(target: int, packet: bytes) -> None:
    with contextlib.suppress(OSError):  # the device is down for a moment: lost, as on the air
        os.write(target, packet)


def ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True)


def tun(name: str) -> int:
    """A TUN device; it is gone when the descriptor is closed."""
    device = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
    fcntl.ioctl(device, TUNSETIFF, struct.pack("16sH22x", name.encode(), IFF_TUN | IFF_NO_PI))
    return device


@contextlib.contextmanager
def two_hosts() -> Iterator[tuple[int, int]]:
    """The robot's namespace, and both ends of the air, for the length of the block."""
    ip("netns", "add", NAMESPACE)
    ends: list[int] = []
    try:
        ends += [tun("hostlink-host"), tun("hostlink-dev")]
        ip("address", "add", f"{HOST_IP}/24", "dev", "hostlink-host")
        ip("link", "set", "hostlink-host", "up")
        ip("link", "set", "hostlink-dev", "netns", NAMESPACE)
        ip("-n", NAMESPACE, "address", "add", f"{ROBOT_IP}/24", "dev", "hostlink-dev")
        ip("-n", NAMESPACE, "link", "set", "hostlink-dev", "up")
        yield ends[0], ends[1]
    finally:
        for end in ends:
            os.close(end)
        ip("netns", "delete", NAMESPACE)


@contextlib.asynccontextmanager
async def running(*words: str) -> AsyncIterator[None]:
    """A program, for the length of the block."""
    child = await asyncio.create_subprocess_exec(*words, stderr=asyncio.subprocess.DEVNULL)
    try:
        yield
    finally:
        child.terminate()
        await child.wait()


class Watch:
    """Times at which odometry arrived."""

    def __init__(self) -> None:
        self.times_s: list[float] = []
        self.count = 0  # with those that came so close together that only the newest was reported
        self.came = asyncio.Event()

    async def watch(self, host: Host) -> None:
        async for state in host.robot("robot_0").odometry():
            self.times_s.append(time.monotonic())
            self.count = state["count"]
            self.came.set()

    def largest_gap_s(self, since_s: float, until_s: float) -> float:
        inside = [since_s, *(at_s for at_s in self.times_s if since_s <= at_s <= until_s), until_s]
        return max(after - before for before, after in itertools.pairwise(inside))

    async def back_s(self, since_s: float) -> float:
        """Seconds from then until odometry arrives regularly again."""
        async with asyncio.timeout(TIMEOUT_S):
            while True:
                self.came.clear()
                await self.came.wait()
                if self.times_s[-1] >= since_s and self.times_s[-1] - self.times_s[-2] < READY_GAP_S:
                    return self.times_s[-2] - since_s


async def drive(host: Host) -> None:
    """Keep it driving; what a cut drops is commanded again."""
    while True:
        with contextlib.suppress(HostlinkError):
            await host.robot("robot_0").drive(0.1, 0.3)
        await asyncio.sleep(0.5)


async def measure(ends: tuple[int, int], seconds: float, seed: int) -> None:
    air, watch, loop = Air(seed), Watch(), asyncio.get_running_loop()
    loop.add_reader(ends[0], air.carry, *ends)
    loop.add_reader(ends[1], air.carry, *reversed(ends))
    hostlink = str(BIN / "hostlink")
    async with (
        running(hostlink, "serve", "--listen", f"{HOST_IP}:11411", "--api", API),
        running("ip", "netns", "exec", NAMESPACE, hostlink, "sim", "--connect", f"{HOST_IP}:11411"),
        connected() as host,
        asyncio.TaskGroup() as tasks,
    ):
        children = [tasks.create_task(watch.watch(host)), tasks.create_task(drive(host))]
        await watch.came.wait()
        await asyncio.sleep(SETTLE_S)
        for what, loss, delay_s in (
            ("nothing", 0.0, (0.0, 0.0)),
            ("5 % of the packets lost", 0.05, (0.0, 0.0)),
            ("delay of 100 +- 50 ms, so another order", 0.0, (0.05, 0.15)),
            ("both", 0.05, (0.05, 0.15)),
        ):
            await spoil(air, watch, host, what=what, loss=loss, delay_s=delay_s, seconds=seconds)
        air.loss, air.delay_s = 0.0, (0.0, 0.0)
        await black_out(air, watch, 10.0)
        await change_address(watch)
        for child in children:
            child.cancel()


@contextlib.asynccontextmanager
async def connected() -> AsyncIterator[Host]:
    """The client, once the daemon listens and the robot is there."""
    async with asyncio.timeout(TIMEOUT_S):
        while True:
            try:
                async with connect(f"http://{API}") as probe:
                    await probe.robot("robot_0").state()
            except HostlinkError:
                await asyncio.sleep(0.2)
            else:
                break
    async with connect(f"http://{API}") as host:
        yield host


async def spoil(
    air: Air, watch: Watch, host: Host, *, what: str, loss: float, delay_s: tuple[float, float], seconds: float
) -> None:
    """Let the air be bad for a while."""
    lost_before, carried_before = air.lost, air.carried
    link = (await host.links())[0]["number"]
    air.loss, air.delay_s = loss, delay_s
    began_s, count_before = time.monotonic(), watch.count
    await asyncio.sleep(seconds)
    until_s = time.monotonic()
    now = (await host.links())[0]
    report(
        fault=what,
        seconds=seconds,
        packets=air.carried - carried_before,
        packets_lost=air.lost - lost_before,
        poses=watch.count - count_before,
        largest_gap_s=round(watch.largest_gap_s(began_s, until_s), 2),
        same_link=now["number"] == link,
        skipped_bytes=now["skipped_bytes"],
    )


async def black_out(air: Air, watch: Watch, seconds: float) -> None:
    air.is_cut = True
    await asyncio.sleep(seconds)
    air.is_cut = False
    report(fault=f"black-out of {seconds:g} s", recovery_s=round(await watch.back_s(time.monotonic()), 2))
    await asyncio.sleep(SETTLE_S)


async def change_address(watch: Watch) -> None:
    ip("-n", NAMESPACE, "address", "flush", "dev", "hostlink-dev")
    ip("-n", NAMESPACE, "address", "add", f"{OTHER_IP}/24", "dev", "hostlink-dev")
    report(fault="the robot's address changes", recovery_s=round(await watch.back_s(time.monotonic()), 2))


def report(**facts: object) -> None:
    print(json.dumps(facts), flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0, help="of each kind of bad air (%(default)s)")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    with two_hosts() as ends:
        asyncio.run(measure(ends, arguments.seconds, arguments.seed))


if __name__ == "__main__":
    main()
