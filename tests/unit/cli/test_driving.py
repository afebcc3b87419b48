"""Keys and time to velocity (docs/driving.md#the-keys-of-teleop)."""

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.cli.driving import (
    CONFIRM_S,
    GRACE_S,
    HOLD_S,
    LAYOUTS,
    STANDING,
    ZEROS,
    Action,
    Confirmation,
    Driving,
    Key,
    KeyReader,
)
from hostlink.cli.teleop import STOP_KEYS, command
from hostlink.cli.teleop_screen import UNLOCK_KEY

V, W = 0.2, 0.8


def driving(layout: str = "original") -> Driving:
    return Driving(layout=layout, linear_m_s=V, angular_rad_s=W)


@pytest.mark.parametrize(
    ("key", "velocity"),
    [
        ("w", (V, 0)), ("e", (V, -W)), ("a", (0, W)), ("d", (0, -W)), ("z", (-V, -W)), ("x", (-V, 0)),
        ("c", (-V, W)), ("i", (V, 0)), (",", (-V, 0)), ("j", (0, W)), ("l", (0, -W)), ("o", (V, -W)), (".", (-V, W)),
        ("up", (V, 0)), ("down", (-V, 0)), ("left", (0, W)), ("right", (0, -W)),
    ],
)  # fmt: skip
def test_the_original_map_with_the_usual_keys_of_the_field(key: str, velocity: tuple[float, float]) -> None:
    made = driving()
    made.receive(Key(key), 0.0)
    assert made.velocity(0.1) == (*velocity, 0)


@pytest.mark.parametrize(("key", "velocity"), [("u", (V, W)), ("i", (V, 0)), ("m", (-V, -W)), (".", (-V, W))])
def test_the_map_of_teleop_twist_keyboard(key: str, velocity: tuple[float, float]) -> None:
    made = driving("twist")
    made.receive(Key(key), 0.0)
    assert made.velocity(0.1) == (*velocity, 0)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_speed_key_moves_nothing_and_applies_to_the_pressed_key(layout: str) -> None:
    made = driving(layout)
    speed = "t" if layout == "original" else "q"
    made.receive(Key(speed), 0.0)
    assert made.velocity(0.0) == (0.0, 0.0, 0)
    made.receive(Key("i"), 0.0)
    assert made.velocity(0.1) == pytest.approx((V * 1.1, 0, 0))


def test_speeds_stay_within_reason() -> None:
    made = driving()
    for _ in range(100):
        made.receive(Key("t"), 0.0)
    assert (made.linear_m_s, made.angular_rad_s) == (1.0, 4.0)
    for _ in range(100):
        made.receive(Key("b"), 0.0)
    assert (made.linear_m_s, made.angular_rad_s) == (0.01, 0.05)


def test_a_tap_lasts_until_a_repeat_could_have_come_and_a_pressed_key_as_long_as_it_repeats() -> None:
    made = driving()
    made.receive(Key("w"), 0.0)
    assert made.velocity(GRACE_S - 0.01) == (V, 0, 0)
    made.receive(Key("w"), GRACE_S - 0.01)
    now_s = GRACE_S
    while now_s < 3.0:
        made.receive(Key("w"), now_s)
        now_s += 0.033
    assert made.velocity(now_s) == (V, 0, 0)
    assert made.velocity(now_s + HOLD_S) == (0.0, 0.0, 0)


def test_a_release_stops_at_once_where_the_terminal_reports_it() -> None:
    made = driving()
    made.receive(Key("w"), 0.0)
    made.receive(Key("w", Action.RELEASED), 0.05)
    assert made.velocity(0.05) == (0.0, 0.0, 0)


@pytest.mark.parametrize("key", ["space", "k", "s", "5", "escape", "\ufffd", "sequence 5~"])
def test_every_key_without_a_meaning_stops(key: str) -> None:
    made = driving()
    made.receive(Key("w"), 0.0)
    made.receive(Key(key), 0.1)
    assert made.velocity(0.1) == (0.0, 0.0, 0)


def test_key_that_repeats_after_a_stop_moves_nothing_until_it_was_released() -> None:
    made = driving()
    made.receive(Key("w"), 0.0)
    made.receive(Key("space"), 0.1)
    for tick in range(4, 100):
        made.receive(Key("w"), tick * 0.033)
        assert made.velocity(tick * 0.033) == (0.0, 0.0, 0)
    made.receive(Key("w"), 100 * 0.033 + HOLD_S)
    assert made.velocity(100 * 0.033 + HOLD_S) == (V, 0.0, 0)


def test_keys_add_up() -> None:
    made = driving()
    made.receive(Key("up"), 0.0)
    made.receive(Key("left"), 0.1)
    assert made.velocity(0.1) == (V, W, 0)
    made.receive(Key("down"), 0.1)
    assert made.velocity(0.1) == (0.0, W, 0)


def test_driving_sends_at_ten_hertz_then_three_zeros_then_nothing() -> None:
    made = driving()
    made.receive(Key("w"), 0.0)
    sent = [(tick / 100, velocity) for tick in range(200) if (velocity := made.due(tick / 100)) is not None]
    moving = [at_s for at_s, velocity in sent if velocity == (V, 0, 0)]
    zeros = [at_s for at_s, velocity in sent if velocity == STANDING]
    assert len(moving) == 6
    assert len(zeros) == ZEROS
    assert zeros[0] == pytest.approx(GRACE_S)
    assert not made.is_ending


def test_driving_sends_nothing_until_a_key_is_pressed() -> None:
    made = driving()
    assert [made.due(tick / 10) for tick in range(20)] == [None] * 20


def test_a_barred_key_moves_nothing_while_it_repeats_and_drives_when_it_is_pressed_again() -> None:
    made = driving()
    made.receive(Key("w"), 0.0)
    made.bar(0.1)
    now_s = 0.5  # the first repeat is late
    while now_s < 3.0:
        made.receive(Key("w"), now_s)
        assert made.velocity(now_s) == (0.0, 0.0, 0)
        now_s += 0.033
    made.receive(Key("a"), now_s)  # another one is not barred
    assert made.velocity(now_s) == (0.0, W, 0)
    made.receive(Key("w"), now_s + HOLD_S + 0.1)
    assert made.velocity(now_s + HOLD_S + 0.1) == (V, W, 0)


def test_a_barred_key_drives_at_once_after_a_release_where_the_terminal_sends_it() -> None:
    made = driving()
    made.receive(Key("w"), 0.0)
    made.bar(0.1)
    made.receive(Key("w", Action.RELEASED), 0.15)
    assert made.velocity(0.15) == (0.0, 0.0, 0)
    made.receive(Key("w"), 0.2)
    assert made.velocity(0.2) == (V, 0, 0)


@pytest.mark.parametrize(
    ("key", "velocity"),
    [
        ("J", (0, 0, V)), ("L", (0, 0, -V)), ("I", (V, 0, 0)), ("U", (V, 0, V)), ("O", (V, 0, -V)),
        ("M", (-V, 0, V)), ("<", (-V, 0, 0)), (">", (-V, 0, -V)), ("\x1b[1;2D", (0, 0, V)), ("\x1b[1;2C", (0, 0, -V)),
        ("\x1b[106;2u", (0, 0, V)), ("\x1b[44;2u", (-V, 0, 0)), ("\x1b[46;2u", (-V, 0, -V)),
    ],
)  # fmt: skip
def test_shift_moves_sideways_as_in_teleop_twist_keyboard(key: str, velocity: tuple[float, ...]) -> None:
    made = driving("twist")
    made.has_y = True
    for pressed in KeyReader().feed(key.encode()):
        made.receive(pressed, 0.0)
    assert made.velocity(0.1) == velocity


def test_shift_means_nothing_to_a_robot_that_cannot_move_sideways() -> None:
    made = driving("twist")
    made.receive(Key("j", is_shifted=True), 0.0)
    assert made.velocity(0.1) == (0, W, 0)
    made.receive(Key("<", is_shifted=True), 0.2)  # a key without a meaning
    assert made.velocity(0.2) == STANDING


def test_shift_that_is_released_first_turns_and_the_key_stops() -> None:
    made = driving()
    made.has_y = True
    made.receive(Key("a", is_shifted=True), 0.0)
    assert made.velocity(0.1) == (0, 0, V)
    made.receive(Key("a", Action.REPEATED), 0.2)
    assert made.velocity(0.2) == (0, W, 0)
    made.receive(Key("a", Action.RELEASED), 0.3)
    assert made.velocity(0.3) == STANDING


def test_a_robot_that_cannot_turn_in_place_turns_while_it_drives() -> None:
    made = driving()
    made.turns_in_place = False
    made.receive(Key("left"), 0.0)
    assert made.velocity(0.1) == STANDING
    made.receive(Key("up"), 0.1)
    assert made.velocity(0.1) == (V, W, 0)


keys = st.builds(
    Key, st.sampled_from([*"qweadzxctbynumijlok,.<>", "up", "space", "?"]), st.sampled_from(Action), st.booleans()
)


@given(
    st.lists(st.tuples(keys, st.floats(0.0, 1.0)), max_size=40),
    st.sampled_from(sorted(LAYOUTS)),
    st.booleans(),
    st.booleans(),
)
def test_after_any_keys_the_robot_is_stopped_when_no_key_arrives(
    story: list[tuple[Key, float]], layout: str, has_y: bool, turns_in_place: bool
) -> None:
    made = driving(layout)
    made.has_y, made.turns_in_place = has_y, turns_in_place
    now_s = 0.0
    for key, pause_s in story:
        made.receive(key, now_s)
        linear, angular, left = made.velocity(now_s)
        assert max(abs(linear), abs(left)) <= 1.0
        assert abs(angular) <= 4.0
        now_s += pause_s
    now_s += GRACE_S
    assert made.velocity(now_s) == (0.0, 0.0, 0)
    sent = [made.due(now_s + tick / 50) for tick in range(50)]
    assert {velocity for velocity in sent if velocity is not None} <= {STANDING}
    assert sent[-1] is None


R = Key("r")


def test_a_key_is_confirmed_by_its_second_press_alone() -> None:
    asked = Confirmation("r")
    assert not asked.is_asking("lock", 0.0)
    assert not asked.receive(R, 0.0, "lock")
    assert asked.is_asking("lock", 0.0)
    assert asked.receive(R, GRACE_S, "lock")
    assert not asked.is_asking("lock", GRACE_S)
    assert not asked.receive(R, 3 * GRACE_S, "lock")  # asks anew


def test_a_held_key_confirms_nothing() -> None:
    asked = Confirmation("r")
    assert not asked.receive(R, 0.0, "lock")
    times_s = [0.5 + 0.03 * number for number in range(100)]
    assert not any(asked.receive(R, now_s, "lock") for now_s in times_s)
    assert not any(asked.receive(Key("r", Action.REPEATED), now_s + 3.0, "lock") for now_s in times_s)
    assert asked.receive(R, 3.5 + 0.03 * 99 + HOLD_S, "lock") is False  # too late: it asks again


def test_a_release_tells_a_second_press_from_a_repeat() -> None:
    asked = Confirmation("r")
    asked.receive(R, 0.0, "lock")
    asked.receive(Key("r", Action.RELEASED), 0.1, "lock")
    assert asked.receive(R, 0.2, "lock")


@pytest.mark.parametrize(
    ("between", "subject", "after_s"),
    [(Key("w"), "lock", 1.0), (None, "another lock", 1.0), (None, None, 1.0), (None, "lock", CONFIRM_S)],
)
def test_another_key_another_lock_and_time_end_the_question(
    between: Key | None, subject: object, after_s: float
) -> None:
    asked = Confirmation("r")
    asked.receive(R, 0.0, "lock")
    if between is not None:
        asked.receive(between, 0.5, "lock")
    assert not asked.is_asking(subject, after_s)
    assert not asked.receive(R, after_s, subject)
    assert asked.is_asking(subject, after_s) is (subject is not None)


def test_a_robot_that_is_locked_after_the_first_press_stays_locked() -> None:
    asked = Confirmation("r")
    asked.receive(R, 0.0, None)
    assert not asked.receive(R, 1.0, "lock")


def test_the_release_of_another_key_keeps_the_question() -> None:
    asked = Confirmation("r")
    asked.receive(R, 0.0, "lock")
    asked.receive(Key("w", Action.RELEASED), 0.5, "lock")
    assert asked.receive(R, 1.0, "lock")


def test_q_has_a_meaning_only_in_the_map_of_teleop_twist_keyboard() -> None:
    assert [driving(layout).has_meaning("q") for layout in ("original", "twist")] == [False, True]


@pytest.mark.parametrize("layout", LAYOUTS)
def test_the_help_lists_every_key(layout: str) -> None:
    original, twist = re.sub(r"\s+", " ", command.__doc__ or "").split("With --layout twist:")
    text = original if layout == "original" else twist
    directions, speeds = LAYOUTS[layout]
    arrows = {"up", "down", "left", "right"}
    assert ({*directions, *speeds} - arrows) <= set(re.split(r"[ ;:]+", text.replace(" ,", " , ")))
    assert "arrow keys" in text
    for key in ("q" if layout == "original" else "", "Ctrl-C"):
        assert key in text
    assert all(key in original for key in (*STOP_KEYS, f"{UNLOCK_KEY} twice"))
