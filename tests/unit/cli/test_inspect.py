"""Damaged recordings, and numbers that JSON lacks.

tests/property/test_inspection.py compares with the original host.
"""

from pathlib import Path

import pytest

from hostlink.cli.inspect import Inspection, inspection_lines, json_value
from hostlink.core.messages.catalog import Catalog
from hostlink.core.protocol.endpoint import EndpointKind
from hostlink.core.protocol.rosserial.control import encode_topic_info
from hostlink.core.protocol.rosserial.frame import encode
from hostlink.core.runtime.capture_file import Read, load_reads
from hostlink.errors import BadRequest
from tests.support.fake_device import topic


def test_unknown_type_is_shown_as_bytes() -> None:
    strings = b"".join(len(text).to_bytes(4, "little") + text for text in (b"/x", b"my_msgs/New", b"0" * 32))
    info = (125).to_bytes(2, "little") + strings + (512).to_bytes(4, "little")
    inspection = Inspection(Catalog())
    inspection.add_all([Read("device", (encode(0, info) + encode(125, b"\x01\x02")).hex())])
    assert inspection.view()["messages"] == {"/x": {"count": 1, "first": {"hex": "0102"}, "last": {"hex": "0102"}}}


def test_service_is_shown_once_with_the_ids_of_requests_and_responses() -> None:
    halves = {
        EndpointKind.SERVICE_SERVER_PUBLISHER: topic(
            EndpointKind.SERVICE_SERVER_PUBLISHER, 126, "/led", "std_srvs/SetBool"
        ),
        EndpointKind.SERVICE_SERVER_SUBSCRIBER: topic(
            EndpointKind.SERVICE_SERVER_SUBSCRIBER, 101, "/led", "std_srvs/SetBool"
        ),
    }
    inspection = Inspection(Catalog())
    inspection.add_all([Read("device", encode(kind, encode_topic_info(half)).hex()) for kind, half in halves.items()])
    lines = inspection_lines(inspection.view())
    assert lines[0].startswith("connections 1   rosserial   time requests 0")
    assert [line.split() for line in lines if "/led" in line] == [
        ["126,", "101", "service_server", "/led", "std_srvs/SetBool"]
    ]


def test_one_id_in_both_directions_is_two_topics() -> None:
    pose = encode_topic_info(topic(EndpointKind.PUBLISHER, 125, "/pose", "geometry_msgs/Pose2D"))
    led = encode_topic_info(topic(EndpointKind.SUBSCRIBER, 125, "/led", "std_msgs/Bool"))
    inspection = Inspection(Catalog())
    inspection.add_all(
        [
            Read("device", (encode(0, pose) + encode(1, led) + encode(125, bytes(24))).hex()),
            Read("host", encode(125, b"\x01").hex()),
        ]
    )
    assert inspection.view()["messages"]["/pose"]["count"] == 1
    assert inspection.view()["to_device"]["/led"]["first"] == {"data": True}


@pytest.mark.parametrize(
    ("line", "problem"),
    [
        ("{", "Input data was truncated"),
        ('{"dir": "robot"}', "Invalid enum value 'robot' - at `$.dir`"),
        ('{"dir": "host", "hex": "zz"}', "non-hexadecimal number found in fromhex() arg at position 0"),
    ],
)
def test_invalid_line_is_named(tmp_path: Path, line: str, problem: str) -> None:
    path = tmp_path / "broken.jsonl"
    path.write_text('{"dir": "host"}\n\n' + line + "\n")
    with pytest.raises(BadRequest) as caught:
        list(load_reads(path))
    assert str(caught.value) == (
        f"{path}:3: not a line of a capture ({problem}); `hostlink capture` writes captures, "
        "and `hostlink info` shows recordings"
    )


def test_missing_recording_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadRequest, match="No such file"):
        list(load_reads(tmp_path / "none.jsonl"))


def test_numbers_that_json_lacks_are_strings() -> None:
    values = {"list": [float("nan"), 1.0], "up": float("inf"), "down": float("-inf"), "text": "nan"}
    assert json_value(values) == {"list": ["NaN", 1.0], "up": "Infinity", "down": "-Infinity", "text": "nan"}
