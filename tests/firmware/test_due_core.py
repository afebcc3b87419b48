"""The Due's arithmetic, with the numbers of docs/paper-robot.md, and against hostlink's own robot."""

import ctypes
import math
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.core.robot.kinematics import DifferentialDrive, Pose
from hostlink.workbench.lab.robots import S_PER_TICK_S
from hostlink.workbench.sim.firmware_world import Feedback, Firmware
from tests.firmware.due import library, made

DRIVE = DifferentialDrive()
LOOP_S = 1 / 30


@pytest.mark.parametrize(
    ("wanted", "pwm"),
    [
        (0, 0), (10, 0), (11, 700), (700, 700), (701, 701), (4095, 4095), (5000, 4095), (-10, 0), (-11, -700),
        (-5000, -4095), (math.nan, 0), (math.inf, 4095), (-math.inf, -4095),
    ],
)  # fmt: skip
def test_the_pwm_map(wanted: float, pwm: int) -> None:
    assert library().pwm_of(wanted) == pwm


def test_minimum_jerk_reaches_its_target_on_time() -> None:
    with made("jerk") as jerk:
        library().jerk_aim(jerk, 100.0)  # 0.018 s a tick/s: 1.8 s
        values = [library().jerk_step(jerk, 0.1) for _ in range(20)]
    assert values == sorted(values)
    assert values[0] < 1.0
    assert values[8] == pytest.approx(50.0, abs=0.01)
    assert values[18:] == [100.0, 100.0]


def test_minimum_jerk_with_distance_zero_is_at_its_target() -> None:
    with made("jerk") as jerk:
        library().jerk_aim(jerk, 0.0)
        assert library().jerk_step(jerk, 0.1) == 0.0


def test_the_integral_does_not_wind_up_against_the_limit() -> None:
    """Ten seconds against a blocked wheel, then another sign: the output follows in a tenth of a second."""
    with made("pid", 23.0, 36.0, 0.0, 0.0) as pid:
        for _ in range(300):
            assert library().pid_step(pid, 250.0, 0.0, LOOP_S) == 4095.0
        outputs = [library().pid_step(pid, -50.0, 0.0, LOOP_S) for _ in range(3)]
    assert outputs[-1] < 0.0


def test_the_derivative_has_the_right_sign() -> None:
    with made("pid", 0.0, 0.0, 1.0, 0.0) as pid:
        library().pid_step(pid, 0.0, 0.0, 0.1)
        assert library().pid_step(pid, 10.0, 0.0, 0.1) == pytest.approx(100.0)
        assert library().pid_step(pid, 5.0, 0.0, 0.1) == pytest.approx(-50.0)


def test_the_feedback_term_subtracts_a_part_of_the_last_output() -> None:
    with made("pid", 1.0, 0.0, 0.0, 0.5) as pid:
        assert library().pid_step(pid, 100.0, 0.0, 0.1) == pytest.approx(100.0)
        assert library().pid_step(pid, 100.0, 0.0, 0.1) == pytest.approx(100.0 - 0.5 * 100.0 / 4095 * 280)


def test_the_filter_adds_a_tenth_of_what_is_new() -> None:
    with made("wheel", Feedback.WASHED_OUT) as wheel:
        observed = []
        for _ in range(3):
            library().wheel_step(wheel, 20, 0.1)  # ten ticks
            observed.append(library().wheel_speed(wheel))
    assert observed == pytest.approx([10.0, 19.0, 27.1])


def steady_ticks_s(feedback: Feedback, requested_ticks_s: float) -> float:
    """Mean speed of a wheel over two seconds, five seconds after its set-point is reached."""
    world, speeds, edges = Firmware().world, [], 0
    with made("wheel", feedback) as wheel:
        library().wheel_aim(wheel, requested_ticks_s)
        for _ in range(round((abs(requested_ticks_s) * S_PER_TICK_S + 7.0) / LOOP_S)):
            world.turn_motors(library().wheel_pwm(wheel), 0, LOOP_S, 1)
            library().wheel_step(wheel, world.left.edges - edges, LOOP_S)
            edges = world.left.edges
            speeds.append(world.left.speed_ticks_s)
    late = speeds[-round(2.0 / LOOP_S) :]
    return sum(late) / len(late)


@pytest.mark.parametrize("requested_ticks_s", [60.0, 100.0, 200.0, 270.0, -200.0])
def test_a_steady_speed_is_the_requested_one(requested_ticks_s: float) -> None:
    assert steady_ticks_s(Feedback.WASHED_OUT, requested_ticks_s) == pytest.approx(requested_ticks_s, rel=0.005)


@pytest.mark.parametrize("requested_ticks_s", [100.0, 200.0, -200.0])
def test_the_paper_s_feedback_keeps_every_speed_5_percent_low(requested_ticks_s: float) -> None:
    assert steady_ticks_s(Feedback.PAPER, requested_ticks_s) == pytest.approx(requested_ticks_s / 1.05, rel=0.005)


class Wheels(NamedTuple):
    """Radii and ticks of the left and the right wheel, and their distance."""

    radii_m: tuple[float, float] = (0.045, 0.045)
    ticks: tuple[float, float] = (230.4, 230.4)
    separation_m: float = 0.210

    def metres_per_tick(self, side: int) -> float:
        return math.tau * self.radii_m[side] / self.ticks[side]


PAPER = Wheels()
radii = st.floats(0.03125, 0.25, width=32)
ticks = st.floats(50.0, 2000.0, width=32)
some_wheels = st.just(PAPER) | st.builds(
    Wheels, st.tuples(radii, radii), st.tuples(ticks, ticks), st.floats(0.125, 1.0, width=32)
)


@contextmanager
def drive(wheels: Wheels) -> Iterator[int]:
    """The firmware's kinematics with these wheels, with its handle."""
    with made("drive", *wheels.radii_m, *wheels.ticks, wheels.separation_m) as handle:
        yield handle


@given(some_wheels, st.floats(-2.0, 2.0, width=32), st.floats(-10.0, 10.0, width=32))
def test_inverse_kinematics(wheels: Wheels, linear: float, angular: float) -> None:
    out = (ctypes.c_float * 2)()
    with drive(wheels) as handle:
        library().drive_wheel_speeds(handle, linear, angular, out)
    turning = angular * wheels.separation_m / 2
    left, right = (linear - turning) / wheels.metres_per_tick(0), (linear + turning) / wheels.metres_per_tick(1)
    factor = min(1.0, 280.0 / max(abs(left), abs(right), 1e-9))
    assert list(out) == pytest.approx([left * factor, right * factor], rel=1e-4, abs=1e-3)
    assert max(map(abs, out)) <= 280.01  # in reverse too


def test_the_paper_s_geometry_is_hostlink_s() -> None:
    assert PAPER.metres_per_tick(0) == pytest.approx(DRIVE.metres_per_tick)
    assert PAPER.separation_m == DRIVE.wheel_separation_m


@given(
    some_wheels,
    st.tuples(st.floats(-5, 5), st.floats(-5, 5), st.floats(-3.1, 3.1)),
    st.integers(-100, 100),
    st.integers(-100, 100),
)
def test_odometry_is_hostlink_s(wheels: Wheels, pose: tuple[float, float, float], left: int, right: int) -> None:
    values = (ctypes.c_double * 3)(*pose)
    with drive(wheels) as handle:
        library().drive_integrate(handle, values, left, right)
    model = DifferentialDrive(wheel_separation_m=wheels.separation_m)
    wanted = model.integrate(Pose(*pose), (left * wheels.metres_per_tick(0), right * wheels.metres_per_tick(1)))
    assert values[0] == pytest.approx(wanted.x_m, abs=1e-5)
    assert values[1] == pytest.approx(wanted.y_m, abs=1e-5)
    assert math.cos(values[2] - wanted.theta_rad) == pytest.approx(1.0, abs=1e-9)
    assert -math.pi < values[2] <= math.pi + 1e-12


def test_odometry_of_a_line_a_spin_and_a_circle() -> None:
    turn_ticks = math.pi * DRIVE.wheel_separation_m / DRIVE.metres_per_tick
    with drive(PAPER) as handle:
        values = (ctypes.c_double * 3)()
        for _ in range(100):
            library().drive_integrate(handle, values, 10.0, 10.0)
        assert list(values) == pytest.approx([1000 * DRIVE.metres_per_tick, 0.0, 0.0], rel=1e-5)
        values = (ctypes.c_double * 3)()
        for _ in range(100):
            library().drive_integrate(handle, values, -turn_ticks / 100, turn_ticks / 100)
        assert values[0] == pytest.approx(0.0, abs=1e-6)
        assert math.cos(values[2]) == pytest.approx(1.0, abs=1e-6)
        values = (ctypes.c_double * 3)()
        for _ in range(100):  # a circle with the track as its radius: wheel speeds 1 to 3
            library().drive_integrate(handle, values, turn_ticks / 100, 3 * turn_ticks / 100)
        assert [values[0], values[1]] == pytest.approx([0.0, 0.0], abs=1e-4)


@given(st.floats(allow_nan=False))
def test_a_float64_of_the_wire_is_read_as_a_float(value: float) -> None:
    got = library().from_float64(struct.pack("<d", value))
    if abs(value) < 2.0**-126:
        assert got == 0.0
    elif abs(value) >= 2.0**128:
        assert got == math.copysign(math.inf, value)
    else:
        assert got == pytest.approx(value, rel=2.0**-22)


@given(st.floats(width=32, allow_nan=False, allow_subnormal=False))
def test_a_float_is_written_as_a_float64(value: float) -> None:
    out = ctypes.create_string_buffer(8)
    library().to_float64(out, value)
    assert struct.unpack("<d", out.raw)[0] == value


def test_no_number_stays_no_number() -> None:
    assert math.isnan(library().from_float64(struct.pack("<d", math.nan)))
    out = ctypes.create_string_buffer(8)
    library().to_float64(out, math.nan)
    assert math.isnan(struct.unpack("<d", out.raw)[0])
