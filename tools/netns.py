"""Real network faults: host and robot in two network namespaces with a veth pair between; needs root and iproute2.

A black-out of ten seconds (the robot's end is taken down) and a change of the robot's address: the time from the
network's return until the robot is ready again, as the daemon's log tells it. Prints a JSON object a fault.
"""

import argparse
import asyncio
import contextlib
import json
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

BIN = Path(sys.executable).parent
HOST, ROBOT = "hostlink-host", "hostlink-robot"
HOST_IP, ROBOT_IP, OTHER_IP = "10.77.0.1", "10.77.0.2", "10.77.0.3"
TIMEOUT_S = 60.0
SETTLE_S = 3.0


def ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True)


@contextlib.contextmanager
def two_hosts() -> Iterator[None]:
    """The namespaces and the cable, for the length of the block."""
    made = []
    try:
        for name in (HOST, ROBOT):
            ip("netns", "add", name)
            made.append(name)
        ip("link", "add", "cable", "netns", HOST, "type", "veth", "peer", "name", "cable", "netns", ROBOT)
        for name, address in ((HOST, HOST_IP), (ROBOT, ROBOT_IP)):
            ip("-n", name, "address", "add", f"{address}/24", "dev", "cable")
            ip("-n", name, "link", "set", "cable", "up")
            ip("-n", name, "link", "set", "lo", "up")  # the API's
        yield
    finally:
        for name in made:
            ip("netns", "delete", name)


async def run(namespace: str, *words: str) -> asyncio.subprocess.Process:
    return await asyncio.create_subprocess_exec(
        "ip", "netns", "exec", namespace, str(BIN / "hostlink"), *words, stderr=asyncio.subprocess.PIPE
    )


async def appeared(daemon: asyncio.subprocess.Process) -> float:
    """When the robot is ready again, by this program's clock."""
    assert daemon.stderr is not None  # noqa: S101 - a pipe was asked for
    async with asyncio.timeout(TIMEOUT_S):
        while line := await daemon.stderr.readline():
            if not line.startswith(b"{"):
                raise RuntimeError(line.decode())
            event: dict[str, Any] = json.loads(line)
            if event["event"] == "robot.appeared":
                return time.monotonic()
    raise EOFError("the daemon ended")


async def measure(black_out_s: float) -> None:
    daemon = await run(HOST, "serve", "--listen", f"{HOST_IP}:11411")
    robot = await run(ROBOT, "sim", "--connect", f"{HOST_IP}:11411")
    try:
        await appeared(daemon)
        await asyncio.sleep(SETTLE_S)
        ip("-n", ROBOT, "link", "set", "cable", "down")
        await asyncio.sleep(black_out_s)
        back_s = time.monotonic()
        ip("-n", ROBOT, "link", "set", "cable", "up")
        tell("black-out", black_out_s, await appeared(daemon) - back_s)
        await asyncio.sleep(SETTLE_S)
        back_s = time.monotonic()
        ip("-n", ROBOT, "address", "flush", "dev", "cable")
        ip("-n", ROBOT, "address", "add", f"{OTHER_IP}/24", "dev", "cable")
        tell("address change", 0.0, await appeared(daemon) - back_s)
    finally:
        for process in (robot, daemon):
            process.terminate()
            await process.communicate()


def tell(fault: str, lasted_s: float, recovery_s: float) -> None:
    print(json.dumps({"fault": fault, "lasted_s": lasted_s, "recovery_s": round(recovery_s, 2)}), flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--black-out", type=float, default=10.0, help="seconds (%(default)s)")
    arguments = parser.parse_args()
    with two_hosts():
        asyncio.run(measure(arguments.black_out))


if __name__ == "__main__":
    main()
