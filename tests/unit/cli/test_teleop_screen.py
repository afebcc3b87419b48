"""Screen of teleop: its lines in any width, and its warning of a robot that does not move."""

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.cli.driving import Driving
from hostlink.cli.teleop_screen import MAPS, RED, YELLOW, Line, OwnState, folded, lost_screen, screen
from hostlink.client import RobotState

ODOMETRY: Any = {
    "pose": {"x_m": 1.25, "y_m": -12.5, "theta_rad": 1.0},
    "twist": {"linear_m_s": 0.2, "angular_rad_s": -0.5},
    "age_s": 0.04,
    "rate_hz": 30.0,
}


def state(**changes: Any) -> RobotState:
    made: Any = {
        "name": "robot_0", "connected": True, "holder": "client 3", "locked": False, "lock_reason": None,
        "velocity": {"linear_m_s": 0.2, "angular_rad_s": 0.0}, "odometry": ODOMETRY,
    }  # fmt: skip
    return made | changes


def shown(
    width: int = 99,
    *,
    layout: str = "original",
    refusal: str = "",
    warning: str = "",
    asks: bool = False,
    **changes: Any,
) -> list[Line]:
    driving = Driving(layout=layout, linear_m_s=0.2, angular_rad_s=0.8)
    own = OwnState("client 7", refusal, warning, asks)
    return screen(state(**changes), driving, 0.0, own, layout=layout, width=width)


@given(st.integers(8, 200), st.sampled_from(sorted(MAPS)), st.text(max_size=80), st.text(max_size=80))
def test_no_line_is_wider_than_the_terminal(width: int, layout: str, refusal: str, warning: str) -> None:
    lines = shown(width, layout=layout, refusal=refusal, warning=warning)
    assert all(len(line.text) <= width for line in lines)
    driving = Driving(layout=layout, linear_m_s=0.2, angular_rad_s=0.8)
    assert all(len(line.text) <= width for line in lost_screen("robot_0", refusal, driving, width=width))


@pytest.mark.parametrize("layout", sorted(MAPS))
def test_forty_columns_keep_every_word_and_fit_24_lines(layout: str) -> None:
    wide, narrow = (
        [word for line in shown(width, layout=layout, refusal="too fast") for word in line.text.split()]
        for width in (120, 39)
    )
    assert sorted(wide) == sorted(narrow)
    assert len(shown(39, layout=layout, refusal="too fast")) <= 23


def test_a_locked_robot_names_its_reason_and_the_key_that_unlocks() -> None:
    lines = shown(locked=True, lock_reason="my foot", refusal="robot_0: locked: hostlink unlock robot_0")
    assert Line("LOCKED: my foot   r twice unlocks it", RED) in lines
    assert not any("hostlink unlock" in line.text for line in lines)
    asked = shown(locked=True, lock_reason="my foot", asks=True)
    assert Line("LOCKED: my foot   REALLY UNLOCK? r again does it", RED) in asked


@pytest.mark.parametrize(("layout", "keys"), [("original", "q or Ctrl-C ends"), ("twist", "Ctrl-C ends")])
def test_the_screen_names_the_keys_that_end_it(layout: str, keys: str) -> None:
    assert shown(layout=layout)[-1].text.endswith(f"; {keys}")
    driving = Driving(layout=layout, linear_m_s=0.2, angular_rad_s=0.8)
    assert lost_screen("robot_0", "gone", driving, width=99)[-1].text.endswith(f", {keys}")


def test_warnings_are_coloured() -> None:
    assert Line("driven by client 3   too fast", YELLOW) in shown(refusal="too fast")
    assert Line("stands", YELLOW) in shown(warning="stands")
    assert Line("hostlink teleop   robot_0   NOT CONNECTED", RED) in shown(connected=False)
    assert Line("odometry  none yet") in shown(odometry=None)


def test_driver_is_you_if_this_program_drives() -> None:
    assert Line("driven by you") in shown(holder="client 7", holder_address="10.0.0.5")
    assert Line("driven by client 3 (10.0.0.5)") in shown(holder_address="10.0.0.5")
    assert Line("driven by nobody") in shown(holder=None)


def test_a_line_breaks_between_facts_before_it_breaks_between_words() -> None:
    assert folded("one two   three four   five", 19) == ["one two", "three four   five"]
    assert folded("a very long fact of many words", 12) == ["a very long", "  fact of", "  many words"]
    assert folded("", 20) == [""]
