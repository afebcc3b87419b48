"""Lengths and angles that a person enters, and the state file between two drives."""

import contextlib
import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.cli.calibration_plan import (
    SavedCalibration,
    Sizes,
    checks_of,
    default_path,
    open_state,
    steps_of,
)
from hostlink.cli.quantities import UnitMissing, parse_angle, parse_length
from hostlink.core.robot.kinematics import Pose
from hostlink.errors import HostlinkError
from hostlink.workbench.calibration import MeasuredRun, Measurement, RunKind, WheelGeometry

RUN = MeasuredRun(RunKind.STRAIGHT, 3.0, (Pose(), Pose(3.0, 0.1, 0.01)), Measurement(2.98, 0.12))


@pytest.mark.parametrize(
    ("text", "metres"),
    [("12.5 cm", 0.125), ("-3 mm", -0.003), ("3.012 m", 3.012), ("12,5cm", 0.125), (" +7 CM ", 0.07), ("1e2cm", 1.0),
     ("10 in", 0.254), ('-10"', -0.254), ("0", 0.0), ("-0.0", 0.0)],
)  # fmt: skip
def test_parse_length_with_a_unit_is_in_metres(text: str, metres: float) -> None:
    assert parse_length(text) == pytest.approx(metres)


@pytest.mark.parametrize("text", ["12.5", "-0.42", "+3", "1e2", "12,5"])
def test_parse_length_without_a_unit_needs_a_default(text: str) -> None:
    with pytest.raises(UnitMissing, match=r"has no unit; enter for example 12\.5 cm") as missing:
        parse_length(text)
    assert missing.value.number == text
    assert parse_length(text, "cm") == pytest.approx(float(text.replace(",", ".")) / 100)
    assert parse_length(text + " mm", "cm") == pytest.approx(float(text.replace(",", ".")) / 1000)


@pytest.mark.parametrize("text", ["", "cm", "12 miles", "nan", "inf m", "1.2.3", "12 m m", "--1"])
def test_text_that_is_not_a_length_is_refused_with_an_example(text: str) -> None:
    with pytest.raises(ValueError, match="is not a length"):
        parse_length(text)


@given(st.text(max_size=12))
def test_no_text_breaks_the_reading(text: str) -> None:
    for parse in (parse_length, parse_angle):
        with contextlib.suppress(ValueError):
            assert math.isfinite(parse(text))


def test_angles_are_degrees() -> None:
    assert parse_angle("-90°") == pytest.approx(-math.pi / 2)
    assert parse_angle("12,5 degrees") == pytest.approx(math.radians(12.5))
    with pytest.raises(ValueError, match="is not a number of degrees"):
        parse_angle("left")


def test_lines_turns_and_squares_both_ways_are_driven() -> None:
    kinds = [step.kind for step in steps_of(Sizes())]
    assert kinds == [
        *[RunKind.STRAIGHT] * 2,
        RunKind.TURNS_CCW,
        RunKind.TURNS_CW,
        *[RunKind.SQUARE_CW, RunKind.SQUARE_CCW] * 2,
    ]
    assert [step.kind for step in checks_of(Sizes())] == [RunKind.STRAIGHT, RunKind.SQUARE_CW, RunKind.SQUARE_CCW]
    assert all("turns" not in step.kind for step in steps_of(Sizes(turns=0)))
    assert steps_of(Sizes(turns=1))[2].title == "1 turn on the spot, counter-clockwise"
    titles = {step.title: step.room for step in steps_of(Sizes())}
    assert titles["a square of 2 m, clockwise"] == "2.5 m of free floor before it and to its right"


def test_a_calibration_is_resumed_where_it_was(tmp_path: Path) -> None:
    wanted = SavedCalibration("robot_0", Sizes(), WheelGeometry())
    state = open_state(tmp_path / "folder" / "state.json", wanted, anew=False)
    state.saved.runs.append(RUN)
    state.save()
    again = open_state(state.path, SavedCalibration("robot_0", Sizes(), WheelGeometry()), anew=False)
    assert again.saved.runs == [RUN]
    assert open_state(state.path, wanted, anew=True).saved is wanted
    state.remove()
    assert not state.path.exists()


@pytest.mark.parametrize(
    ("other", "text"),
    [
        (SavedCalibration("robot_0", Sizes(side_m=4.0), WheelGeometry()), "another sizes"),
        (SavedCalibration("robot_0", Sizes(), WheelGeometry(0.05, 0.05, 0.2)), "another nominal"),
        (SavedCalibration("robot_1", Sizes(), WheelGeometry(0.05, 0.05, 0.2)), "another robot and nominal"),
    ],
)
def test_the_state_of_another_calibration_is_not_resumed(tmp_path: Path, other: SavedCalibration, text: str) -> None:
    open_state(tmp_path / "state.json", SavedCalibration("robot_0", Sizes(), WheelGeometry(), [RUN]), anew=False).save()
    with pytest.raises(HostlinkError, match=f"{text}; --anew begins again"):
        open_state(tmp_path / "state.json", other, anew=False)


def test_a_calibration_without_drives_is_not_kept(tmp_path: Path) -> None:
    open_state(tmp_path / "state.json", SavedCalibration("robot_0", Sizes(), WheelGeometry()), anew=False).save()
    wanted = SavedCalibration("robot_0", Sizes(side_m=4.0), WheelGeometry())
    assert open_state(tmp_path / "state.json", wanted, anew=False).saved is wanted


@pytest.mark.parametrize(
    ("content", "anew"), [(b"", False), (b"{}", False), (b'{"robot": 1}', False), (b"\xff", False), (b"my notes", True)]
)
def test_file_that_is_not_a_state_file_is_refused(tmp_path: Path, content: bytes, *, anew: bool) -> None:
    path = tmp_path / "state.json"
    path.write_bytes(content)
    with pytest.raises(HostlinkError, match="is not the state file of a calibration"):
        open_state(path, SavedCalibration("robot_0", Sizes(), WheelGeometry()), anew=anew)


def test_a_state_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    state = open_state(
        tmp_path / "file" / "state.json", SavedCalibration("robot_0", Sizes(), WheelGeometry()), anew=True
    )
    with pytest.raises(HostlinkError, match=r"state\.json"):
        state.save()


def test_the_state_is_in_the_user_s_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", "/some/where")
    assert default_path("fleet/robot_0") == Path("/some/where/hostlink/calibrate-fleet_robot_0.json")
