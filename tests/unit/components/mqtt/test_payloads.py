"""Payloads: any bytes give a drive or a BadPayload, any lock has a reason, noise does not change a state."""

import contextlib
import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.components.mqtt.payloads import (
    MAX_PAYLOAD_BYTES,
    MAX_REASON,
    encode_answer,
    encode_state,
    parse_drive,
    parse_reason,
)
from hostlink.core.host import PlanarVelocity
from hostlink.errors import BadPayload
from tests.unit.components.mqtt.robots import robot

numbers = st.floats(-1e6, 1e6)


@given(numbers, numbers, numbers, numbers, st.none() | st.integers(0, 2**62))
def test_drive_is_parsed(linear: float, angular: float, linear_y: float, sent_s: float, epoch: int | None) -> None:
    fields = {"linear": linear, "angular": angular, "linear_y": linear_y, "sent_s": sent_s, "epoch": epoch}
    drive = parse_drive(json.dumps(fields).encode())
    assert drive.velocity == PlanarVelocity(linear, linear_y, angular)
    assert (drive.sent_s, drive.epoch) == (sent_s, epoch)


@given(st.binary(max_size=2000) | st.text(alphabet='{}[]":,linearsent_0123456789.e+-', max_size=200).map(str.encode))
def test_any_bytes_are_a_drive_or_a_bad_payload(payload: bytes) -> None:
    with contextlib.suppress(BadPayload):
        assert math.isfinite(parse_drive(payload).sent_s)


@pytest.mark.parametrize(
    ("payload", "problem"),
    [
        (b'{"linear": 0.2}', "missing required field `sent_s`; an MQTT broker may keep a command"),
        (b'{"sent_s": 1, "speed": 1}', "unknown field `speed`"),
        (b'{"sent_s": 1, "linear": "fast"}', "Expected `float`, got `str`"),
        (b'{"sent_s": 1, "linear": 1e999}', "out of range"),
        (b'{"sent_s": 1, "linear": NaN}', "invalid"),
        (b'{"sent_s": 1, "epoch": 1.5}', "Expected `int | null`"),
        (b"", "truncated"),
        (b"[" * 1000, "array"),
        (b" " * (MAX_PAYLOAD_BYTES + 1), "1025 bytes, at most 1024 are taken"),
    ],
)
def test_bad_drive_names_its_problem(payload: bytes, problem: str) -> None:
    with pytest.raises(BadPayload) as raised:
        parse_drive(payload)
    assert problem in str(raised.value)


@given(st.binary(max_size=3000))
def test_every_payload_gives_a_reason(payload: bytes) -> None:
    reason = parse_reason(payload)
    assert 1 <= len(reason) <= MAX_REASON
    assert reason.isprintable()


def test_reason_is_the_payload() -> None:
    assert parse_reason(b"Besuch im Flur\n") == "Besuch im Flur"
    assert parse_reason(b"") == "locked by MQTT"


def test_state_has_everything() -> None:
    assert json.loads(encode_state(robot("robot_0", lock_reason="a visitor", holder="teleop", epoch=7))) == {
        "name": "robot_0",
        "connected": True,
        "host": None,
        "holder": "teleop",
        "locked": True,
        "lock_reason": "a visitor",
        "velocity": {"linear_m_s": 0.2, "linear_y_m_s": 0.0, "angular_rad_s": -0.5},
        "measured": None,
        "pose": None,
        "battery_v": 11.9,
        "battery_percent": 71.0,
        "signal_dbm": -67,
        "firmware": "rover 1.4.2",
        "errors": ["battery_low"],
        "epoch": 7,
        "lease_s": 0.5,
        "is_played": False,
    }


def test_state_of_a_robot_without_reports_has_nulls() -> None:
    state = json.loads(encode_state(robot("a", link=None, battery_v=math.nan, battery_percent=None)))
    assert (state["connected"], state["battery_v"], state["battery_percent"]) == (False, None, None)


@given(st.floats(-1e-4, 1e-4))
def test_noise_is_not_a_change(noise: float) -> None:
    still = encode_state(robot("a", velocity=PlanarVelocity()))
    assert encode_state(robot("a", velocity=PlanarVelocity(noise, noise, noise))) == still


def test_answer_leaves_out_what_is_not_known() -> None:
    assert json.loads(encode_answer("stop", ok=True, unreached=None, robots={})) == {
        "command": "stop",
        "ok": True,
        "robots": {},
    }
