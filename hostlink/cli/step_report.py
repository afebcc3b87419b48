"""The figures of a step, for people and for programs. Pure."""

import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from hostlink.cli.output import table
from hostlink.cli.step_stages import Stage
from hostlink.robot.step_response import Record, StepFigures

DIGITS = 4


def step_lines(figures: Mapping[str, StepFigures], units: Mapping[str, str]) -> list[str]:
    """A column for each wheel."""
    unit = next(iter(units.values()))
    rows = [
        ["set-point", *(f"{each.target:.4g} {unit}" for each in figures.values())],
        ["rise time (10 to 90 %)", *(_seconds(each.rise_s) for each in figures.values())],
        ["  of the set-point", *(_seconds(each.set_point_rise_s) for each in figures.values())],
        ["behind the set-point", *(_seconds(each.lag_s) for each in figures.values())],
        ["dead time", *(_seconds(each.dead_s) for each in figures.values())],
        ["overshoot", *(f"{each.overshoot_percent:.1f} %" for each in figures.values())],
        ["settled (within 5 %)", *(_seconds(each.settling_s) for each in figures.values())],
        ["steady error", *(f"{each.steady_error_percent:+.1f} %" for each in figures.values())],
        ["tracking error", *(f"{each.tracking_error:.3g} {unit}" for each in figures.values())],
        ["full PWM", *(_percent(each.saturated_percent) for each in figures.values())],
    ]
    return table(["", *figures], rows)


def record_views(records: Mapping[str, Record], figures: Mapping[str, StepFigures]) -> dict[str, Any]:
    """By wheel: figures and samples."""
    return {
        side: {"figures": rounded(asdict(each)), "samples": sample_view(records[side])}
        for side, each in figures.items()
    }


def sample_view(record: Record) -> dict[str, Any]:
    """What was recorded, as lists."""
    return {
        "unit": record.unit,
        "t_s": [round(float(value), DIGITS) for value in record.t_s],
        "set_point": [round(float(value), DIGITS) for value in record.set_point],
        "measured": [round(float(value), DIGITS) for value in record.measured],
        "pwm": None if record.pwm is None else [round(float(value)) for value in record.pwm],
    }


def rounded(values: Mapping[str, Any]) -> dict[str, Any]:
    """Numbers with as many digits as mean something."""
    return {name: round(value, DIGITS) if isinstance(value, float) else value for name, value in values.items()}


def notes_of(stage: Stage, accepted: tuple[float, float], records: Mapping[str, Record]) -> list[str]:
    """What makes the figures of a drive other than they seem."""
    notes = []
    wanted = (stage.linear_m_s, stage.angular_rad_s)
    if not all(
        math.isclose(one, other, rel_tol=0.001, abs_tol=0.0005) for one, other in zip(wanted, accepted, strict=True)
    ):
        notes.append(
            f"the robot's limits made {accepted[0]:.3f} m/s, {accepted[1]:.3f} rad/s "
            f"of {wanted[0]:.3f} m/s, {wanted[1]:.3f} rad/s"
        )
    if any(record.is_set_point_changing for record in records.values()):
        notes.append("the set-point was still on its way at the end; request more --seconds")
    return notes


def _seconds(value: float | None) -> str:
    return "not reached" if value is None else f"{value:.2f} s"


def _percent(value: float | None) -> str:
    return "unknown" if value is None else f"{value:.0f} % of the time"
