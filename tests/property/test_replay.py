"""A session over recorded bytes, cut anywhere, reports what the original host reported."""

import json
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from hostlink.core.messages.catalog import Catalog
from hostlink.core.protocol import events
from hostlink.core.protocol.endpoint import DeviceEndpoint
from hostlink.core.protocol.rosserial.protocol import check_type
from hostlink.core.protocol.rosserial.session import Session
from hostlink.core.runtime.capture_file import Read, load_reads

CAPTURES = Path(__file__).parents[1] / "captures"
CATALOG = Catalog()
Timed = Iterator[tuple[float, bytes]]


@cache
def recorded(name: str) -> tuple[Read, ...]:
    return tuple(read for read in load_reads(CAPTURES / f"{name}.jsonl") if read.dir == "device" and read.hex)


def as_recorded(reads: list[Read]) -> Timed:
    return ((read.t, bytes.fromhex(read.hex)) for read in reads)


def at_once(reads: list[Read]) -> Timed:
    yield reads[0].t, b"".join(bytes.fromhex(read.hex) for read in reads)


def byte_by_byte(reads: list[Read]) -> Timed:
    return ((time_s, data[at : at + 1]) for time_s, data in as_recorded(reads) for at in range(len(data)))


@cache
def fixed_bytes(info: DeviceEndpoint) -> int | None:
    return check_type(CATALOG, info)


def heard(reads: Timed) -> Counter[object]:
    """Count the topics, services, parameter names and events of one connection."""
    session, found = Session(check=fixed_bytes), Counter[object]()
    session.open(now_s=0.0)
    for now_s, data in reads:
        for event in session.receive(data, now_s=now_s):
            match event:
                case events.MessageReceived(info) | events.ServiceResponded(info) | events.ServiceRequested(info):
                    found[info.name] += 1
                case events.TimeRequested() | events.DeviceLogged():
                    found[type(event)] += 1
                case events.ParameterRequested(name):
                    found["parameter", name] += 1
    return found


def reported(session: dict[str, Any]) -> Counter[object]:
    """Count the same in the report of the original host."""
    found = Counter[object]({events.TimeRequested: session["time_requests"]})
    found[events.DeviceLogged] = len(session.get("device_logs", []))
    found.update(("parameter", each["name"]) for each in session.get("parameter_requests", []))
    for heard_of in ("device_messages", "service_server_responses", "service_client_requests"):
        found.update({name: series["count"] for name, series in session.get(heard_of, {}).items()})
    return +found


@pytest.mark.slow
@pytest.mark.parametrize("cut", [as_recorded, at_once, byte_by_byte])
@pytest.mark.parametrize("name", ["robot", "robot_serial", "services", "reconnect"])
def test_session_reports_what_the_original_host_reported(name: str, cut: Any) -> None:
    expected = json.loads((CAPTURES / f"{name}.expected.json").read_text())
    for session in expected["sessions"]:
        reads = [read for read in recorded(name) if read.conn == session["conn"]]
        assert heard(cut(reads)) == reported(session)
