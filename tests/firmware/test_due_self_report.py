"""The firmware's report about itself in numbers: its battery's voltage, and its errors."""

import ctypes
import math
import re
import struct
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.core.messages.catalog import Catalog
from hostlink.core.protocol.endpoint import EndpointKind
from hostlink.core.protocol.events import Parameter
from hostlink.core.protocol.rosserial.control import decode_topic_info
from hostlink.core.protocol.rosserial.frame import STOP_REQUEST, TOPICS_REQUEST, encode
from tests.firmware.due import ROOT, Robot, library, robot
from tests.firmware.test_due_robot import Track, logged, velocity
from tests.firmware.worlds import world

CATALOG = Catalog()
BATTERY, ERRORS = 127, 128
LOW_AFTER_S = 7.0  # smoothed over a second, low after five


def decoded(track: Track, topic_id: int, type_name: str) -> list[dict[str, Any]]:
    """Messages of a topic since the frames were cleared."""
    type_ = CATALOG.message(type_name)
    assert type_ is not None
    return [type_.decode(frame.payload) for frame in track.frames if frame.topic_id == topic_id]


def volts(track: Track) -> list[float]:
    return [message["voltage"] for message in decoded(track, BATTERY, "sensor_msgs/BatteryState")]


def errors(track: Track) -> list[list[int]]:
    return [list(message["data"]) for message in decoded(track, ERRORS, "std_msgs/UInt16MultiArray")]


def test_topics_of_the_report_have_the_types_of_ros() -> None:
    with robot() as firmware:
        infos = [
            decode_topic_info(EndpointKind.PUBLISHER, frame.payload)
            for frame in Track(firmware).frames
            if frame.topic_id == 0
        ]
        for info in infos:
            assert info is not None
            type_ = CATALOG.message(info.type)
            assert type_ is not None
            assert info.md5 == type_.md5
        assert {(info.id, info.name) for info in infos if info} >= {
            (BATTERY, "/robot_0/battery"),
            (ERRORS, "/robot_0/errors"),
        }


def test_the_battery_is_published_once_a_second_where_it_is_measured() -> None:
    with robot() as firmware:
        track = Track(firmware)
        track.run(3.0)
        assert volts(track) == []
        firmware.set_battery(11.8)
        track.frames.clear()
        track.run(5.0)
        assert volts(track) == pytest.approx([11.8] * 5, abs=0.01)
        message = decoded(track, BATTERY, "sensor_msgs/BatteryState")[0]
        assert message["present"]
        unmeasured = ("temperature", "current", "charge", "capacity", "design_capacity", "percentage")
        assert all(math.isnan(message[name]) for name in unmeasured)


def test_a_low_battery_is_logged_once_and_stays_an_error_until_it_has_recovered() -> None:
    with robot() as firmware:
        track = Track(firmware)
        firmware.set_battery(10.2)
        track.run(LOW_AFTER_S)
        firmware.set_battery(10.6)  # less than 0.3 V above
        track.run(20.0)
        assert [text for text in logged(track.frames) if "battery" in text] == ["battery low: 10.2 V, below 10.5 V"]
        assert errors(track)[-1] == [51]
        firmware.set_battery(11.5)
        track.run(15.0)
        assert errors(track)[-1] == []


def test_a_motor_that_starts_makes_no_battery_low() -> None:
    with robot() as firmware:
        track = Track(firmware)
        for _ in range(5):
            firmware.set_battery(9.5)
            track.run(2.0)
            firmware.set_battery(11.5)
            track.run(4.0)
        assert all(numbers == [] for numbers in errors(track))


def test_the_limit_is_a_parameter() -> None:
    with robot() as firmware:
        track = Track(firmware)
        track.parameters = {"/robot_0/battery_low": Parameter(floats=(6.6,))}
        firmware.feed(STOP_REQUEST)
        track.run(0.1)
        firmware.feed(TOPICS_REQUEST)
        firmware.set_battery(7.2)
        track.run(10.0)
        assert errors(track)[-1] == []
        firmware.set_battery(6.4)
        track.run(LOW_AFTER_S)
        assert errors(track)[-1] == [51]


@given(st.integers(0, 4095), st.floats(1.0, 20.0, width=32))
def test_the_divider_gives_volts(counts: int, divider: float) -> None:
    assert library().battery_input_v(counts, divider) == pytest.approx(counts / 4095 * 3.3 * divider, rel=1e-5)
    assert math.isnan(library().battery_input_v(counts, 0.0))


def test_errors_are_published_once_a_second_and_when_they_change() -> None:
    with robot() as firmware:
        track = Track(firmware)
        track.run(2.0)
        track.frames.clear()
        track.run(5.0)
        assert errors(track) == [[]] * 5
        track.run(1.0, velocity(0.2, 0.0))
        track.frames.clear()
        track.run(0.75)  # no driver: the watchdog of the commands stops it after 0.5 s
        assert [31] in errors(track)
        track.frames.clear()
        track.run(12.0)
        assert errors(track)[0] == [31]
        assert errors(track)[-1] == []


def in_use(firmware: Robot, *, left: bool, right: bool) -> list[int]:
    """Numbers of the errors while a wheel is blocked and the robot is driven."""
    track = Track(firmware)
    for motor, is_held in zip(track.motors, (left, right), strict=True):
        if is_held:
            motor.grip(0.0)
    track.run(4.0, velocity(0.3, 0.0))
    return errors(track)[-1]


@pytest.mark.parametrize(
    ("left", "right", "numbers"), [(True, False, [11]), (False, True, [12]), (True, True, [11, 12])]
)
def test_a_held_wheel_has_a_number(left: bool, right: bool, numbers: list[int]) -> None:
    with robot() as firmware:
        assert in_use(firmware, left=left, right=right) == numbers


def test_a_runaway_has_a_number() -> None:
    with robot() as firmware:
        track = Track(firmware)
        track.motors[1].break_driver()
        track.run(6.0, velocity(0.1, 0.0))
        assert 22 in errors(track)[-1]


def test_refused_and_lost_messages_have_an_error_number() -> None:
    with robot() as firmware:
        track = Track(firmware)
        firmware.feed(velocity(math.nan, 0.0))
        firmware.feed(encode(103, struct.pack("<3d", -1.0, 0.0, 0.0)))
        firmware.feed(b"\xff\xfe\x00\x00\x00")  # a wrong checksum of the length
        track.run(1.0)
        assert errors(track)[-1] == [33, 34, 41]


@given(st.lists(st.tuples(st.sampled_from([11, 12, 21, 22, 31, 32, 33, 34, 41, 42, 43, 51]), st.integers(0, 8000))))
def test_the_list_has_each_error_of_the_last_ten_seconds_once(story: list[tuple[int, int]]) -> None:
    """Compared with a dictionary, over the wrap of the clock."""
    handle = library().errors_new()
    now_ms, raised = 2**32 - 20_000, {}
    try:
        for number, wait_ms in story:
            now_ms += wait_ms
            raised[number] = now_ms
            library().errors_raise(handle, number, now_ms % 2**32)
            out = (ctypes.c_uint8 * 12)()
            count = library().errors_list(handle, out, now_ms % 2**32)
            assert list(out)[:count] == sorted(number for number, at_ms in raised.items() if now_ms - at_ms < 10_000)
    finally:
        library().errors_delete(handle)


@pytest.mark.parametrize(("reset_type", "lines"), [(0, 0), (2, 1), (5, 0)])
def test_board_restarted_by_its_watchdog_reports_it_once(reset_type: int, lines: int) -> None:
    with world(reset_type=reset_type) as made:
        made.drive(0.0, 0.0, 1.0)
        made.feed(STOP_REQUEST)
        made.run(0.2)
        made.feed(TOPICS_REQUEST)
        made.run(1.0)
        found = [text for text in made.errors if "watchdog" in text]
        assert found == ["started by its watchdog: the loop had not turned for 500 ms"] * lines


def test_documents_and_page_have_the_numbers_of_the_firmware() -> None:
    header = (ROOT / "firmware" / "due" / "src" / "self_report.h").read_text()
    known = {int(number) for number in re.findall(r"^  k\w+ = (\d+),", header, re.MULTILINE)}
    table = (ROOT / "docs" / "robot.md").read_text().split("| number |")[1].split("\n\n")[0]
    documented = {
        int(number) for row in re.findall(r"^\| ([\d, ]+) \|", table, re.MULTILINE) for number in row.split(",")
    }
    page = (ROOT / "hostlink" / "components" / "gateway" / "web" / "src" / "health.ts").read_text()
    assert len(known) == 12
    assert documented == known
    assert {int(number) for number in re.findall(r'^  (\d+): "', page, re.MULTILINE)} == known
