"""A network that is cut between two daemons of a fleet: each in a network namespace of its own, joined by a cable.

Needs root and iproute2. A simulated robot is at the first daemon, and driven from the second. The cable is pulled, and
plugged in again. Prints JSON: when the robot's gate was at zero, when the second daemon showed it as not connected, and
when it showed it again; ends with status 1 when that was later than promised.
"""

import contextlib
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

BIN = Path(sys.executable).parent
NAMES, ADDRESSES = ("zf-a", "zf-b"), ("10.79.0.1", "10.79.0.2")
STOP_S, SHOWN_S, AGAIN_S = 0.8, 2.0, 20.0
TIMEOUT_S = 30.0


def main() -> int:
    """Cut, measure, print."""
    with tempfile.TemporaryDirectory() as folder, namespaces(), contextlib.ExitStack() as stack:
        for number, name in enumerate(NAMES):
            config = Path(folder) / f"{name}.toml"
            config.write_text(
                f'[zenoh]\nname = "{name}"\nlisten = ["tcp/{ADDRESSES[number]}:7447"]\n'
                f'connect = ["tcp/{ADDRESSES[1 - number]}:7447"]\nmulticast = false\n'
            )
            started = ("serve", "--config", str(config), "--listen", "127.0.0.1:11411", "--api", "127.0.0.1:9090")
            stack.enter_context(running(name, *started))
        stack.enter_context(running(NAMES[0], "sim"))
        measured = cut()
    print(json.dumps(measured))
    limits = {"stopped_s": STOP_S, "shown_s": SHOWN_S, "shown_again_s": AGAIN_S}
    return 1 if any(measured[name] > limit for name, limit in limits.items()) else 0


def cut() -> dict[str, float]:
    """Drive, pull the cable, plug it in again."""
    until(lambda: view(NAMES[1]).get("connected"))
    with running(NAMES[1], "pub", "/robot_0/cmd_vel", '{"linear": {"x": 0.2}}', "--count", "0"):
        until(lambda: view(NAMES[0]).get("velocity", {}).get("linear_m_s"))
        ip("-n", NAMES[0], "link", "set", "zf0", "down")
        pulled_s = time.monotonic()
        until(lambda: not view(NAMES[0])["velocity"]["linear_m_s"])
        stopped_s = time.monotonic() - pulled_s
        until(lambda: not view(NAMES[1])["connected"])
        shown_s = time.monotonic() - pulled_s
        time.sleep(3)
        ip("-n", NAMES[0], "link", "set", "zf0", "up")
    plugged_s = time.monotonic()
    until(lambda: view(NAMES[1])["connected"])
    again_s = time.monotonic() - plugged_s
    with running(NAMES[1], "pub", "/robot_0/cmd_vel", '{"linear": {"x": 0.1}}', "--count", "0"):
        until(lambda: view(NAMES[0])["velocity"]["linear_m_s"])
    return {"stopped_s": round(stopped_s, 2), "shown_s": round(shown_s, 2), "shown_again_s": round(again_s, 2)}


def until(is_so: Callable[[], object]) -> None:
    """Wait; a look costs some ten milliseconds."""
    ends_s = time.monotonic() + TIMEOUT_S
    while not is_so():
        if time.monotonic() > ends_s:
            raise TimeoutError("the fleet did not do what was expected")


def view(name: str) -> dict[str, Any]:
    """The robot as the daemon in this namespace shows it; empty: it does not."""
    request = ("curl", "-s", "-m", "1", "http://127.0.0.1:9090/api/robots/robot_0")
    found = subprocess.run(["ip", "netns", "exec", name, *request], capture_output=True, check=False)
    shown: dict[str, Any] = json.loads(found.stdout or "{}")
    return {} if "error" in shown else shown


@contextlib.contextmanager
def namespaces() -> Iterator[None]:
    """Two, and the cable between them."""
    for name in NAMES:
        ip("netns", "add", name)
    try:
        ip("link", "add", "zf0", "netns", NAMES[0], "type", "veth", "peer", "name", "zf0", "netns", NAMES[1])
        for name, address in zip(NAMES, ADDRESSES, strict=True):
            ip("-n", name, "address", "add", f"{address}/24", "dev", "zf0")
            ip("-n", name, "link", "set", "lo", "up")
            ip("-n", name, "link", "set", "zf0", "up")
        yield
    finally:
        for name in NAMES:
            ip("netns", "del", name)


@contextlib.contextmanager
def running(namespace: str, *arguments: str) -> Iterator[None]:
    """A hostlink command in a namespace."""
    command = ["ip", "netns", "exec", namespace, str(BIN / "hostlink"), *arguments]
    child = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        yield
    finally:
        child.terminate()
        child.wait()


def ip(*arguments: str) -> None:
    """A command of iproute2."""
    subprocess.run(["ip", *arguments], check=True)


if __name__ == "__main__":
    sys.exit(main())
