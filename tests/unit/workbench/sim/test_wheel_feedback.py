"""Counts of the firmware's encoders, integrated on the host, against the pose that the firmware itself integrates."""

import math
import struct

import numpy as np
import pytest
from numpy.typing import NDArray

from hostlink.client.course import CourseFollower, square
from hostlink.core.robot.feedback import Feedback, FeedbackSettings
from hostlink.core.robot.kinematics import DifferentialDrive, Pose
from hostlink.core.robot.wheel_feedback import WheelSettings
from hostlink.workbench.sim.firmware_world import COMMAND_S, FirmwareWorld, RobotKind, Trace

EDGES_PER_TURN = 460.8  # two edges a tick
SAMPLE_S = 0.001
STILL_MS = 100
SETTINGS = WheelSettings(topics=("l", "r"), ticks_per_turn=EDGES_PER_TURN, wheel_radius_m=0.045)


def signed_counts(trace: Trace, side: str) -> NDArray[np.int64]:
    """Counts of the encoder. It has one channel, so the firmware gives it the direction of its set-point."""
    edges = np.diff(trace[f"{side}_edges"], prepend=trace[f"{side}_edges"][0])
    direction = 1.0
    signed = np.empty_like(edges)
    for index, set_point in enumerate(trace[f"{side}_set_ticks_s"]):
        direction = math.copysign(1.0, set_point) if set_point else direction
        signed[index] = direction * edges[index]
    return np.cumsum(signed).astype(np.int64)


@pytest.mark.slow
def test_counts_of_ten_squares_are_the_pose_of_the_firmware_to_the_millimetre() -> None:
    """At ten messages a second the arcs between them are longer than those of the firmware's 30: two millimetres."""
    robot = FirmwareWorld(kind=RobotKind.NIMBLE)
    robot.connect()
    robot.forget()
    began, shown, now_s = robot.world.odometry, Pose(), 0.0
    follower = CourseFollower(square(0.5, 1) * 10)
    while not follower.is_done:
        robot.drive(*follower.update(shown, now_s), COMMAND_S, sample_s=SAMPLE_S)
        shown, now_s = robot.world.odometry, now_s + COMMAND_S
    trace = robot.trace
    assert began == Pose()
    assert robot.world.rolled_m > 19
    left, right = signed_counts(trace, "left"), signed_counts(trace, "right")
    own = np.stack([trace["odometry_x_m"], trace["odometry_y_m"], trace["odometry_theta_rad"]], axis=1)
    turns = np.flatnonzero(np.any(own[1:] != own[:-1], axis=1)) + 1  # of the firmware's loop
    for indices, most_m in ((turns, 0.001), (np.arange(0, len(trace), 100), 0.002)):
        feedback = Feedback(
            [(name, "std_msgs/Int16") for name in "lr"], FeedbackSettings(encoders=SETTINGS), DifferentialDrive()
        )
        worst_m = 0.0
        for index in indices:
            found = None
            for name, counts in (("l", left), ("r", right)):
                raw = struct.pack("<H", int(counts[index]) & 0xFFFF)  # as an Int16 that wraps around
                found = feedback.read(name, raw, now_s=index * SAMPLE_S)
            past = max(0, index - STILL_MS)
            is_still = left[index] == left[past] and right[index] == right[past]  # no count is on its way to the pose
            if found is not None and found.pose is not None and (is_still or indices is turns):
                worst_m = max(worst_m, math.dist(found.pose[:2], own[index][:2]))
        assert found is not None
        assert found.pose is not None
        assert worst_m < most_m
        assert found.pose.theta_rad == pytest.approx(robot.world.odometry.theta_rad, abs=1e-3)
        assert feedback.restarts == 0
