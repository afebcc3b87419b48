"""`hostlink calibrate`: with a simulated robot, and with a person whose answers are in a file."""

import io
import json
import tomllib
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

import pytest
from typer.testing import CliRunner, Result

from hostlink.cli.calibrate import GuidedCalibration, settings_of
from hostlink.cli.calibration_plan import SavedCalibration, Sizes, open_state
from hostlink.cli.calibration_session import AtTheTerminal, Drives, Show, numbers_of, pose_of, require_two_wheels
from hostlink.cli.main import build_app
from hostlink.cli.output import write, write_error
from hostlink.cli.settings import load
from hostlink.client.course import CourseFollower, Leg, Speed
from hostlink.core.robot.kinematics import Pose
from hostlink.core.robot.odometry import OdometryCorrection
from hostlink.errors import ConfigError, HostlinkError
from hostlink.workbench.calibration import WheelGeometry, calibrated
from tests.unit.core.robot.drives import ExactRobot, relative

TRUE = WheelGeometry(0.0448, 0.0453, 0.2142)
SMALL = ("--length", "2", "--side", "1", "--turns", "2", "--repeats", "1")


def calibrate(folder: Path, *arguments: str) -> Result:
    words = ["calibrate", "robot_0", "--simulate", "--state", str(folder / "state.json"), *arguments]
    return CliRunner().invoke(build_app("calibrate"), words)


@pytest.mark.slow
def test_a_simulated_robot_s_wheels_are_found(tmp_path: Path) -> None:
    result = calibrate(tmp_path, *SMALL, "--json")
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout.splitlines()[-1])
    assert found["wheels"]["separation_m"] == pytest.approx(TRUE.separation_m, rel=0.005)
    assert found["check_after_m"] < found["check_before_m"] / 3
    assert not (tmp_path / "state.json").exists()
    drawn = ElementTree.parse(tmp_path / "state.svg").getroot()  # noqa: S314 - of our own making
    assert len(drawn.findall("{*}polyline")) > 4


@pytest.mark.slow
def test_write_option_writes_the_result_into_the_configuration(tmp_path: Path) -> None:
    file = tmp_path / "hostlink.toml"
    file.write_text('[parameters]\n"robot_0/wheel_radius" = 0.045\n')
    result = calibrate(tmp_path, *SMALL, "--write", str(file), "--write-simulated")
    assert result.exit_code == 0, result.output
    values = tomllib.loads(file.read_text())["parameters"]
    assert sorted(values) == ["/robot_0/wheel_separation", "robot_0/wheel_radius"]
    assert values["robot_0/wheel_radius"] == pytest.approx(TRUE[:2], rel=0.003)
    assert "Confirmed" in result.stdout


@pytest.mark.slow
def test_a_file_in_which_the_numbers_cannot_stand_is_refused_before_any_drive(tmp_path: Path) -> None:
    file = tmp_path / "hostlink.toml"
    assert isinstance(calibrate(tmp_path, "--write", str(file), "--write-simulated").exception, ConfigError)
    file.write_text("[robots.robot_0.calibration]\nleft_factor = 1.01\n")
    result = calibrate(tmp_path, "--write", str(file), "--write-simulated")
    assert "remove it" in str(result.exception)
    file.write_text("parameters = { }\n")
    assert "hostlink cannot change this file" in str(
        calibrate(tmp_path, "--write", str(file), "--write-simulated").exception
    )
    file.write_text("[robots.robot_0.calibration]\nleft_factor = 1.01\n")
    assert not (tmp_path / "state.svg").exists()
    assert calibrate(tmp_path, *SMALL, "--target", "hostlink", "--write", str(file), "--write-simulated").exit_code == 0
    assert load(file).robots["robot_0"].calibration.separation_m == pytest.approx(TRUE.separation_m, rel=0.005)


def test_numbers_of_no_robot_are_written_only_where_that_is_meant(tmp_path: Path) -> None:
    file = tmp_path / "hostlink.toml"
    file.write_text("[parameters]\n")
    result = calibrate(tmp_path, *SMALL, "--write", str(file))
    assert isinstance(result.exception, ConfigError)
    assert "--write-simulated" in str(result.exception)
    assert file.read_text() == "[parameters]\n"
    assert not (tmp_path / "state.svg").exists()


@pytest.mark.slow
@pytest.mark.parametrize(("mistake", "text"), [("slip", "does not confirm"), ("sides", "left and right")])
def test_a_wrong_tape_measure_keeps_nothing(tmp_path: Path, mistake: str, text: str) -> None:
    file = tmp_path / "hostlink.toml"
    file.write_text("")
    result = calibrate(tmp_path, *SMALL, "--mistake", mistake, "--write", str(file), "--write-simulated")
    assert isinstance(result.exception, HostlinkError)
    assert text in str(result.exception)
    assert file.read_text() == ""


@pytest.mark.parametrize(
    "arguments",
    [
        ("--world", "trak_m=0.2"),
        ("--world", "track_m=wide"),
        ("--nominal", "0.045"),
        ("--nominal", "0,0,0"),
        ("--nominal", "45,45,210"),
        ("--nominal", "0.45,0.45,0.21"),
    ],
)
def test_wrong_argument_is_refused(tmp_path: Path, arguments: Sequence[str]) -> None:
    assert isinstance(calibrate(tmp_path, *arguments).exception, ConfigError)


@pytest.mark.parametrize("arguments", [("--mistake", "none"), ("--target", "moon")])
def test_unknown_choice_is_refused(tmp_path: Path, arguments: Sequence[str]) -> None:
    assert calibrate(tmp_path, *arguments).exit_code == 2


@pytest.mark.parametrize("option", ["--length", "--side", "--linear", "--angular"])
def test_nan_is_refused_as_a_length_and_as_a_speed(tmp_path: Path, option: str) -> None:
    assert calibrate(tmp_path, option, "nan").exit_code == 2


@pytest.mark.parametrize("arguments", [("--world", "track_m=0.2"), ("--mistake", "slip")])
def test_world_option_without_simulate_drives_no_robot(arguments: Sequence[str]) -> None:
    words = ["calibrate", "robot_0", *arguments, "--url", "http://127.0.0.1:1"]
    result = CliRunner().invoke(build_app("calibrate"), words)
    assert isinstance(result.exception, ConfigError)
    assert "--simulate" in str(result.exception)


def test_a_simulated_robot_that_cannot_move_is_one_line(tmp_path: Path) -> None:
    result = calibrate(tmp_path, *SMALL, "--world", "floor_pwm=4000")
    assert isinstance(result.exception, HostlinkError)
    assert "does not reach its goal" in str(result.exception)


@pytest.mark.slow
def test_a_picture_that_cannot_be_drawn_costs_no_drive(tmp_path: Path) -> None:
    result = calibrate(tmp_path, *SMALL, "--picture", str(tmp_path))
    assert isinstance(result.exception, HostlinkError)
    assert "the drives are kept" in str(result.exception)
    assert (tmp_path / "state.json").exists()


@pytest.mark.slow
def test_apply_to_a_simulated_robot_is_refused(tmp_path: Path) -> None:
    assert isinstance(calibrate(tmp_path, *SMALL, "--apply").exception, HostlinkError)


def test_a_robot_that_keeps_its_numbers_gets_factors() -> None:
    found = calibrated(ExactRobot(WheelGeometry(), TRUE).drives(1), WheelGeometry())
    tables = settings_of("lab 2", found.geometry, found.correction, "hostlink", None)
    lines = tables['robots."lab 2".calibration']
    assert float(lines["left_factor"]) == pytest.approx(0.0448 / 0.045, rel=1e-5)
    assert float(lines["separation_m"]) == pytest.approx(0.2142, rel=1e-5)


# -- a person ---------------------------------------------------------------------------------------------------------


class ExactDrives(Drives):
    """Drives without a daemon, of a robot without motors."""

    def __init__(self) -> None:
        super().__init__("", None, "robot_0", Speed())
        self.robot_driven = ExactRobot(WheelGeometry(), TRUE)
        self.broken = 0  # how many drives are to be broken off

    async def nominal(self) -> WheelGeometry:
        return WheelGeometry()

    async def follow(self, legs: Sequence[Leg], correction: OdometryCorrection, show: Show) -> tuple[Pose, ...]:
        if self.broken:
            self.broken -= 1
            raise HostlinkError("its odometry jumped: this drive does not count")
        robot, shown, now_s = self.robot_driven, Pose(), 0.0
        follower, path = CourseFollower(legs), [robot.odometry]
        while not follower.is_done:
            robot.move(*follower.update(shown, now_s))
            shown = correction.advance(shown, path[-1], robot.odometry)
            path.append(robot.odometry)
            now_s += 0.1
            show(follower.legs_left, now_s)
        return tuple(path)


class Answers(io.StringIO):
    """A person's terminal: Enter before each drive, then a perfect tape measure."""

    def __init__(self, drives: ExactDrives, script: list[str]) -> None:
        super().__init__()
        self._robot, self._script = drives.robot_driven, script
        self._start, self._turned_rad = self._robot.truth, 0.0

    def readline(self, _: int | None = -1) -> str:  # type: ignore[override]
        word = self._script.pop(0) if self._script else ""
        end = relative(self._start, self._robot.truth)
        match word:
            case "start":
                self._start = self._robot.truth
                return "\n"
            case "x":
                return f"{end.x_m} m\n"
            case "y":
                return f"{end.y_m * 100} cm\n"
            case "x in a wrong unit":
                return f"{end.x_m} cm\n"
            case "y in a wrong unit":
                return f"{end.y_m} cm\n"
        return word


def guided(folder: Path, drives: ExactDrives, *, is_quiet: bool = False) -> GuidedCalibration:
    wanted = SavedCalibration("robot_0", Sizes(length_m=2.0, side_m=1.0, turns=0, repeats=1), WheelGeometry())
    state = open_state(folder / "state.json", wanted, anew=False)
    person = AtTheTerminal(drives, write_error if is_quiet else write)
    return GuidedCalibration(person, state, folder / "picture.svg", is_quiet=is_quiet)


DRIVE = ["start", "x", "y"]


@pytest.mark.parametrize(("answer", "goes_on"), [("y\n", True), ("\n", False), ("no\n", False)])
def test_a_doubted_number_is_asked_about(
    answer: str, goes_on: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO(answer))
    assert AtTheTerminal(ExactDrives()).goes_on("0.45 m is 10 times the 0.045 m") is goes_on
    assert "0.45 m is 10 times the 0.045 m" in capsys.readouterr().err


def test_a_person_is_led_through_all_drives(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    drives = ExactDrives()
    monkeypatch.setattr("sys.stdin", Answers(drives, DRIVE * 6))
    found, confirmation = guided(tmp_path, drives).run()
    assert found.geometry == pytest.approx(TRUE, rel=1e-3)
    assert confirmation.complaint == ""
    shown = capsys.readouterr().out
    assert "Calibrating robot_0: 3 drives, then 3 check drives." in shown
    assert "a square of 1 m, counter-clockwise" in shown
    assert "Check drives:" in shown


def test_standard_output_is_for_the_json_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    drives = ExactDrives()
    monkeypatch.setattr("sys.stdin", Answers(drives, DRIVE * 6))
    guided(tmp_path, drives, is_quiet=True).run()
    shown = capsys.readouterr()
    assert shown.out == ""
    assert "Enter to start the drive" in shown.err
    assert "a square of 1 m, counter-clockwise" in shown.err


def test_unwritable_state_file_prevents_the_first_drive(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drives = ExactDrives()
    monkeypatch.setattr("sys.stdin", Answers(drives, DRIVE * 6))
    calibration = guided(tmp_path / "folder", drives)
    (tmp_path / "folder").write_text("no folder")
    with pytest.raises(HostlinkError, match=r"state\.json"):
        calibration.run()
    assert drives.robot_driven.odometry == Pose(0.3, -0.2, 1.0)


def test_impossible_measurement_is_asked_again_and_a_broken_off_drive_is_repeated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    drives = ExactDrives()
    drives.broken = 1
    first = ["start", "start", "long\n", "30.1 m\n", "0\n", "\n", "x", "y"]
    slipped = ["start", "900 cm\n", "0\n", "d\n", "start", "x", "y"]
    monkeypatch.setattr("sys.stdin", Answers(drives, [*first, *slipped, *DRIVE * 4]))
    found, _ = guided(tmp_path, drives).run()
    assert found.geometry == pytest.approx(TRUE, rel=1e-3)
    complaints = capsys.readouterr().err
    assert "its odometry jumped" in complaints
    assert "'long' is not a length" in complaints
    assert "30.10 m, the odometry" in complaints


def test_enter_alone_starts_a_drive(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Refuse a word instead of Enter, because the person meant something else."""
    drives = ExactDrives()
    monkeypatch.setattr("sys.stdin", Answers(drives, ["no\n", "quit\n"]))
    with pytest.raises(HostlinkError, match="standard input is closed"):
        guided(tmp_path, drives).run()
    assert drives.robot_driven.odometry == Pose(0.3, -0.2, 1.0)
    assert capsys.readouterr().err.count("press Enter alone to start it") == 2


@pytest.mark.slow
def test_numbers_that_contradict_each_other_are_entered_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    drives = ExactDrives()
    exchanged = ["start", "-25 cm\n", "-50\n", "cm\n"]
    again = ["2\n", *DRIVE, "3\n", *DRIVE]
    monkeypatch.setattr(
        "sys.stdin", Answers(drives, [*DRIVE, *exchanged, "start", "30 cm\n", "40 cm\n", *again, *DRIVE * 3])
    )
    found, _ = guided(tmp_path, drives).run()
    assert found.geometry == pytest.approx(TRUE, rel=1e-3)
    assert "a square of 1 m, clockwise: -25.0 cm forward, -50.0 cm to the left" in capsys.readouterr().out


@pytest.mark.parametrize(("answer", "is_kept"), [("y\n", True), ("\n", False)])
def test_squares_that_end_at_their_start_are_doubted(
    answer: str, is_kept: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    drives = ExactDrives()
    tiny = ["start", "x in a wrong unit", "y in a wrong unit"]
    monkeypatch.setattr("sys.stdin", Answers(drives, [*DRIVE, *tiny, *tiny, answer]))
    with pytest.raises(HostlinkError, match="standard input is closed" if is_kept else "no result is used"):
        guided(tmp_path, drives).run()
    assert "Were metres entered as centimetres?" in capsys.readouterr().err


def test_interrupted_calibration_continues_with_the_next_drive(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    drives = ExactDrives()
    monkeypatch.setattr("sys.stdin", Answers(drives, [*DRIVE, "start"]))
    with pytest.raises(HostlinkError, match="standard input is closed"):
        guided(tmp_path, drives).run()
    monkeypatch.setattr("sys.stdin", Answers(drives, DRIVE * 5))
    found, _ = guided(tmp_path, drives).run()
    assert found.geometry == pytest.approx(TRUE, rel=1e-3)
    assert "1 are done" in capsys.readouterr().out


# -- what the daemon sends --------------------------------------------------------------------------------------------


def test_poses_of_both_kinds_of_odometry_are_read() -> None:
    assert pose_of({"x": 1.0, "y": 2.0, "theta": 0.5}) == Pose(1.0, 2.0, 0.5)
    pose = {"position": {"x": 1.0, "y": 2.0, "z": 0.0}, "orientation": {"x": 0.0, "y": 0.0, "z": 1.0, "w": 0.0}}
    assert pose_of({"pose": {"pose": pose}}) == pytest.approx((1.0, 2.0, 3.14159265))


@pytest.mark.parametrize(
    ("text", "numbers"),
    [("[0.0448, 0.0453]", [0.0448, 0.0453]), ("0.21", [0.21]), ("[]", []), ('"wide"', []), ("-1", []), ("nan", [])],
)
def test_parameters_are_numbers_or_nothing(text: str, numbers: list[float]) -> None:
    assert numbers_of(text) == numbers


@pytest.mark.parametrize("kinematics", ["mecanum", "ackermann", "omni3", "skid_steer", "planar"])
def test_robot_with_another_drive_than_two_wheels_is_refused(kinematics: str) -> None:
    with pytest.raises(HostlinkError, match=f"r has a drive of the kind {kinematics}; calibration measures"):
        require_two_wheels("r", kinematics)


@pytest.mark.parametrize("kinematics", ["", "differential"])
def test_robot_with_two_wheels_is_calibrated(kinematics: str) -> None:
    require_two_wheels("r", kinematics)
