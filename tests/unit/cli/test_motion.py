"""Amounts that `hostlink move` and `turn` take, and what they write at the end of a motion."""

import math
import re

import pytest

from hostlink.cli.motion import MOVE, Way, broken_off, degrees_text, metres_text, named
from hostlink.cli.quantities import metres, radians
from hostlink.client import Motion, MotionOutcome
from hostlink.errors import ConfigError


@pytest.mark.parametrize(
    ("text", "wanted_m"),
    [("1", 1.0), ("0.3m", 0.3), ("25cm", 0.25), ("-25 cm", -0.25), ("120mm", 0.12), ("+1,5 m", 1.5)],
)
def test_a_bare_distance_is_in_metres(text: str, wanted_m: float) -> None:
    assert metres(text) == pytest.approx(wanted_m)


@pytest.mark.parametrize(
    ("text", "wanted_deg"),
    [("90deg", 90), ("-90°", -90), ("1.5 degrees", 1.5), ("1turn", 360), ("-.5 turns", -180), ("3.1415927rad", 180)],
)
def test_an_angle_has_its_unit(text: str, wanted_deg: float) -> None:
    assert math.degrees(radians(text)) == pytest.approx(wanted_deg)


@pytest.mark.parametrize("text", ["", "x", "1x", "nan", "inf", "1e400m", "--sped", "1 2m", "0x1m"])
def test_another_text_is_refused_as_a_distance(text: str) -> None:
    with pytest.raises(ConfigError, match=re.escape("is not a length; write it as 1 (metres), 0.3m, 25cm or -25cm")):
        metres(text)


@pytest.mark.parametrize(
    ("text", "wanted"),
    [("90", "'90' has no unit; write it as 90deg or 90rad"), ("x", "'x' is not an angle; write it as 90deg")]
    + [(text, "is not an angle") for text in ("", "90grad", "nanrad", "9" * 400 + "e9deg", "1.2.3deg", "deg")],
)
def test_another_text_is_refused_as_an_angle(text: str, wanted: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(wanted)):
        radians(text)


def test_the_name_may_be_left_out() -> None:
    assert named("0.5m", None, metres, MOVE) == (None, 0.5)
    assert named("mule", "0.5m", metres, MOVE) == ("mule", 0.5)
    with pytest.raises(
        ConfigError, match="DISTANCE: is missing; write it behind the name, as in `hostlink move mule 1`"
    ):
        named("mule", None, metres, MOVE)
    with pytest.raises(ConfigError, match="'1x' is not a length"):
        named("1x", None, metres, MOVE)


@pytest.mark.parametrize(
    ("motion", "wanted"),
    [
        (Motion(MotionOutcome.BLOCKED, 2.0, 0.1, 0.0, reason="it stands"), "mule: blocked before +1.000 m: it stands"),
        (
            Motion(MotionOutcome.STOPPED, 2.0, 0.1, 0.0, kind="locked", by="client 3", reason="mule: locked: a foot"),
            "mule: stopped before +1.000 m: mule: locked: a foot, by client 3; to drive it again: hostlink unlock mule",
        ),
        (
            Motion(MotionOutcome.STOPPED, 2.0, 0.1, 0.0, kind="held", by="client 3", reason="client 3 drives"),
            "mule: stopped before +1.000 m: client 3 drives; `hostlink robots` shows who drives",
        ),
        (
            Motion(MotionOutcome.STOPPED, 2.0, 0.1, 0.0, kind="connection", reason="it is lost"),
            "mule: stopped before +1.000 m: it is lost; the robot stops by itself; `hostlink robots` shows its speed "
            "when the daemon runs again",
        ),
        (Motion(MotionOutcome.STOPPED, 2.0), "mule: stopped before +1.000 m: the robot was stopped"),
    ],
)
def test_a_motion_that_was_broken_off_names_the_reason_and_the_next_step(motion: Motion, wanted: str) -> None:
    assert broken_off("mule", Way("moved", 1.0, metres_text), motion) == wanted


def test_a_turn_is_written_in_degrees() -> None:
    way = Way("turned", math.pi, degrees_text)
    assert way.text(way.gone(Motion(MotionOutcome.REACHED, 1.0, 0.1, -math.pi / 2))) == "-90.0°"
