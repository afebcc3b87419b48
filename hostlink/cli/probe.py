"""Diagnosis by `hostlink doctor` without a daemon: of a TCP port, a serial port or a capture."""

import asyncio
import contextlib
import dataclasses
import errno
import re
import socket
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec

from hostlink.cli.connecting import counted
from hostlink.cli.doctor import Report, rates, report_of
from hostlink.cli.serve import running
from hostlink.cli.usual import USUAL
from hostlink.core.config import Config, SerialConfig, TcpConfig
from hostlink.core.diagnosis.finding import Finding, finding
from hostlink.core.diagnosis.replay import Replay, replay
from hostlink.core.hub.devices import Devices, finding_views
from hostlink.core.hub.hub import Hub
from hostlink.core.messages.catalog import Catalog
from hostlink.core.protocol.registry import find_protocol
from hostlink.core.robot.state_views import robot_view
from hostlink.core.runtime.capture_file import load_reads
from hostlink.core.runtime.listening import own_address
from hostlink.core.runtime.loop_time import loop_time_s
from hostlink.core.transport.port_users import PROC, find_user

# -- port users -------------------------------------------------------------------------------------------------------

_LISTENS = "0A"
_SOCKET = re.compile(r"socket:\[(\d+)\]")

COMMON_BAUDS = (57600, 115200, 38400, 9600, 250000, 500000, 1000000, 230400, 19200)  # rosserial's default first
BAUD_TRY_S = 4.5  # a device answers in 2 s, and a board that is reset when the port opens boots in 2 s
SETTLE_S = 9.0  # after the topics, for three time requests


def user_of_port(port: int) -> str:
    """Return the process that listens on a TCP port: "rosserial_python (pid 1234)"; empty if unknown."""
    wanted = set(_listening_sockets(port))
    return find_user(lambda target: bool((found := _SOCKET.fullmatch(target)) and found[1] in wanted))


def _listening_sockets(port: int) -> Iterator[str]:
    for table in ("tcp", "tcp6"):
        with contextlib.suppress(OSError):
            for line in (PROC / "net" / table).read_text().splitlines()[1:]:
                fields = line.split()
                if int(fields[1].rpartition(":")[2], 16) == port and fields[3] == _LISTENS:
                    yield fields[9]


# -- probe ------------------------------------------------------------------------------------------------------------

Show = Callable[[str], None]

_POLL_S = 1.0
_ANY = ("0.0.0.0", "::")  # noqa: S104 - compared only
_LOOPBACK = TcpConfig(host="127.0.0.1", port=0)
_ALONE = dict.fromkeys(USUAL, False)  # no programs and no recordings


async def probe_network(host: str, port: int, seconds: float, folders: tuple[Path, ...], show: Show) -> Report:
    """Listen where devices connect, and report what came."""
    source = f"TCP {host}:{port}"
    if _is_in_use(host, port):
        user = user_of_port(port)
        return _report(source, finding("address_in_use", f"port {port}" + (f", by {user}" if user else "")))
    config = Config(tcp=TcpConfig(host=host, port=port), components=_ALONE, message_folders=folders)
    async with running(config) as (hub, _):
        for left_s in range(round(seconds), 0, -1):
            show(f"listening on {source}, {left_s} s left, {len(hub.links.all())} connected")
            await asyncio.sleep(_POLL_S)
        report = _report_of(hub, source)
    if not report["links"]:
        is_any = host in _ANY  # else devices reach this port at one address only
        here = f"this computer is {own_address() or 'in no network'}" if is_any else f"listening on {host}"
        report["findings"] += finding_views([finding("no_device", f"{here}, port {port}")])
    return report


async def probe_port(port: SerialConfig, folders: tuple[Path, ...], show: Show) -> Report:
    """Open a serial port, try the usual speeds, and report what came."""
    bauds = port.bauds + tuple(baud for baud in COMMON_BAUDS if baud not in port.bauds)
    trying = dataclasses.replace(port, baud=bauds, baud_try_s=BAUD_TRY_S)
    config = Config(tcp=_LOOPBACK, components=_ALONE, serial=(trying,), message_folders=folders)
    diagnosed: dict[str, Finding] = {}
    async with running(config) as (hub, _):
        found_for_s = 0.0
        for _ in range(round(len(bauds) * BAUD_TRY_S)):
            await asyncio.sleep(_POLL_S)
            if hub.diagnoses.ports or found_for_s >= SETTLE_S:
                break
            diagnosed |= {each.code: each for link in hub.links.all() for each in hub.diagnoses.of(link)}
            baud = _present_baud(hub)
            show(f"{port.name} at {baud or bauds[0]} baud")
            if any(link.topics for link in hub.links.all()):
                found_for_s += _POLL_S
        report = _report_of(hub, port.name)
        baud = _present_baud(hub)
    for link in report["links"]:
        if found_for_s:
            link["baud"] = baud
        else:  # no baud rate worked, so the findings of all of them count
            link["diagnosis"] = finding_views(list(diagnosed.values()))
    if found_for_s and baud not in port.bauds:
        wrong = finding("wrong_baud", f"the device answers at {baud} baud, not at {port.bauds[0]}")
        report["findings"] += finding_views([wrong])
    return report


def probe_capture(path: Path, folders: tuple[Path, ...]) -> Report:
    """Diagnose the connections of a capture."""
    catalog = Catalog(folders)
    connections = replay(counted(load_reads(path), "lines"), find_protocol, catalog)
    links = [_recorded(number, str(path), connection) for number, connection in connections.items()]
    return {"source": str(path), "links": links, "findings": []}


def _recorded(number: int, peer: str, connection: Replay) -> Report:
    seconds = connection.ended_at_s - connection.opened_at_s
    counts = dataclasses.asdict(connection.session.counts)
    return {
        "number": number,
        "peer": peer,
        "robot": None,
        "protocol": connection.session.protocol,
        "topics": len(connection.session.topics),
        "names": sorted({info.name for info in connection.session.topics}),
        "seconds": round(seconds, 3),
        "end": None,
        "diagnosis": finding_views(connection.findings()),
        **rates(counts, connection.ended_at_s - connection.begun_at_s),
        "frames_to_device_s": None,
        "silent_s": None,
    }


def _report(source: str, only: Finding) -> Report:
    return {"source": source, "links": [], "findings": finding_views([only])}


def _report_of(hub: Hub, source: str) -> Report:
    """Return the report from the view that the API of a daemon would send."""
    devices = Devices(hub)
    links = {"links": list(devices.links()), **devices.other_links()}
    view: dict[str, Any] = msgspec.json.decode(msgspec.json.encode(links))
    return report_of(view, source, [robot_view(robot.state(loop_time_s())) for robot in hub.robots.all()])


def _present_baud(hub: Hub) -> int | None:
    diagnoses = (hub.diagnoses.find(link.number) for link in hub.links.all())
    return next((diagnosis.baud for diagnosis in diagnoses if diagnosis is not None), None)


def _is_in_use(host: str, port: int) -> bool:
    with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
            probe.listen()
        except OSError as error:
            return error.errno == errno.EADDRINUSE
    return False
