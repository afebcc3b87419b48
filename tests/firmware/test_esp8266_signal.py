"""The strength of the WiFi, which the passthrough adds to the device's log: between frames, never to other bytes."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.core.protocol.rosserial.control import decode_log
from hostlink.core.protocol.rosserial.frame import Frame, Id, encode
from hostlink.core.protocol.rosserial.stream import FrameStream
from tests.firmware.esp8266 import Bridge

pytestmark = pytest.mark.usefixtures("esp8266_built")

SOONEST_MS, LATEST_MS = 10_000, 60_000
frames = st.builds(encode, st.integers(100, 140), st.binary(max_size=80))


def linked(bridge: Bridge, dbm: int) -> None:
    bridge.set_signal(dbm)
    for _ in range(3):
        bridge.turn(1)


def reports(data: bytes) -> list[tuple[int, str]]:
    """Level and text of the lines about the signal; every byte must belong to a frame."""
    logs = []
    for event in FrameStream().feed(data):
        assert isinstance(event, Frame), f"not a frame: {event!r}"
        if event.topic_id == Id.LOG:
            logs.append(decode_log(event.payload))
    return [(log.level, log.text) for log in logs if log is not None]


@pytest.mark.parametrize(
    ("dbm", "level", "text"),
    [
        (-7, 0, "WiFi signal -7 dBm"),
        (-67, 0, "WiFi signal -67 dBm"),
        (-80, 0, "WiFi signal -80 dBm"),
        (-81, 2, "WiFi signal -81 dBm"),
        (-100, 2, "WiFi signal -100 dBm"),
        (-127, 2, "WiFi signal -127 dBm"),
    ],
)
def test_the_signal_follows_the_first_frame_of_a_link_as_a_line_of_the_log(dbm: int, level: int, text: str) -> None:
    with Bridge() as bridge:
        linked(bridge, dbm)
        first = encode(125, b"pose")
        bridge.from_device(first)
        bridge.turn(1)
        sent = b"".join(bridge.to_host())
        assert sent.startswith(first)
        assert reports(sent) == [(level, text)]


@pytest.mark.parametrize("dbm", [0, 31, 127, -128])
def test_a_signal_that_is_not_known_is_not_reported(dbm: int) -> None:
    with Bridge() as bridge:
        linked(bridge, dbm)
        bridge.from_device(encode(125, b"pose"))
        bridge.turn(1)
        assert b"".join(bridge.to_host()) == encode(125, b"pose")


def test_a_weak_signal_is_one_warning_until_it_was_strong_again() -> None:
    with Bridge() as bridge:
        levels = []
        linked(bridge, -85)
        for dbm in (-85, -90, -60, -85):
            bridge.set_signal(dbm)
            bridge.from_device(encode(125, b"pose"))
            bridge.turn(SOONEST_MS)
            levels += [level for level, _ in reports(b"".join(bridge.to_host()))]
        assert levels == [2, 0, 0, 2]


def test_a_steady_signal_is_reported_once_a_minute_and_a_change_within_ten_seconds() -> None:
    with Bridge() as bridge:
        linked(bridge, -60)
        found = []
        for second in range(150):
            bridge.set_signal(-70 if second >= 100 else -60 - second % 3)
            bridge.from_device(encode(125, b"pose"))
            bridge.turn(1000)
            bridge.from_host(encode(Id.TIME, bytes(8)))
            found += [(second, text) for _, text in reports(b"".join(bridge.to_host()))]
        assert [text for _, text in found] == ["WiFi signal -60 dBm", "WiFi signal -60 dBm", "WiFi signal -70 dBm"]
        assert [second for second, _ in found] == [0, 60, 100]


@given(
    st.lists(st.tuples(frames | st.binary(max_size=30), st.integers(0, 4000), st.integers(1, 8)), max_size=25),
    st.integers(-100, -30),
)
def test_device_bytes_with_signal_reports_reach_the_host_whole_and_in_order(
    story: list[tuple[bytes, int, int]], dbm: int
) -> None:
    """In pieces of any size; without the reports the stream is the device's, byte by byte."""
    report = encode(Id.LOG, bytes([0]) + len(text := f"WiFi signal {dbm} dBm").to_bytes(4, "little") + text.encode())
    warning = encode(Id.LOG, bytes([2]) + len(text).to_bytes(4, "little") + text.encode())
    with Bridge() as silent, Bridge() as bridge:
        linked(silent, 31)
        linked(bridge, dbm)
        got, wanted, passed_ms = b"", b"", 0
        for data, wait_ms, pieces in story:
            size = max(1, len(data) // pieces)
            for at in range(0, len(data), size):
                for each in (silent, bridge):
                    each.from_device(data[at : at + size])
                    each.turn(1)
                passed_ms += 1
            for each in (silent, bridge):
                each.turn(wait_ms)
            passed_ms += wait_ms
        for each in (silent, bridge):
            each.turn(1000)
            each.turn(1000)
        got, wanted = b"".join(bridge.to_host()), b"".join(silent.to_host())
        count = got.count(report) + got.count(warning)
        assert got.replace(report, b"").replace(warning, b"") == wanted
        assert count <= 1 + (passed_ms + 3000) // LATEST_MS
