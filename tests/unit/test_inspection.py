"""`hostlink inspect` against what the original host decoded, however the bytes are cut."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from hostlink.cli.inspect import json_value, report_view
from hostlink.errors import BadRequest
from hostlink.inspection import Inspection, Read, load_reads
from hostlink.messages.catalog import Catalog
from hostlink.protocol.frame import encode

CAPTURES = Path(__file__).parent.parent / "captures"
NAMES = ["robot", "robot_serial", "services", "reconnect"]


def as_recorded(reads: list[Read]) -> Iterator[Read]:
    yield from reads


def byte_by_byte(reads: list[Read]) -> Iterator[Read]:
    for read in reads:
        for byte in bytes.fromhex(read.hex):
            yield Read(read.dir, f"{byte:02x}", read.t, read.conn)


def all_at_once(reads: list[Read]) -> Iterator[Read]:
    """All that each side sent on a connection, in one read."""
    for connection in dict.fromkeys(read.conn for read in reads):
        for side in ("device", "host"):
            sent = "".join(read.hex for read in reads if read.conn == connection and read.dir == side)
            yield Read(side, sent, 0.0, connection)


@pytest.mark.parametrize("cut", [as_recorded, byte_by_byte, all_at_once])
@pytest.mark.parametrize("name", NAMES)
def test_agrees_with_the_original_host(name: str, cut: Any) -> None:
    expected = json.loads((CAPTURES / f"{name}.expected.json").read_text())
    inspection = Inspection(Catalog())
    inspection.add_all(cut(list(load_reads(CAPTURES / f"{name}.jsonl"))))
    report = report_view(inspection.report())
    sessions = expected["sessions"]

    assert report["connections"] == expected["connections"]
    assert report["topics"] == [topic | {"kind": kind(topic)} for topic in expected["negotiated_topics"]]
    assert report["time_requests"] == sum(session["time_requests"] for session in sessions)
    assert report["messages"] == sums(session["device_messages"] for session in sessions)
    sent = sums(session["host_messages"] for session in sessions)
    assert report["to_device"] == {topic: series for topic, series in sent.items() if "(" not in topic}
    assert report["parameters"] == [each for session in sessions for each in session.get("parameter_requests", [])]
    told = [
        {"level": log["level"], "msg": log["msg"]} for session in sessions for log in session.get("device_logs", [])
    ]
    assert [log for log in told if log not in report["logs"]] == []
    assert len(report["logs"]) == len(told) + {"reconnect": 1}.get(name, 0)  # on the connection that nobody answered
    assert report["services"] == services(sent, sessions)
    assert report["skipped_bytes"] == {"reconnect": 23}.get(name, 0)  # cut after 20 and after 3 bytes of a frame


def kind(topic: dict[str, Any]) -> str:
    name: str = topic["kind"]
    return name.rpartition("_")[0] if name.startswith("service") else name


def sums(series: Iterator[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    total: dict[str, dict[str, Any]] = {}
    for topics in series:
        for topic, seen in topics.items():
            last = seen.get("all", seen.get("last"))[-1]
            first = seen.get("all", seen.get("first"))[0]
            before = total.setdefault(topic, {"count": 0, "first": first, "last": last})
            before["count"] += seen["count"]
            before["last"] = last
    return total


def services(sent: dict[str, Any], sessions: list[dict[str, Any]]) -> dict[str, dict[str, int]]:
    answered = sums(session.get("service_server_responses", {}) for session in sessions)
    asked = sums(session.get("service_client_requests", {}) for session in sessions)
    own = {
        name: {"requests": sent[f"{name} (request to device)"]["count"], "responses": series["count"]}
        for name, series in answered.items()
    }
    called = {
        name: {"requests": series["count"], "responses": sent[f"{name} (response to device)"]["count"]}
        for name, series in asked.items()
    }
    return own | called


def test_an_unknown_type_is_shown_as_bytes() -> None:
    strings = b"".join(len(text).to_bytes(4, "little") + text for text in (b"/x", b"my_msgs/New", b"0" * 32))
    info = (125).to_bytes(2, "little") + strings + (512).to_bytes(4, "little")
    inspection = Inspection(Catalog())
    inspection.add_all([Read("device", (encode(0, info) + encode(125, b"\x01\x02")).hex())])
    assert report_view(inspection.report())["messages"] == {
        "/x": {"count": 1, "first": {"hex": "0102"}, "last": {"hex": "0102"}}
    }


@pytest.mark.parametrize(
    ("line", "problem"),
    [
        ("{", "Input data was truncated"),
        ('{"dir": "robot"}', "Invalid enum value 'robot' - at `$.dir`"),
        ('{"dir": "host", "hex": "zz"}', "non-hexadecimal number found in fromhex() arg at position 0"),
    ],
)
def test_a_line_that_is_none_is_named(tmp_path: Path, line: str, problem: str) -> None:
    path = tmp_path / "broken.jsonl"
    path.write_text('{"dir": "host"}\n\n' + line + "\n")
    with pytest.raises(BadRequest) as caught:
        list(load_reads(path))
    assert str(caught.value) == f"{path}:3: no line of a recording: {problem}"


def test_a_recording_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(BadRequest, match="No such file"):
        list(load_reads(tmp_path / "none.jsonl"))


def test_numbers_that_json_lacks_are_strings() -> None:
    values = {"list": [float("nan"), 1.0], "up": float("inf"), "down": float("-inf"), "text": "nan"}
    assert json_value(values) == {"list": ["NaN", 1.0], "up": "Infinity", "down": "-Infinity", "text": "nan"}
