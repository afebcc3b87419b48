"""Fleet with certificates and a daemon without one, in their own network. Run it in a network namespace.

`python -m tests.support.zenoh_strangers WAY FOLDER`: with `multicast` the stranger looks for others as Zenoh does by
default; with `gossip` a daemon with a certificate is connected to it in plain TCP, and names it to the fleet. Prints
JSON: where the fleet listens, whether the stranger saw the robot, and how many of its velocities were obeyed.
"""

import asyncio
import contextlib
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import zenoh

from hostlink.components.zenoh.settings import ZenohSettings
from hostlink.core.config import Config
from tests.support.daemon import Daemon, daemon
from tests.support.fake_device import FakeDevice, fake_device, robot_topics
from tests.support.waiting import expect
from tests.support.zenoh_certificates import make_authority, make_certificate
from tests.support.zenoh_fleet import drive, shown

ADDRESS, PORT = "10.80.0.1", 7447
COUNT = 20
MET_WITHIN_S = 5.0  # Zenoh's scouts go out after 1, 2 and 4 s
LISTENING = "0A"  # a state of /proc/net/tcp


def make_network() -> None:
    """Create a cable with multicast in addition to loopback; both its ends are here."""
    for line in (
        "link set lo up",
        "link add cable0 type veth peer name cable1",
        f"address add {ADDRESS}/24 dev cable0",
        "link set cable0 up multicast on",
        "link set cable1 up",
        "route add default dev cable0",
    ):
        subprocess.run(["ip", *line.split()], check=True)


def listeners() -> list[str]:
    """Sockets that accept or receive, but for those on 127.0.0.1, as `tcp 0100007F:1A2B`."""
    found = set()
    for kind in ("tcp", "tcp6", "udp", "udp6"):
        for line in Path(f"/proc/net/{kind}").read_text().splitlines()[1:]:
            _, local, _, state, *_ = line.split()
            if (kind.startswith("udp") or state == LISTENING) and not local.startswith("0100007F"):
                found.add(f"{kind} {local}")
    return sorted(found)


def certified(folder: Path, name: str, **settings: Any) -> Config:
    """A daemon as docs/fleet-security.md has it."""
    certificate, key = make_certificate(folder, name, ADDRESS)
    return Config(
        component_settings={
            "zenoh": ZenohSettings(name=name, ca=folder / "ca.pem", certificate=certificate, key=key, **settings)
        }
    )


@contextlib.contextmanager
def mole(folder: Path) -> Iterator[None]:
    """A session with a certificate of the authority that has plain neighbours, too, and names all to all."""
    certificate, key = map(str, make_certificate(folder, "mole", ADDRESS))
    settings = zenoh.Config()
    for name, value in {
        "listen/endpoints": [f"tcp/{ADDRESS}:7501", f"tls/{ADDRESS}:7500"],
        "connect/endpoints": [f"tls/{ADDRESS}:{PORT}"],
        "scouting/multicast/enabled": False,
        "transport/link/tls/root_ca_certificate": str(folder / "ca.pem"),
        "transport/link/tls/listen_certificate": certificate,
        "transport/link/tls/listen_private_key": key,
        "transport/link/tls/connect_certificate": certificate,
        "transport/link/tls/connect_private_key": key,
        "transport/link/tls/enable_mtls": True,
    }.items():
        settings.insert_json5(name, json.dumps(value))
    with zenoh.open(settings):
        yield


async def obeyed(stranger: Daemon, device: FakeDevice) -> int:
    """Count the stranger's velocities that reached the robot."""
    count = 0
    for number in range(COUNT):
        speed = 0.1 + number / 100
        status, _ = await drive(stranger, "robot_7", speed)
        count += status == 200 and await device.velocity_other_than((0.0, 0.0)) != (0.0, 0.0)
    return count


async def run(way: str, folder: Path) -> dict[str, Any]:
    make_authority(folder)
    plain = ZenohSettings(name="desk")
    if way == "gossip":
        plain = ZenohSettings(name="desk", connect=(f"tcp/{ADDRESS}:7501",), multicast=False)
    listen = (f"tls/{ADDRESS}:{PORT}",)
    async with contextlib.AsyncExitStack() as stack:
        lab = await stack.enter_async_context(daemon(certified(folder, "lab-1", listen=listen)))
        other = await stack.enter_async_context(daemon(certified(folder, "lab-2", connect=listen)))
        device = await stack.enter_async_context(fake_device(lab.tcp, robot_topics("robot_7")))
        await shown(other, "robot_7")
        found = {"listeners": listeners()}
        if way == "gossip":
            stack.enter_context(mole(folder))
        stranger = await stack.enter_async_context(daemon(Config(component_settings={"zenoh": plain})))
        with contextlib.suppress(AssertionError, TimeoutError):
            await expect(lambda: "robot_7" in stranger.hub.robots.remote, timeout_s=MET_WITHIN_S)
        is_seen = "robot_7" in stranger.hub.robots.remote
        return {**found, "is_seen": is_seen, "obeyed": await obeyed(stranger, device) if is_seen else 0}


if __name__ == "__main__":
    make_network()
    sys.stdout.write(json.dumps(asyncio.run(run(sys.argv[1], Path(sys.argv[2])))) + "\n")
