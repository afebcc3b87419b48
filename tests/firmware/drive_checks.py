"""Conditions of every drive in any world: true odometry, no overspeed, stopped after a zero."""

import numpy as np

from hostlink.workbench.sim.firmware_module import WorldParameters
from tests.firmware.worlds import FULL_PWM, LEFT, RIGHT, Trace

STANDING_TICKS_S = 5.0  # 6 mm/s
CREEP_TICKS_S = 15.0  # 18 mm/s: speed of a frictionless wheel at the lowest PWM before the encoder has two edges
ROW_S = 0.01
STOP_S = 0.6
QUICK_BRAKE_S = 0.14  # time constant of a motor that the brake stops within STOP_S from any speed
OVER_S = 0.3
LATE_TICKS = 12.0  # odometry is one turn of the loop late: 9.3 ticks at full speed, and parts of a tick
REVERSAL_TICKS = 1.0  # unseen rolling, under 5 ticks/s, while the sign changes
AGAINST_TICKS_S = 15.0

Wheel = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def wheels(trace: Trace, commanded: np.ndarray) -> list[Wheel]:
    """For each wheel: true speed, set-point, commanded speed, drive of its motor."""
    return [
        (trace.left, trace.left_set, commanded[:, LEFT], trace.left_drive),
        (trace.right, trace.right_set, commanded[:, RIGHT], trace.right_drive),
    ]


def check_odometry(trace: Trace, reversals: int) -> None:
    """Odometry counts the motion of each wheel: delayed during the drive, except for reversals at the end."""
    true = (trace.left_rolled, trace.right_rolled)
    for rolled, counted in zip(true, trace.rolled(), strict=True):
        off = np.abs((rolled - rolled[0]) - (counted - counted[0]))
        assert float(np.max(off)) <= LATE_TICKS + REVERSAL_TICKS * reversals
        assert float(off[-1]) <= 1.0 + REVERSAL_TICKS * reversals


def check_speed(trace: Trace, commanded: np.ndarray) -> None:
    """No wheel is faster than 1.1 times the command for longer than 0.3 s, and none is driven against its motion."""
    for wheel in wheels(trace, commanded):
        speed, _, _, drive = wheel
        assert too_fast_s(wheel) <= OVER_S
        against_ticks_s = float(np.max(-speed * np.sign(drive), initial=0.0))
        assert against_ticks_s <= AGAINST_TICKS_S, "a motor was driven against its wheel"


def check_standstill(trace: Trace, drawn: WorldParameters) -> None:
    """Rows from a zero on: the robot stops as soon as the brake allows, within 0.6 s for a constant up to 0.14 s."""
    for side, speed in (("left", trace.left), ("right", trace.right)):
        after = np.abs(speed)
        stood_s = float(np.max(np.flatnonzero(after > STANDING_TICKS_S), initial=-1) + 1) * ROW_S
        assert stood_s <= brake_s(drawn, side, float(after[0])) + 2 * ROW_S
        assert stood_s <= STOP_S + ROW_S or drawn[f"{side}.brake_constant_s"] > QUICK_BRAKE_S


def longest_s(is_so: np.ndarray) -> float:
    """Longest time for which a condition held without interruption."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], is_so.astype(int), [0]])))
    return float(np.max(edges[1::2] - edges[::2], initial=0)) * ROW_S


def recent_most(values: np.ndarray) -> np.ndarray:
    """Maximum of the last 0.3 s: a wheel with a lower command has to brake first."""
    rows = round(OVER_S / ROW_S)
    padded = np.concatenate([np.full(rows - 1, values[0]), values])
    return np.max(np.lib.stride_tricks.sliding_window_view(padded, rows), axis=1)


def too_fast_s(wheel: Wheel) -> float:
    """Time during which a driven wheel was faster than 1.1 times the command plus a tick in 0.2 s."""
    speed, set_point, commanded, _ = wheel
    most = recent_most(np.maximum(np.abs(commanded), np.abs(set_point)))
    allowed = np.maximum(1.1 * most + STANDING_TICKS_S, CREEP_TICKS_S)
    return longest_s((np.abs(speed) > allowed) & (commanded != 0))


def brake_s(drawn: WorldParameters, side: str, speed_ticks_s: float) -> float:
    """Time that the shorted motor needs by itself."""
    friction_rad_s = drawn[f"{side}.friction_rad_s"] + drawn["floor_pwm"] / FULL_PWM * drawn[f"{side}.full_speed_rad_s"]
    friction_ticks_s = friction_rad_s * drawn[f"{side}.ticks_per_turn"] / (2 * np.pi)
    ratio = (speed_ticks_s + friction_ticks_s) / (STANDING_TICKS_S + friction_ticks_s)
    return drawn[f"{side}.brake_constant_s"] * float(np.log(max(ratio, 1.0)))
