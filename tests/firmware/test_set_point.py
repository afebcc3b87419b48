"""The wheels' set-point under changing commands, like those of a joystick, a ramp or a controller.

The firmware's curve, and the whole firmware in a world.
"""

import math
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from itertools import count, repeat

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from hostlink.workbench.lab.robots import S_PER_TICK_S
from hostlink.workbench.sim.firmware_world import COMMAND_S, Feedback, FirmwareWorld
from tests.firmware.due import library, made

LOOP_S = 1 / 30
FULL_TICKS_S = 280.0
STEEPEST_TICKS_S2 = 1.875 / S_PER_TICK_S  # of each minimum-jerk curve, independent of its distance
STEEPEST_SLOWER_TICKS_S2 = 1.875 * 20 / S_PER_TICK_S  # of a curve towards zero
ROUNDING_TICKS_S = 0.001
HUGE = 2.0**122
LAG_S = 0.1
Story = list[tuple[float, int]]  # targets, and the turns of the loop until the next one


class Curve:
    """MinimumJerk of wheel.h."""

    def __init__(self, handle: int) -> None:
        self._handle = handle

    def aim(self, target: float) -> None:
        library().jerk_aim(self._handle, target)

    def step(self, dt_s: float) -> float:
        return float(library().jerk_step(self._handle, dt_s))


@contextmanager
def set_point() -> Iterator[Curve]:
    with made("jerk") as handle:
        yield Curve(handle)


steps_s = st.sampled_from([0.001, 0.01, LOOP_S, 0.05, 0.2])


@st.composite
def joysticks(draw: st.DrawFn) -> Story:
    """Creeping, sweeping, trembling and jumping targets, with a new command every few turns."""
    target, story = 0.0, []
    change = st.just(0.0) | st.floats(-15.0, 15.0, width=32) | st.floats(-500.0, 500.0, width=32)
    for by, tremble, commands, turns in draw(
        st.lists(
            st.tuples(change, st.sampled_from([0.0, 0.8, 5.0]), st.integers(1, 15), st.integers(1, 10)), max_size=6
        )
    ):
        for number in range(commands):
            target = max(-FULL_TICKS_S, min(FULL_TICKS_S, target + by))
            story.append((float(np.float32(target + tremble * (-1) ** number)), turns))
    return story


def after_command(value: float, target: float) -> float:
    """The set-point after a new target: a zero and another sign stop at once."""
    return value if value * target > 0.0 else 0.0


@given(joysticks(), steps_s)
def test_set_point_under_any_commands_never_passes_the_target_nor_is_steeper_than_its_curve(
    story: Story, dt_s: float
) -> None:
    with set_point() as curve:
        value = 0.0
        for target, turns in story:
            curve.aim(target)
            value = after_command(value, target)
            for _ in range(turns):
                before, value = value, curve.step(dt_s)
                assert min(before, target) - ROUNDING_TICKS_S <= value <= max(before, target) + ROUNDING_TICKS_S
                steepest = STEEPEST_SLOWER_TICKS_S2 if abs(target) < abs(before) else STEEPEST_TICKS_S2
                assert abs(value - before) <= steepest * dt_s + ROUNDING_TICKS_S


@given(joysticks(), steps_s)
def test_set_point_after_a_command_of_the_other_sign_never_has_the_old_sign(story: Story, dt_s: float) -> None:
    with set_point() as curve:
        for target, turns in story:
            curve.aim(target)
            assert all(curve.step(dt_s) * target >= 0.0 for _ in range(turns))


@given(joysticks(), steps_s, st.floats(0.0, 1.0))
def test_set_point_of_a_slower_command_is_there_in_a_fifth_of_the_paper_s_time(
    story: Story, dt_s: float, share: float
) -> None:
    with set_point() as curve:
        value = target = 0.0
        for target, turns in story:
            curve.aim(target)
            for _ in range(turns):
                value = curve.step(dt_s)
        slower = float(np.float32(share * value))
        if slower in (target, value):
            return
        curve.aim(slower)
        for _ in range(math.ceil(abs(value - slower) * S_PER_TICK_S / 5.0 / dt_s) + 1):
            value = curve.step(dt_s)
        assert value == slower


@given(joysticks(), steps_s, st.floats(-FULL_TICKS_S, FULL_TICKS_S, width=32))
def test_a_changed_command_is_reached_no_later_than_by_a_curve_from_a_standstill(
    story: Story, dt_s: float, last: float
) -> None:
    with set_point() as curve:
        value = 0.0
        for target, turns in story:
            curve.aim(target)
            for _ in range(turns):
                value = curve.step(dt_s)
        curve.aim(last)
        if story and last == story[-1][0]:
            return
        for _ in range(math.ceil(abs(last - after_command(value, last)) * S_PER_TICK_S / dt_s * 1.001) + 1):
            value = curve.step(dt_s)
        assert value == last


@given(
    first=st.floats(40.0, FULL_TICKS_S, width=32),
    share=st.floats(0.02, 0.98),
    further=st.floats(20.0, 500.0, width=32),
    sign=st.sampled_from([-1.0, 1.0]),
)
def test_another_target_the_same_way_keeps_the_slope(first: float, share: float, further: float, sign: float) -> None:
    """Over a millisecond a curve of 20 ticks/s or more, away from zero, changes its slope by less than 1 tick/s2."""
    with set_point() as curve:
        curve.aim(sign * first)
        values = [curve.step(0.001) for _ in range(math.ceil(share * first * S_PER_TICK_S / 0.001))]
        curve.aim(float(np.float32(values[-1] + sign * further)))
        values.append(curve.step(0.001))
    before, after = np.diff(np.array([0.0, 0.0, *values]))[-2:] / 0.001
    assert after == pytest.approx(before, abs=2.0)


@given(joysticks())
def test_a_repeated_command_changes_nothing(story: Story) -> None:
    with set_point() as once, set_point() as again:
        for target, turns in story:
            once.aim(target)
            for _ in range(turns):
                again.aim(target)
                assert again.step(LOOP_S) == once.step(LOOP_S)


@given(
    rate=st.floats(1.0, 90.0),
    turns=st.integers(1, 6),
    tremble=st.floats(0.0, 1.0),
    sign=st.sampled_from([-1.0, 1.0]),
)
def test_a_ramp_of_small_changes_is_followed(rate: float, turns: int, tremble: float, sign: float) -> None:
    """At up to 90 ticks/s2 (0.11 m/s2) the set-point lags by the change of the command in LAG_S."""
    with set_point() as curve:
        for number in range(round(4.0 / LOOP_S / turns)):
            target = rate * number * turns * LOOP_S + tremble * (-1) ** number
            curve.aim(sign * target)
            for _ in range(turns):
                value = sign * curve.step(LOOP_S)
            assert target - value <= rate * LAG_S + 2.0 * tremble


hostile = st.floats(-HUGE, HUGE, width=32) | st.sampled_from([2.0**-149, -(2.0**-149), HUGE, -HUGE, 0.0])


@given(st.lists(st.tuples(hostile, st.integers(0, 3)), max_size=20), st.floats(1e-6, 0.2))
@example([(2.0**-146, 0), (2.0**100, 0), (HUGE, 2)], LOOP_S)
def test_set_point_after_any_input_is_finite(story: Story, dt_s: float) -> None:
    with set_point() as curve:
        for target, turns in story:
            curve.aim(target)
            assert all(math.isfinite(curve.step(dt_s)) for _ in range(turns))


@given(joysticks())
def test_a_zero_stops_at_once_and_the_next_motion_begins_without_slope(story: Story) -> None:
    with made("wheel", Feedback.WASHED_OUT) as wheel:
        for target, turns in [*story, (200.0, 20)]:
            library().wheel_aim(wheel, target)
            for _ in range(turns):
                library().wheel_step(wheel, 2, LOOP_S)
        library().wheel_aim(wheel, 0.0)
        assert library().wheel_set_point(wheel) == 0.0
        library().wheel_step(wheel, 0, LOOP_S)
        assert library().wheel_pwm(wheel) == 0
        library().wheel_aim(wheel, 200.0)
        library().wheel_step(wheel, 0, LOOP_S)
        assert abs(library().wheel_set_point(wheel)) < 0.01  # in its first turn the curve moves by 0.002


def reached_s(commands: Iterable[float], share: float = 0.95) -> float:
    """Time after which a robot with a new velocity every tenth of a second has this share of 0.2 m/s; at most 30 s."""
    robot = FirmwareWorld()
    robot.connect()
    for number, command in zip(range(300), commands, strict=False):
        robot.drive(command, 0.0, COMMAND_S)
        if abs(robot.world.left.speed_m_s) >= share * 0.2:
            return (number + 1) * COMMAND_S
    return math.inf


@pytest.mark.parametrize("acceleration_m_s2", [0.03, 0.1, 0.2, 0.5, 1.0])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_robot_follows_a_joystick_no_later_than_a_single_command_after_it(
    acceleration_m_s2: float, sign: float
) -> None:
    ramp = (sign * min(0.2, acceleration_m_s2 * COMMAND_S * (number + 1)) for number in count())
    assert reached_s(ramp) <= 0.2 / acceleration_m_s2 + reached_s(repeat(sign * 0.2))


@pytest.mark.parametrize("amplitude_m_s", [0.0001, 0.001, 0.005])
def test_a_trembling_joystick_drives_the_robot(amplitude_m_s: float) -> None:
    trembling = (0.2 + amplitude_m_s * math.sin(4.0 * number) for number in count())
    assert reached_s(trembling) <= reached_s(repeat(0.2)) + COMMAND_S


@given(st.lists(st.tuples(st.floats(), st.floats()), min_size=1, max_size=5))
@example([(3e38, 0.0)])
@example([(1e300, -1e300)])
def test_nan_velocity_stops_and_the_next_one_drives(commands: list[tuple[float, float]]) -> None:
    robot = FirmwareWorld()
    robot.connect()
    for linear, angular in commands:
        robot.drive(linear, angular, COMMAND_S)
        assert all(abs(robot.world.row[f"{side}_set_ticks_s"]) <= FULL_TICKS_S + 0.01 for side in ("left", "right"))
    robot.drive(0.0, 0.0, 1.0)
    robot.drive(3e38, 0.0, COMMAND_S)
    robot.drive(0.2, 0.0, 3.0)
    assert robot.world.left.speed_m_s > 0.1


SLOWER = {
    "a little": [0.25],
    "much": [0.1],
    "along a ramp": [0.3 - 0.005 * number for number in range(40)] + [0.1],
    "on a trembling ramp": [0.3 - 0.005 * number + 0.002 * (-1) ** number for number in range(40)] + [0.1],
}


@pytest.mark.parametrize("commands", SLOWER.values(), ids=SLOWER.keys())
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_wheel_that_is_to_go_slower_follows_and_does_not_swing(commands: list[float], sign: float) -> None:
    """A second later it follows, and does not brake again."""
    robot = FirmwareWorld()
    robot.connect()
    robot.drive(sign * 0.3, 0.0, 6.0)
    for command in commands:
        robot.drive(sign * command, 0.0, COMMAND_S, sample_s=0.01)
    robot.drive(sign * commands[-1], 0.0, 5.0, sample_s=0.01)
    error_ticks_s = robot.trace["left_ticks_s"] - robot.trace["left_set_ticks_s"]
    assert math.sqrt(np.mean(error_ticks_s[-400:] ** 2)) < 2.0
    assert np.abs(error_ticks_s[-400:]).max() < 0.05 * abs(robot.trace["left_set_ticks_s"][-1])
    assert np.all(robot.trace["left_pwm"][-400:] != 0)
