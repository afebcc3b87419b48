"""A wheel that is blocked, without encoder or driven by a broken driver: both motors off, logged once, until a zero."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.workbench.sim.firmware_module import WorldParameters
from tests.firmware.worlds import LEFT, RIGHT, World, world, worlds

SIDES = pytest.mark.parametrize(("side", "name"), [(LEFT, "left"), (RIGHT, "right")], ids=["left", "right"])
HIGH_PWM = 2048
TURN_S = 0.034


def drives_at(made: World) -> np.ndarray:
    """For every ten milliseconds: whether a motor was driven."""
    return (made.trace.left_drive != 0) | (made.trace.right_drive != 0)


def strained_s(made: World, side: int) -> float:
    """Total time for which the motor of a wheel had a high PWM."""
    drive = made.trace.left_drive if side == LEFT else made.trace.right_drive
    return float(np.sum(np.abs(drive) >= HIGH_PWM)) * 0.01


@SIDES
def test_a_wheel_that_is_blocked_stops_both_motors_within_half_a_second_of_a_high_pwm(side: int, name: str) -> None:
    with world() as made:
        made.drive(0.2, 0.0, 3.0)
        made.grip(side, 0.0)
        made.rows.clear()
        made.drive(0.2, 0.0, 3.0)
        assert strained_s(made, side) <= 0.5 + 3 * TURN_S
        assert not drives_at(made)[-100:].any()
        assert len(made.errors) == 1
        assert made.errors[0].startswith(f"{name} wheel stalled: no edge at PWM ")


@SIDES
def test_a_dead_encoder_is_a_stalled_wheel(side: int, name: str) -> None:
    with world() as made:
        made.deafen(side)
        made.drive(0.3, 0.0, 4.0)
        assert strained_s(made, side) <= 0.5 + 3 * TURN_S
        assert not drives_at(made)[-100:].any()
        assert [line.partition(":")[0] for line in made.errors] == [f"{name} wheel stalled"]


@given(speed=st.floats(0.002, 0.34), side=st.sampled_from([LEFT, RIGHT]), drawn=worlds())
def test_a_dead_encoder_ends_a_drive_at_any_speed(speed: float, side: int, drawn: WorldParameters) -> None:
    """The drive also ends at a speed so low that the PWM never gets high: after five seconds without an edge."""
    with world(drawn) as made:
        made.deafen(side)
        made.drive(speed, 0.0, 7.0)
        assert not drives_at(made)[-50:].any()
        assert ["left", "right"][side] in {line.partition(" ")[0] for line in made.errors}


@pytest.mark.parametrize("speed", [0.02, 0.1, 0.2, 0.3])
@SIDES
def test_a_motor_that_its_driver_keeps_running_is_logged_once(side: int, name: str, speed: float) -> None:
    with world() as made:
        made.drive(speed, 0.0, 5.0)
        made.stick(side)
        made.drive(speed, 0.0, 3.0)
        assert [line.partition(":")[0] for line in made.errors] == [f"{name} wheel runs away"]
        made.rows.clear()
        made.drive(0.1, 0.0, 1.0)
        for _ in range(20):
            made.drive(0.0, 0.0, 0.2)
        assert len(made.errors) == 1
        other = made.trace.right_drive if side == LEFT else made.trace.left_drive
        assert not other.any()


def test_a_motor_that_does_not_stop_after_a_zero_is_logged() -> None:
    with world() as made:
        made.drive(0.3, 0.0, 4.0)
        made.stick(LEFT)
        made.drive(0.0, 0.0, 2.0)
        assert [line.partition(":")[0] for line in made.errors] == ["left wheel runs away"]


def test_a_robot_that_is_pushed_while_it_stands_has_no_fault() -> None:
    with world() as made:
        made.drive(0.2, 0.0, 2.0)
        made.drive(0.0, 0.0, 1.0)
        made.grip(LEFT, 200.0)
        made.grip(RIGHT, 200.0)
        made.drive(0.0, 0.0, 4.0)
        assert made.errors == []


@pytest.mark.parametrize("speed", [0.02, 0.2, 0.33])
def test_an_encoder_that_never_rests_does_not_let_the_robot_reverse_and_is_logged(speed: float) -> None:
    with world() as made:
        made.drive(0.2, 0.0, 2.0)
        made.drive(0.0, 0.0, 0.1)
        made.grip(RIGHT, 30.0)
        made.rows.clear()
        made.drive(-speed, 0.0, 6.0)
        assert not (made.trace.right_drive != 0).any()
        assert [line.partition(":")[0] for line in made.errors] == ["right wheel runs away"]


def test_after_a_fault_only_a_zero_and_then_a_command_drives() -> None:
    with world() as made:
        made.grip(LEFT, 0.0)
        made.drive(0.2, 0.0, 4.0)
        assert len(made.errors) == 1
        made.release(LEFT)
        made.rows.clear()
        made.drive(0.2, 0.0, 2.0)
        assert not drives_at(made).any(), "commands go on, and nobody has looked"
        made.run(2.0)
        made.drive(0.2, 0.0, 1.0)
        assert not drives_at(made).any(), "silence is no zero"
        made.drive(0.0, 0.0, 0.3)
        made.drive(0.2, 0.0, 3.0)
        assert made.trace.left[-1] > 100.0
        assert len(made.errors) == 1


def test_a_wheel_that_stalls_again_is_logged_again() -> None:
    with world() as made:
        made.grip(LEFT, 0.0)
        for _ in range(2):
            made.drive(0.3, 0.0, 4.0)
            made.drive(0.0, 0.0, 0.3)
        assert len(made.errors) == 2
