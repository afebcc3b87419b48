"""The laboratory drives the firmware that the board executes (HOSTLINK_LAB_RUNS: runs of each pattern)."""

import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hostlink.cli.main import build_app
from hostlink.workbench.lab.experiment import (
    BACK,
    LINE,
    PAPER_WORLD,
    SQUARE_LEFT,
    SQUARE_RIGHT,
    Errors,
    Experiment,
    Laboratory,
    Pattern,
    Setup,
    Software,
    calibrated,
    measure,
)
from hostlink.workbench.lab.tables import CALIBRATED, CASTER_WORLD, CAUSES, OURS, PAPER, REBUILT, Cause, tables

RUNS = int(os.environ.get("HOSTLINK_LAB_RUNS", "3"))
LABORATORY = Laboratory(workers=1)
NAMED = {cause.name: cause for cause in CAUSES}


def ours(cause: Cause, pattern: Pattern) -> Errors:
    return measure(Experiment(cause.setup(Software.FIRMWARE), pattern, RUNS))


@pytest.mark.parametrize("pattern", [SQUARE_LEFT, SQUARE_RIGHT], ids=lambda pattern: pattern.name)
@pytest.mark.parametrize("world", [NAMED["none"], NAMED["jump"], NAMED["battery"]], ids=lambda cause: cause.name)
def test_stop_and_go_square_in_a_perfect_world_ends_where_its_odometry_says(world: Cause, pattern: Pattern) -> None:
    assert np.hypot(*ours(world, pattern).xy_cm.T).max() < 0.002 * 800  # 0.2 % of the distance


def test_a_larger_wheel_shortens_the_line_that_odometry_measures() -> None:
    errors = ours(NAMED["radius"], LINE)
    lengths_cm = [LINE.marks_of(run)[0][0] * 100 for run in range(RUNS)]
    assert errors.length_cm == pytest.approx([-0.005 * length for length in lengths_cm], abs=0.15)


def test_caster_twists_squares_in_both_directions_but_not_lines() -> None:
    left, right = ours(NAMED["caster_twist"], SQUARE_LEFT), ours(NAMED["caster_twist"], SQUARE_RIGHT)
    assert np.all(left.xy_cm[:, 0] < 0.0)
    assert np.all(left.xy_cm[:, 1] > 0.0)
    assert np.all(right.xy_cm < 0.0)
    assert left.means_cm == pytest.approx(right.means_cm, rel=0.2)
    assert ours(NAMED["caster_twist"], LINE).means_cm < 0.2


@pytest.mark.long
def test_tables_have_the_paper_s_values_and_calibration_gains_threefold() -> None:
    sizes = tables(CASTER_WORLD, LABORATORY, runs=RUNS, report=lambda _: None)
    driven = {
        pattern: {title: each.mean(axis=0) for title, each in columns.items()} for pattern, columns in sizes.items()
    }
    assert [pattern.table for pattern in driven] == [2, 3, 4, 5]
    assert driven[LINE][PAPER] == pytest.approx([1.84])
    assert driven[LINE][REBUILT] == pytest.approx([1.84], abs=0.2)
    squares = [driven[SQUARE_LEFT], driven[SQUARE_RIGHT]]
    before, after = (sum(table[title].sum() for table in squares) for title in (OURS, CALIBRATED))
    assert before > 3.0 * after
    assert driven[LINE][CALIBRATED] < 0.2


@settings(max_examples=10, deadline=None)
@given(
    left_m=st.floats(0.044, 0.046),
    right_m=st.floats(0.044, 0.046),
    track_m=st.floats(0.2, 0.22),
    threshold_pwm=st.floats(0.0, 680.0),
    has_jump=st.booleans(),
)
def test_firmware_with_the_true_numbers_ends_where_its_odometry_says(
    left_m: float, right_m: float, track_m: float, threshold_pwm: float, has_jump: bool
) -> None:
    wheels = {"left.radius_m": left_m, "right.radius_m": right_m, "track_m": track_m}
    motors = {"dead_zone_pwm": threshold_pwm, "has_jump": float(has_jump)}
    both = {f"{side}.{name}": value for side in ("left", "right") for name, value in motors.items()}
    numbers = (("wheel_radius", (left_m, right_m)), ("wheel_separation", (track_m,)))
    world = PAPER_WORLD.changed(wheels | both)
    setup = Setup(software=Software.FIRMWARE, world=world, device_parameters=numbers)
    errors = measure(Experiment(setup, SQUARE_RIGHT, 2))
    assert np.hypot(*errors.xy_cm.T).max() < 0.002 * 800  # 0.2 % of the distance


@pytest.mark.long
def test_calibration_without_noise_finds_wheels_and_track() -> None:
    wheels = {"left.radius_m": 0.0452, "right.radius_m": 0.0447, "track_m": 0.215}
    before = Setup(software=Software.FIRMWARE, world=PAPER_WORLD.changed(wheels))
    after = calibrated(before)
    for pattern in (SQUARE_LEFT, SQUARE_RIGHT):
        error_cm, left_cm = (measure(Experiment(setup, pattern, RUNS)).means_cm.max() for setup in (before, after))
        assert error_cm > 10.0
        assert left_cm < error_cm / 100


def test_a_push_spoils_any_software() -> None:
    errors = ours(NAMED["push"], BACK)
    assert np.abs(errors.xy_cm).max() > 4.0


def test_the_command_prints_the_tables_and_the_world(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    world = tmp_path / "world.txt"
    world.write_text(PAPER_WORLD.changed({"left.radius_m": 0.0452}).text())
    build_app("lab")(["lab", "tables", "--runs", "2", "--world", str(world)], standalone_mode=False)
    lines = capsys.readouterr().out.splitlines()
    firsts = [line.split("|")[1].strip() for line in lines if line.startswith("| ")]
    assert firsts == ["table", "2", "2", "3", "3", "4", "5", "5"]
    assert "left.radius_m=0.0452" in lines[-1]


@pytest.mark.long
def test_pictures_are_drawn(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    picture = tmp_path / "paths.png"
    build_app("lab")(["lab", "pictures", "--runs", "2", "-o", str(picture)], standalone_mode=False)
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert " kB" in capsys.readouterr().out
