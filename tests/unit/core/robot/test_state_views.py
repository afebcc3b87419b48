"""The JSON of a robot's state: each value of the record, and null for what is not known."""

import dataclasses

import msgspec

from hostlink.core.robot.standstill import Standstill, StandstillState
from hostlink.core.robot.state import RobotState
from hostlink.core.robot.state_views import odometry_view, robot_view, rounded, stopped_view, velocity_view
from hostlink.core.robot.velocity import PlanarVelocity
from hostlink.core.robot.views import RobotView, StoppedRobotView
from tests.unit.core.robot.test_state import EVERYTHING

UNKNOWN = RobotState(name="robot_1", velocity_topic="/robot_1/cmd_vel")


def test_view_of_a_state_has_each_field_of_its_type() -> None:
    view = robot_view(EVERYTHING)
    assert view.keys() == RobotView.__annotations__.keys()
    assert msgspec.convert(msgspec.json.decode(msgspec.json.encode(view)), RobotView) == view
    assert (view["connected"], view["locked"], view["played"]) == (True, True, True)
    assert (view["also_at"], view["device_errors"]) == (["bench"], ["battery_low"])
    assert view["velocity"] == {"linear_m_s": 0.1, "linear_y_m_s": 0.2, "angular_rad_s": 0.3}
    assert view["odometry"] is not None
    assert view["odometry"]["pose"] == {"x_m": 1.0, "y_m": 2.0, "theta_rad": 0.5}


def test_what_is_not_known_of_a_robot_is_null() -> None:
    view = robot_view(UNKNOWN)
    assert (view["connected"], view["locked"], view["played"]) == (False, False, False)
    assert (view["odometry"], view["link"], view["battery_v"]) == (None, None, None)


def test_odometry_without_pose_and_motion_has_null() -> None:
    known = EVERYTHING.odometry
    assert known is not None
    view = odometry_view(dataclasses.replace(known, pose=None, twist=None, age_s=0.12345678))
    assert (view["pose"], view["twist"], view["age_s"]) == (None, None, 0.123457)


def test_view_after_a_stop_has_what_was_measured() -> None:
    measured = Standstill(StandstillState.STOPPED, speed_m_s=0.00012, turn_rad_s=None, after_s=0.2345)
    view = stopped_view(EVERYTHING, measured)
    assert view["standstill"] == {
        "state": "stopped",
        "speed_m_s": 0.0001,
        "turn_rad_s": None,
        "after_s": 0.234,
        "reason": measured.reason,
    }
    assert view.keys() == {*RobotView.__annotations__, *StoppedRobotView.__annotations__}


def test_numbers_are_rounded_if_they_are_known() -> None:
    assert (rounded(1.23456, 2), rounded(None, 2)) == (1.23, None)
    assert velocity_view(PlanarVelocity()) == {"linear_m_s": 0.0, "linear_y_m_s": 0.0, "angular_rad_s": 0.0}
