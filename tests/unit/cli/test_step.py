"""`hostlink step` without a robot: its stages, its report, its picture, its sources."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hostlink.cli.files import check_folder, check_picture
from hostlink.cli.step import (
    Stage,
    Wheel,
    describe_way,
    draw_picture,
    find_topic,
    make_stage,
    notes_of,
    record_views,
    rising_stages,
    step_lines,
)
from hostlink.client import RobotState
from hostlink.core.robot.kinematics import DifferentialDrive
from hostlink.core.robot.velocity import PlanarVelocity
from hostlink.errors import ConfigError
from hostlink.workbench.step_response import Record, step_figures

B_M = 0.21
GAINS = "geometry_msgs/Vector3"


def record(*, pwm: bool = True, rising: bool = False) -> Record:
    t_s = np.arange(-5, 60) / 10
    wanted = np.where(t_s >= 0, 160.0, 0.0) + (t_s if rising else 0.0)
    measured = 160 * (1 - np.exp(-np.maximum(t_s, 0.0) / 0.4))
    return Record("ticks/s", t_s, wanted, measured, wanted * 14 if pwm else None)


@pytest.mark.parametrize("speed_m_s", [0.2, -0.15])
@pytest.mark.parametrize(("wheel", "turning"), [(Wheel.LEFT, (1, 0)), (Wheel.RIGHT, (0, 1)), (None, (1, 1))])
def test_a_stage_turns_the_wheels_that_are_meant(
    wheel: Wheel | None, turning: tuple[int, int], speed_m_s: float
) -> None:
    stage = make_stage(speed_m_s, 3.0, wheel, B_M)
    speeds = DifferentialDrive(wheel_separation_m=B_M).wheel_speeds(
        PlanarVelocity(stage.linear_m_s, yaw_rad_s=stage.angular_rad_s)
    )
    assert speeds == pytest.approx([speed_m_s * each for each in turning])


def test_the_steps_of_tuning_rise_to_the_speed() -> None:
    speeds = [stage.speed_m_s for stage in rising_stages(0.2, None, B_M)]
    assert speeds == sorted(speeds)
    assert (speeds[0], speeds[-1]) == pytest.approx((0.08, 0.2))
    assert [stage.speed_m_s for stage in rising_stages(-0.2, Wheel.LEFT, B_M)] == pytest.approx([-s for s in speeds])


@pytest.mark.parametrize(
    ("speed_m_s", "wheel", "way"),
    [
        (0.2, None, "1.20 m straight forwards at up to 0.20 m/s for 6.0 s; keep that way and half a metre more free"),
        (-0.1, None, "robot_0 drives 0.60 m straight backwards at up to 0.10 m/s"),
        (0.2, Wheel.LEFT, "left wheel rolls 1.20 m forwards round the right one"),
        (0.2, Wheel.RIGHT, "at up to 0.20 m/s for 6.0 s; keep a circle of 0.9 m free"),
    ],
)  # fmt: skip
def test_the_way_is_described(speed_m_s: float, wheel: Wheel | None, way: str) -> None:
    assert way in describe_way("robot_0", [make_stage(speed_m_s, 6.0, wheel, B_M)], wheel, B_M)


def test_the_report_has_a_column_for_each_wheel() -> None:
    records = {"left": record(), "right": record(pwm=False)}
    figures = {side: step_figures(each) for side, each in records.items()}
    lines = step_lines(figures, {side: each.unit for side, each in records.items()})
    assert lines[1].split() == ["left", "right"]
    assert any(line.split() == ["overshoot", "0.0", "%", "0.0", "%"] for line in lines)
    assert lines[-1].split() == ["full", "PWM", "0", "%", "of", "the", "time", "unknown"]
    view = record_views(records, figures)["right"]
    assert set(view["figures"]) == set(asdict(figures["right"]))
    assert (len(view["samples"]["t_s"]), view["samples"]["pwm"]) == (65, None)


def test_a_speed_that_is_never_reached_is_named_so() -> None:
    slow = record()
    slow.measured[:] = 0.0
    assert any("not reached" in line for line in step_lines({"left": step_figures(slow)}, {"left": "ticks/s"}))


def test_limits_and_a_drive_that_was_too_short_are_noted() -> None:
    stage = Stage(0.2, 0.2, 0.0, 6.0)
    assert notes_of(stage, (0.2, 0.0), {"left": record()}) == []
    assert "rad/s to 0.100 m/s" in notes_of(stage, (0.1, 0.0), {"left": record()})[0]
    assert "more --seconds" in notes_of(stage, (0.2, 0.0), {"left": record(rising=True)})[0]


@pytest.mark.parametrize("suffix", [".svg", *(pytest.param(each, marks=pytest.mark.long) for each in (".png", ".pdf"))])
def test_a_picture_is_drawn(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"step{suffix}"
    check_picture("--picture", path, needs="--picture", extra="pictures")
    draw_picture(path, "robot_0: step", {"left": record(), "right": record(pwm=False)})
    assert path.stat().st_size > 5000


def test_a_picture_without_pwm_has_one_row(tmp_path: Path) -> None:
    draw_picture(tmp_path / "one.svg", "robot_0: step", {"robot": record(pwm=False)})
    draw_picture(tmp_path / "two.svg", "robot_0: step", {"robot": record()})
    axes = [(tmp_path / name).read_text().count('id="axes_') for name in ("one.svg", "two.svg")]
    assert axes == [1, 2]


def test_a_picture_that_cannot_be_is_refused_before_the_robot_moves(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(ConfigError, match=r"must end in one of \.pdf, \.png, \.svg"):
        check_picture("--picture", tmp_path / "step.gif", needs="--picture", extra="pictures")
    with pytest.raises(ConfigError, match=r"the folder .* cannot be written"):
        check_folder("--picture", tmp_path / "nowhere" / "step.png")
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    with pytest.raises(
        ConfigError, match=r"needs matplotlib, of the extra 'pictures': run  .* -m pip install 'matplotlib<"
    ):
        check_picture("--picture", tmp_path / "step.png", needs="--picture", extra="pictures")


def topics(*names: str, link: int = 1) -> dict[str, Any]:
    return {"number": link, "topics": [{"name": name, "type": GAINS} for name in names]}


def test_own_topic_of_a_robot_takes_precedence() -> None:
    state = RobotState(
        name="robot_0",
        connected=True,
        link=1,
        velocity_topic="/robot_0/velocity_commands",
        odometry_topic="/robot_0/odometry",
        owner=None,
        velocity={"linear_m_s": 0.0, "angular_rad_s": 0.0},
        odometry=None,
    )
    other, own = "/arm/pid_tune_l", "/robot_0/pid_tune_l"
    assert find_topic(state, [topics(other, own)], "pid_tune_l", GAINS) == own
    assert find_topic(state, [topics(other)], "pid_tune_l", GAINS) == other
    assert find_topic(state, [topics(own, link=2)], "pid_tune_l", GAINS) is None
    assert find_topic(state, [topics(own)], "pid_tune_l", "geometry_msgs/Twist") is None
