"""`hostlink inspect` compared with the original host's decoding, for any cut of the bytes."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from hostlink.cli.inspect import Inspection
from hostlink.core.messages.catalog import Catalog
from hostlink.core.runtime.capture_file import Read, load_reads

CAPTURES = Path(__file__).parent.parent / "captures"
NAMES = ["robot", "robot_serial", "services", "reconnect"]


def as_recorded(reads: list[Read]) -> Iterator[Read]:
    yield from reads


def byte_by_byte(reads: list[Read]) -> Iterator[Read]:
    for read in reads:
        for byte in bytes.fromhex(read.hex):
            yield Read(read.dir, f"{byte:02x}", read.t, read.conn)


def all_at_once(reads: list[Read]) -> Iterator[Read]:
    """Join everything that each side sent on a connection into one read."""
    for connection in dict.fromkeys(read.conn for read in reads):
        for side in ("device", "host"):
            sent = "".join(read.hex for read in reads if read.conn == connection and read.dir == side)
            yield Read(side, sent, 0.0, connection)


@pytest.mark.slow
@pytest.mark.parametrize("cut", [as_recorded, byte_by_byte, all_at_once])
@pytest.mark.parametrize("name", NAMES)
def test_inspection_agrees_with_the_original_host(name: str, cut: Any) -> None:
    expected = json.loads((CAPTURES / f"{name}.expected.json").read_text())
    inspection = Inspection(Catalog())
    inspection.add_all(cut(list(load_reads(CAPTURES / f"{name}.jsonl"))))
    report = inspection.view()
    sessions = expected["sessions"]

    assert report["connections"] == expected["connections"]
    assert report["topics"] == [topic | {"kind": kind(topic)} for topic in expected["negotiated_topics"]]
    assert report["time_requests"] == sum(session["time_requests"] for session in sessions)
    assert report["messages"] == sums(session["device_messages"] for session in sessions)
    sent = sums(session["host_messages"] for session in sessions)
    assert report["to_device"] == {topic: series for topic, series in sent.items() if "(" not in topic}
    assert report["parameters"] == [each for session in sessions for each in session.get("parameter_requests", [])]
    reported = [
        {"level": log["level"], "msg": log["msg"]} for session in sessions for log in session.get("device_logs", [])
    ]
    assert [log for log in reported if log not in report["logs"]] == []
    assert len(report["logs"]) == len(reported) + {"reconnect": 1}.get(name, 0)  # on the connection without answers
    assert report["services"] == services(sent, sessions)
    assert report["skipped_bytes"] == {"reconnect": 23}.get(name, 0)  # cut after 20 and after 3 bytes of a frame


def kind(topic: dict[str, Any]) -> str:
    name: str = topic["kind"]
    return name.rpartition("_")[0] if name.startswith("service") else name


def sums(series: Iterator[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    total: dict[str, dict[str, Any]] = {}
    for topics in series:
        for topic, observed in topics.items():
            last = observed.get("all", observed.get("last"))[-1]
            first = observed.get("all", observed.get("first"))[0]
            before = total.setdefault(topic, {"count": 0, "first": first, "last": last})
            before["count"] += observed["count"]
            before["last"] = last
    return total


def services(sent: dict[str, Any], sessions: list[dict[str, Any]]) -> dict[str, dict[str, int]]:
    answered = sums(session.get("service_server_responses", {}) for session in sessions)
    requested = sums(session.get("service_client_requests", {}) for session in sessions)
    own = {
        name: {"requests": sent[f"{name} (request to device)"]["count"], "responses": series["count"]}
        for name, series in answered.items()
    }
    called = {
        name: {"requests": series["count"], "responses": sent[f"{name} (response to device)"]["count"]}
        for name, series in requested.items()
    }
    return own | called
