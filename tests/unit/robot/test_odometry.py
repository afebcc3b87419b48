"""OdometryView: poses that come early, late, merged, after a reset, or broken."""

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.messages.catalog import Catalog
from hostlink.robot.kinematics import DifferentialDrive, Pose
from hostlink.robot.odometry import OdometryView, Twist

DRIVE = DifferentialDrive()
PERIOD_S = 0.1


def arc(linear_m_s: float, angular_rad_s: float, count: int, start: Pose | None = None) -> list[Pose]:
    """The poses of a robot that drives at this velocity, one every PERIOD_S."""
    left_m_s, right_m_s = DRIVE.wheel_speeds(linear_m_s, angular_rad_s)
    poses = [start or Pose(1.0, 2.0, 3.0)]
    while len(poses) < count:
        poses.append(DRIVE.integrate(poses[-1], left_m_s * PERIOD_S, right_m_s * PERIOD_S))
    return poses


def view_of(poses: list[Pose], times_s: list[float] | None = None) -> OdometryView:
    view = OdometryView()
    for number, pose in enumerate(poses):
        view.update(pose, now_s=number * PERIOD_S if times_s is None else times_s[number], wall_ns=number)
    return view


def seen(view: OdometryView, now_s: float = 1.0) -> dict[str, Any]:
    snapshot = view.snapshot(now_s)
    assert snapshot is not None
    return snapshot


def twist_of(view: OdometryView) -> Twist:
    return Twist(**seen(view)["twist"])


def test_nothing_is_known_before_the_first_pose() -> None:
    assert OdometryView().snapshot(1.0) is None


def test_one_pose_is_no_motion() -> None:
    view = OdometryView()
    view.update(Pose(1.0, 2.0, 0.5), now_s=4.0, wall_ns=17)
    assert view.snapshot(4.25) == {
        "pose": {"x_m": 1.0, "y_m": 2.0, "theta_rad": 0.5},
        "twist": {"linear_m_s": 0.0, "angular_rad_s": 0.0},
        "stamp_ns": 17,
        "age_s": 0.25,
        "rate_hz": 0.0,
        "count": 1,
    }


@given(st.floats(-0.5, 0.5), st.floats(-12, 12))
def test_the_twist_of_an_arc_is_exact_however_tight(linear_m_s: float, angular_rad_s: float) -> None:
    twist = twist_of(view_of(arc(linear_m_s, angular_rad_s, 12)))
    assert twist == pytest.approx(Twist(linear_m_s, angular_rad_s), abs=1e-9)


def test_theta_may_cross_pi() -> None:
    view = view_of(arc(0.2, 1.0, 5, Pose(0.5, 0.5, math.pi - 0.2)))
    assert seen(view)["pose"]["theta_rad"] < 0
    assert twist_of(view) == pytest.approx(Twist(0.2, 1.0))


def test_the_twist_is_of_the_window_only() -> None:
    fast = arc(0.3, 0.0, 20)
    stands = [fast[-1]] * 6
    assert twist_of(view_of(fast + stands[:2])) == pytest.approx(Twist(0.15, 0.0))
    assert twist_of(view_of(fast + stands)) == pytest.approx(Twist(0.0, 0.0))


def test_poses_of_one_read_count_once_for_the_motion_and_all_for_the_rate() -> None:
    times_s = [0.1, 0.1, 0.3, 0.3, 0.5, 0.5]
    view = view_of(arc(0.2, 0.5, 6), times_s)
    assert twist_of(view) == pytest.approx(Twist(0.2, 0.5))
    assert seen(view)["rate_hz"] == pytest.approx(10.0)
    assert seen(view)["count"] == 6


def test_a_late_read_cut_in_two_is_no_leap() -> None:
    poses = arc(0.3, 0.0, 10)
    view = view_of(poses, [0.0, 0.1, 0.2, 0.3, 0.9, 0.9, 0.9, 0.9, 0.9, 0.901])
    assert twist_of(view).linear_m_s == pytest.approx(0.3, rel=0.01)


def test_two_poses_that_come_together_say_nothing() -> None:
    view = view_of(arc(0.3, 0.0, 2), [0.0, 0.001])
    assert twist_of(view) == Twist()
    assert seen(view)["rate_hz"] == 0


@pytest.mark.parametrize(
    "after",
    [
        Pose(0.0, 0.0, 0.0),
        Pose(0.01, 0.0, 0.02),  # the robot drove on after its reset
        Pose(2.5, 0.0, 0.0),  # another place altogether
    ],
)
def test_a_jump_begins_anew(after: Pose) -> None:
    before = arc(0.3, 0.0, 10, Pose(1.0, 0.0, 0.0))
    view = view_of([*before, after])
    assert twist_of(view) == Twist()
    assert seen(view)["pose"] == after._asdict()


def test_a_reset_close_to_the_origin_begins_anew() -> None:
    view = view_of([*arc(0.3, 0.0, 3, Pose(0.01, 0.0, 0.0)), Pose()])
    assert twist_of(view) == Twist()


def test_a_reset_of_the_heading_begins_anew() -> None:
    assert twist_of(view_of([Pose(0.01, 0.0, 2.0), Pose(0.01, 0.0, 2.0), Pose(0.01, 0.0, 0.01)])) == Twist()


def test_a_turn_that_no_robot_makes_begins_anew() -> None:
    assert twist_of(view_of([Pose(3.0, 0.0, 0.0), Pose(3.0, 0.0, 0.0), Pose(3.0, 0.0, 3.0)])) == Twist()


def test_driving_through_the_origin_is_no_reset() -> None:
    view = view_of(arc(0.3, 0.0, 8, Pose(-0.12, 0.0, 0.0)))
    assert twist_of(view) == pytest.approx(Twist(0.3, 0.0))


def test_after_a_long_silence_the_motion_begins_anew() -> None:
    poses = arc(0.3, 0.0, 4)
    view = view_of(poses, [0.0, 0.1, 0.2, 5.0])
    assert twist_of(view) == Twist()


def test_a_slow_robot_has_a_twist_too() -> None:
    poses = arc(0.3, 0.0, 3)
    view = view_of(poses, [0.0, 1.0, 2.0])
    assert twist_of(view) == pytest.approx(Twist(0.03, 0.0))
    assert seen(view, 2.5)["age_s"] == 0.5
    assert seen(view)["rate_hz"] == 1.0


@pytest.mark.parametrize("broken", [Pose(math.nan, 0, 0), Pose(0, math.inf, 0), Pose(0, 0, math.nan)])
def test_a_pose_of_no_numbers_is_not_counted(broken: Pose) -> None:
    view = view_of(arc(0.3, 0.0, 3))
    before = view.snapshot(1.0)
    view.update(broken, now_s=0.5, wall_ns=99)
    assert view.snapshot(1.0) == before


def test_a_pose2d_is_wrapped() -> None:
    view = OdometryView()
    view.see({"x": 1.0, "y": 2.0, "theta": 7.0}, now_s=0.0, wall_ns=5)
    assert seen(view)["pose"]["theta_rad"] == pytest.approx(7.0 - math.tau)
    assert seen(view)["stamp_ns"] == 5


@given(st.floats(), st.floats(), st.floats())
def test_any_pose2d_is_survived(x: float, y: float, theta: float) -> None:
    view = view_of(arc(0.3, 0.0, 3))
    view.see({"x": x, "y": y, "theta": theta}, now_s=0.4, wall_ns=0)
    assert all(map(math.isfinite, seen(view)["pose"].values()))


def odometry(yaw_rad: float, twist: Twist, length: float = 1.0) -> dict[str, Any]:
    type_ = Catalog().message("nav_msgs/Odometry")
    assert type_ is not None
    message = type_.decode(type_.encode({}))
    pose: Any = message["pose"]
    pose["pose"]["position"].update(x=1.0, y=2.0)
    pose["pose"]["orientation"].update(w=length * math.cos(yaw_rad / 2), z=length * math.sin(yaw_rad / 2))
    moving: Any = message["twist"]
    moving["twist"]["linear"]["x"], moving["twist"]["angular"]["z"] = twist
    return message


@pytest.mark.parametrize("length", [1.0, 0.5])
@pytest.mark.parametrize("yaw_rad", [0.0, 1.0, -3.0, math.pi])
def test_an_odometry_tells_pose_and_twist(yaw_rad: float, length: float) -> None:
    view = OdometryView()
    view.see(odometry(yaw_rad, Twist(0.2, -0.4), length), now_s=0.0, wall_ns=0)
    assert Pose(**seen(view)["pose"]) == pytest.approx(Pose(1.0, 2.0, yaw_rad))
    assert twist_of(view) == Twist(0.2, -0.4)


def test_a_twist_of_no_numbers_is_estimated_from_the_poses() -> None:
    view = OdometryView()
    view.see(odometry(0.0, Twist(math.nan, 0.0)), now_s=0.0, wall_ns=0)
    assert twist_of(view) == Twist()


@given(st.lists(st.floats(), min_size=4, max_size=4))
def test_any_orientation_is_survived(wxyz: list[float]) -> None:
    message = odometry(0.0, Twist())
    message["pose"]["pose"]["orientation"] = dict(zip("wxyz", wxyz, strict=True))
    view = OdometryView()
    view.see(message, now_s=0.0, wall_ns=0)
    assert view.count == 1 or view.snapshot(0.0) is None
