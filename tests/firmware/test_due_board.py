"""The Due's pins and the parts on them: shield, mirrored motor, brake."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.firmware.worlds import LEFT, RIGHT, World, world

HIGH, LOW, FULL = 1, 0, 4095
DIRECTION, BRAKE, PWM = {LEFT: 2, RIGHT: 5}, {LEFT: 9, RIGHT: 8}, {LEFT: 3, RIGHT: 6}
SIDES = (LEFT, RIGHT)


def levels(made: World, side: int) -> tuple[int, int, int]:
    return made.pin(DIRECTION[side]), made.pin(BRAKE[side]), made.pin(PWM[side])


@pytest.mark.parametrize(("linear", "left", "right"), [(0.2, HIGH, LOW), (-0.2, LOW, HIGH)])
def test_the_paper_s_right_motor_is_mirrored(linear: float, left: int, right: int) -> None:
    """Forwards is DIR HIGH on the left and DIR LOW on the right, and the robot moves in a straight line."""
    with world() as made:
        made.drive(linear, 0.0, 2.0)
        assert [levels(made, side)[:2] for side in SIDES] == [(left, LOW), (right, LOW)]
        assert made.trace.x_m[-1] * linear > 0.01
        assert abs(made.trace.theta_rad[-1]) < 0.2
        assert made.resolution_bits == 12


def test_every_stop_brakes_with_the_enable_on() -> None:
    """On the shield's L298 the PWM is the enable: BRAKE HIGH with a PWM of 0 would let the motors run free."""
    with world() as made:
        assert [levels(made, side)[1:] for side in SIDES] == [(HIGH, FULL)] * 2  # never driven
        made.drive(0.2, 0.0, 2.0)
        assert all(levels(made, side)[1] == LOW for side in SIDES)
        made.drive(0.0, 0.0, 0.01)
        assert [levels(made, side)[1:] for side in SIDES] == [(HIGH, FULL)] * 2  # at once after a zero
        made.drive(0.2, 0.0, 2.0)
        made.run(0.6)
        assert [levels(made, side)[1:] for side in SIDES] == [(HIGH, FULL)] * 2  # after silence


@given(story=st.lists(st.tuples(st.sampled_from([0.0, 0.1, 0.3, -0.1, -0.3]), st.floats(0.05, 1.0)), max_size=5))
def test_order_of_pin_writes_never_drives_a_motor_harder_than_before_or_after(story: list[tuple[float, float]]) -> None:
    """The full duty of a brake never coincides with an open brake."""
    with world() as made:
        made.writes()
        pins = {pin: made.pin(pin) for side in SIDES for pin in (DIRECTION[side], BRAKE[side], PWM[side])}
        for linear, seconds in story:
            for _ in range(round(seconds / 0.05)):
                made.drive(linear, 0.0, 0.05)
                for pin, value in made.writes():
                    pins[pin] = value
                    assert all(pins[BRAKE[side]] or pins[PWM[side]] < FULL for side in SIDES)


@pytest.mark.parametrize("setup_s", [0.0, 1.0, 10.0])
def test_a_setup_that_takes_its_time_does_not_meet_the_watchdog(setup_s: float) -> None:
    with world(setup_s=setup_s) as made:
        made.drive(0.2, 0.0, 1.0)
        assert made.restarts == 0


@pytest.mark.parametrize(("hang_s", "restarts"), [(0.4, 0), (0.6, 1)])
def test_a_loop_that_does_not_turn_for_half_a_second_meets_the_watchdog(hang_s: float, restarts: int) -> None:
    with world() as made:
        made.drive(0.2, 0.0, 1.0)
        made.hang(hang_s)
        made.drive(0.2, 0.0, 1.0)
        assert made.restarts == restarts
