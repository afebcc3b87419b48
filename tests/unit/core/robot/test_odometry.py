"""OdometryEstimator: poses that come early, late, merged, after a reset, or broken."""

import dataclasses
import itertools
import math

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from hostlink.core.robot.kinematics import DifferentialDrive, Pose, wrap_angle
from hostlink.core.robot.odometry import (
    CLOSEST_S,
    LONGEST_S,
    SHAKE_M,
    SHAKE_RAD,
    WINDOW_S,
    OdometryEstimator,
    OdometrySnapshot,
    SendTimes,
    aged_rate_hz,
)
from hostlink.core.robot.velocity import PlanarVelocity

DRIVE = DifferentialDrive()
PERIOD_S = 0.1


def arc(linear_m_s: float, angular_rad_s: float, count: int, start: Pose | None = None) -> list[Pose]:
    """The poses of a robot that drives at this velocity, one every PERIOD_S."""
    left_m_s, right_m_s = DRIVE.wheel_speeds(PlanarVelocity(linear_m_s, 0.0, angular_rad_s))
    poses = [start or Pose(1.0, 2.0, 3.0)]
    while len(poses) < count:
        poses.append(DRIVE.integrate(poses[-1], (left_m_s * PERIOD_S, right_m_s * PERIOD_S)))
    return poses


def view_of(poses: list[Pose], times_s: list[float] | None = None) -> OdometryEstimator:
    view = OdometryEstimator()
    for number, pose in enumerate(poses):
        view.update(pose, now_s=number * PERIOD_S if times_s is None else times_s[number], wall_ns=number)
    return view


def observed(view: OdometryEstimator, now_s: float = 1.0) -> OdometrySnapshot:
    snapshot = view.snapshot(now_s)
    assert snapshot is not None
    return snapshot


def shown(view: OdometryEstimator) -> Pose:
    return observed(view).pose


def twist_of(view: OdometryEstimator) -> PlanarVelocity:
    return observed(view).twist


def test_estimator_before_the_first_pose_has_no_snapshot() -> None:
    assert OdometryEstimator().snapshot(1.0) is None


def test_estimator_with_one_pose_has_no_motion() -> None:
    view = OdometryEstimator()
    view.update(Pose(1.0, 2.0, 0.5), now_s=4.0, wall_ns=17)
    assert view.snapshot(4.25) == OdometrySnapshot(
        pose=Pose(1.0, 2.0, 0.5),
        twist=PlanarVelocity(0.0, yaw_rad_s=0.0),
        stamp_ns=17,
        age_s=0.25,
        rate_hz=0.0,
        count=1,
        restarts=0,
        ignored=0,
    )


@given(st.floats(-0.5, 0.5), st.floats(-12, 12))
def test_the_twist_of_an_arc_is_exact_however_tight(linear_m_s: float, angular_rad_s: float) -> None:
    twist = twist_of(view_of(arc(linear_m_s, angular_rad_s, 12)))
    assert twist == pytest.approx(PlanarVelocity(linear_m_s, yaw_rad_s=angular_rad_s), abs=1e-9)


def test_theta_may_cross_pi() -> None:
    view = view_of(arc(0.2, 1.0, 5, Pose(0.5, 0.5, math.pi - 0.2)))
    assert observed(view).pose.theta_rad < 0
    assert twist_of(view) == pytest.approx(PlanarVelocity(0.2, yaw_rad_s=1.0))


def test_the_twist_is_of_the_window_only() -> None:
    fast = arc(0.3, 0.0, 20)
    stands = [fast[-1]] * 6
    assert twist_of(view_of(fast + stands[:2])) == pytest.approx(PlanarVelocity(0.15, yaw_rad_s=0.0))
    assert twist_of(view_of(fast + stands)) == pytest.approx(PlanarVelocity(0.0, yaw_rad_s=0.0))


def test_poses_of_one_read_count_once_for_the_motion_and_all_for_the_rate() -> None:
    times_s = [0.1, 0.1, 0.3, 0.3, 0.5, 0.5]
    view = view_of(arc(0.2, 0.5, 6), times_s)
    assert twist_of(view) == pytest.approx(PlanarVelocity(0.2, yaw_rad_s=0.5))
    assert observed(view).rate_hz == pytest.approx(10.0)
    assert observed(view).count == 6


def curve(twist: PlanarVelocity, count: int) -> list[Pose]:
    """The poses of a robot that can move sideways, at a constant velocity in its own frame."""
    poses = [Pose(0.4, -0.2, 0.5)]
    for _ in range(count - 1):
        turned_rad, before = twist.yaw_rad_s * 0.1, poses[-1]
        for _ in range(1000):  # so that no formula of the estimator is repeated here
            cos, sin = math.cos(before.theta_rad), math.sin(before.theta_rad)
            before = Pose(
                before.x_m + (twist.x_m_s * cos - twist.y_m_s * sin) * 1e-4,
                before.y_m + (twist.x_m_s * sin + twist.y_m_s * cos) * 1e-4,
                before.theta_rad + turned_rad / 1000,
            )
        poses.append(Pose(before.x_m, before.y_m, wrap_angle(before.theta_rad)))
    return poses


@pytest.mark.parametrize("twist", [PlanarVelocity(0.0, 0.3), PlanarVelocity(0.2, -0.3), PlanarVelocity(0.2, 0.1, 1.5)])
def test_twist_of_poses_has_the_sideways_motion_unless_the_drive_is_differential(twist: PlanarVelocity) -> None:
    poses = curve(twist, 8)
    assert twist_of(view_of(poses)) == pytest.approx(twist, abs=1e-3)
    differential = OdometryEstimator(is_differential=True).anew()
    for number, pose in enumerate(poses):
        differential.update(pose, now_s=number * 0.1, wall_ns=number)
    assert twist_of(differential) == pytest.approx(twist._replace(y_m_s=0.0), abs=1e-3)


def test_late_read_in_two_pieces_does_not_leap() -> None:
    poses = arc(0.3, 0.0, 10)
    view = view_of(poses, [0.0, 0.1, 0.2, 0.3, 0.9, 0.9, 0.9, 0.9, 0.9, 0.901])
    assert twist_of(view).x_m_s == pytest.approx(0.3, rel=0.01)


def test_two_poses_that_come_together_change_nothing() -> None:
    view = view_of(arc(0.3, 0.0, 2), [0.0, 0.001])
    assert twist_of(view) == PlanarVelocity()
    assert observed(view).rate_hz == 0


@pytest.mark.parametrize(
    "after",
    [
        Pose(0.0, 0.0, 0.0),
        Pose(0.01, 0.0, 0.02),  # the robot drove on after its reset
    ],
)
def test_a_restart_begins_anew_where_the_robot_was(after: Pose) -> None:
    before = arc(0.3, 0.0, 10, Pose(1.0, 0.0, 0.0))
    view = view_of([*before, after])
    assert twist_of(view) == PlanarVelocity()
    assert shown(view) == pytest.approx(before[-1])
    assert observed(view).restarts == 1


def test_a_reset_close_to_the_origin_begins_anew() -> None:
    view = view_of([*arc(0.3, 0.0, 3, Pose(0.01, 0.0, 0.0)), Pose()])
    assert twist_of(view) == PlanarVelocity()


def test_a_reset_of_the_heading_begins_anew() -> None:
    assert twist_of(view_of([Pose(0.01, 0.0, 2.0), Pose(0.01, 0.0, 2.0), Pose(0.01, 0.0, 0.01)])) == PlanarVelocity()


def test_a_turn_that_no_robot_makes_begins_anew() -> None:
    """A second pose there is believed: the device's odometry was set."""
    view = view_of([Pose(3.0, 0.0, 0.0), Pose(3.0, 0.0, 0.0), Pose(3.0, 0.0, 3.0), Pose(3.0, 0.0, 3.0)])
    assert twist_of(view) == PlanarVelocity()
    assert (observed(view).restarts, observed(view).ignored) == (1, 1)


def test_driving_through_the_origin_does_not_count_as_a_reset() -> None:
    view = view_of(arc(0.3, 0.0, 8, Pose(-0.12, 0.0, 0.0)))
    assert twist_of(view) == pytest.approx(PlanarVelocity(0.3, yaw_rad_s=0.0))


def test_after_a_long_silence_the_motion_begins_anew() -> None:
    poses = arc(0.3, 0.0, 4)
    view = view_of(poses, [0.0, 0.1, 0.2, 5.0])
    assert twist_of(view) == PlanarVelocity()


def test_a_slow_robot_has_a_twist_too() -> None:
    poses = arc(0.3, 0.0, 3)
    view = view_of(poses, [0.0, 1.0, 2.0])
    assert twist_of(view) == pytest.approx(PlanarVelocity(0.03, yaw_rad_s=0.0))
    assert observed(view, 2.5).age_s == 0.5
    assert observed(view).rate_hz == 1.0


@pytest.mark.parametrize("broken", [Pose(math.nan, 0, 0), Pose(0, math.inf, 0), Pose(0, 0, math.nan)])
def test_a_pose_of_no_numbers_is_not_counted(broken: Pose) -> None:
    view = view_of(arc(0.3, 0.0, 3))
    before = observed(view)
    view.update(broken, now_s=0.5, wall_ns=99)
    assert observed(view) == dataclasses.replace(before, ignored=1)


# -- restarts ---------------------------------------------------------------------------------------------------------

RUN = arc(0.3, 0.7, 20)  # begins at (1, 2, 3)
AGAIN = arc(0.3, 0.7, 20, Pose())  # what a device that restarted tells of the same motion


def after_a_restart(*, continues: bool) -> OdometryEstimator:
    view = OdometryEstimator(continues=continues)
    for number, pose in enumerate(RUN + AGAIN):
        view.update(pose, now_s=number * PERIOD_S, wall_ns=number)
    return view


def test_odometry_continues_over_a_restart_of_the_device() -> None:
    view = after_a_restart(continues=True)
    assert shown(view) == pytest.approx(arc(0.3, 0.7, 20, RUN[-1])[-1])
    assert twist_of(view) == pytest.approx(PlanarVelocity(0.3, yaw_rad_s=0.7))
    assert observed(view).restarts == 1


def test_odometry_restarts_with_the_device_if_configured() -> None:
    view = after_a_restart(continues=False)
    assert shown(view) == AGAIN[-1]
    assert observed(view).restarts == 1


def test_odometry_that_was_withdrawn_begins_with_the_next_pose() -> None:
    view = after_a_restart(continues=True)
    view.withdraw()
    assert view.snapshot(4.0) is None
    view.update(Pose(7.0, 8.0, 0.5), now_s=4.0, wall_ns=4)
    found = observed(view, 4.0)
    assert (found.pose, found.twist, found.restarts) == (Pose(7.0, 8.0, 0.5), PlanarVelocity(), 1)


@pytest.mark.parametrize("continues", [True, False])
def test_a_requested_reset_begins_at_the_origin(continues: bool) -> None:
    view = after_a_restart(continues=continues)
    view.expect_reset(4.0)
    view.update(AGAIN[-1], now_s=4.0, wall_ns=40)  # on its way before the reset was
    view.update(Pose(0.01, 0.0, 0.0), now_s=4.1, wall_ns=41)
    assert shown(view) == Pose(0.01, 0.0, 0.0)
    assert observed(view).restarts == 1
    view.update(Pose(0.04, 0.0, 0.0), now_s=4.2, wall_ns=42)
    assert shown(view) == Pose(0.04, 0.0, 0.0)


def test_a_reset_that_never_came_is_not_waited_for_without_end() -> None:
    view = view_of(RUN)
    view.expect_reset(2.0)
    view.update(RUN[-1], now_s=7.0, wall_ns=70)
    view.update(Pose(), now_s=7.1, wall_ns=71)
    assert shown(view) == pytest.approx(RUN[-1])
    assert observed(view).restarts == 1


def test_a_restart_during_a_long_silence_is_detected() -> None:
    """Ten seconds are enough to drive there, but hardly to the very place and heading."""
    view = view_of(RUN)
    view.update(Pose(0.001, 0.0, 0.0), now_s=12.0, wall_ns=120)
    assert shown(view) == pytest.approx(RUN[-1])
    assert observed(view).restarts == 1


def test_lost_connection_does_not_count_as_a_restart() -> None:
    """The device kept counting: what it tells now is where the robot is."""
    view = view_of(RUN)
    here = Pose(1.4, 2.1, -2.5)
    view.update(here, now_s=20.0, wall_ns=200)
    assert shown(view) == here
    assert observed(view).restarts == 0


def test_wheel_that_shakes_at_the_origin_does_not_count_as_a_restart() -> None:
    view = view_of([Pose(), Pose(0.0012), Pose(), Pose(-0.0012), Pose()])
    assert shown(view) == Pose()
    assert observed(view).restarts == 0


def test_fast_robot_that_passes_its_origin_does_not_count_as_a_restart() -> None:
    poses = arc(2.8, 0.0, 8, Pose(-0.84, 0.0, 0.0))
    view = OdometryEstimator(fastest=PlanarVelocity(3.0, yaw_rad_s=4.0))
    for number, pose in enumerate(poses):
        view.update(pose, now_s=number * PERIOD_S, wall_ns=number)
    assert shown(view) == poses[-1]
    assert observed(view).restarts == 0


@pytest.mark.parametrize("damaged", [Pose(1e3, 0.0, 0.0), Pose(1e300, -1e300, 1.0), Pose(9.0, 9.0, 9.0)])
def test_one_damaged_pose_is_not_believed(damaged: Pose) -> None:
    """One damaged frame in 256 has the right checksum."""
    whole = view_of(RUN)
    view = OdometryEstimator()
    for number, pose in enumerate(RUN):
        view.update(pose, now_s=number * PERIOD_S, wall_ns=number)
        if number == 10:
            view.update(damaged, now_s=number * PERIOD_S, wall_ns=number)
    assert (shown(view), twist_of(view)) == (shown(whole), twist_of(whole))
    assert (observed(view).restarts, observed(view).ignored) == (0, 1)


def test_a_place_that_is_reported_twice_is_believed_and_shown_without_a_jump() -> None:
    view = view_of([*RUN, Pose(9.0, 9.0, 0.0), Pose(9.03, 9.0, 0.0)])
    assert shown(view) == pytest.approx(RUN[-1])
    assert (observed(view).restarts, observed(view).ignored) == (1, 1)


def has_moved(pose: Pose) -> bool:
    """Move by more than a shaking wheel."""
    return math.hypot(*pose[:2]) > SHAKE_M or abs(pose.theta_rad) > SHAKE_RAD


@given(
    st.lists(
        st.tuples(st.sampled_from(["drive", "restart", "reset", "lost"]), st.floats(-0.5, 0.5), st.floats(-2, 2)),
        max_size=30,
    )
)
def test_shown_pose_jumps_only_at_a_reset(history: list[tuple[str, float, float]]) -> None:
    """The true path is known here: the shown pose is the robot's since its last reset."""
    view, reported, truth, now_s = OdometryEstimator(), Pose(), Pose(), 0.0
    view.update(reported, now_s=now_s, wall_ns=0)
    for event, linear_m_s, angular_rad_s in history:
        if event == "restart" and has_moved(reported):
            reported = Pose()
        elif event == "reset":
            view.expect_reset(now_s)
            reported = truth = Pose()
        elif event == "lost":
            now_s += 8.0
        wheels_m = [speed * PERIOD_S for speed in DRIVE.wheel_speeds(PlanarVelocity(linear_m_s, 0.0, angular_rad_s))]
        if event == "drive":
            driven = DRIVE.integrate(reported, wheels_m)
            # back at the very origin in one period: nothing distinguishes that from a device that restarts there
            assume(not (has_moved(reported) and driven == pytest.approx(Pose(), abs=1e-9)))
            reported, truth = driven, DRIVE.integrate(truth, wheels_m)
        now_s += PERIOD_S
        view.update(reported, now_s=now_s, wall_ns=0)
        assert shown(view)[:2] == pytest.approx(truth[:2], abs=1e-9)
        assert wrap_angle(shown(view).theta_rad - truth.theta_rad) == pytest.approx(0, abs=1e-9)


# -- bunches ----------------------------------------------------------------------------------------------------------


def bunched(sizes: list[int], *, apart_s: float = 0.00008) -> list[float]:
    """Arrivals of poses that were sent every PERIOD_S and arrive in bunches of these sizes."""
    times_s: list[float] = []
    for size in sizes:
        times_s += [(len(times_s) + size) * PERIOD_S + place * apart_s for place in range(size)]
    return times_s


@pytest.mark.parametrize("apart_s", [0.0, 0.00008, 0.001])
@pytest.mark.parametrize("sizes", [[2] * 20, [3] * 15, [5] * 10, [3, 5, 2, 4, 6] * 3])
def test_poses_that_arrive_in_bunches_have_the_right_velocity_and_stamps_apart(
    sizes: list[int], apart_s: float
) -> None:
    view, speeds, rates, stamps_s = OdometryEstimator(), [], [], []
    times_s = bunched(sizes, apart_s=apart_s)
    settled = sum(sizes[:6])
    for number, (pose, at_s) in enumerate(zip(arc(0.2, 0.5, len(times_s)), times_s, strict=True)):
        view.update(pose, now_s=at_s, wall_ns=round(at_s * 1e9))
        found = observed(view, at_s)
        assert found.age_s == 0
        if number > settled:
            speeds.append(found.twist.x_m_s)
            rates.append(found.rate_hz)
            stamps_s.append(found.stamp_ns / 1e9)
    exact = len(set(sizes)) == 1
    assert speeds == pytest.approx([0.2] * len(speeds), rel=0.03 if exact else 0.25)
    assert rates == pytest.approx([10.0] * len(rates), rel=0.03 if exact else 0.25)
    gaps_s = [after - before for before, after in itertools.pairwise(stamps_s)]
    assert min(gaps_s) > (0.09 if exact else 0.04)


def test_pose_that_the_device_stamped_keeps_its_stamp_in_a_bunch() -> None:
    view = OdometryEstimator()
    times_s = bunched([3] * 8)
    for number, (pose, at_s) in enumerate(zip(arc(0.2, 0.5, len(times_s)), times_s, strict=True)):
        view.update(pose, now_s=at_s, wall_ns=number, is_stamped=True)
        assert observed(view).stamp_ns == number


@given(st.lists(st.tuples(st.integers(1, 4), st.floats(-0.02, 0.02)), min_size=3, max_size=40))
def test_messages_that_arrive_one_by_one_were_sent_when_they_arrived(gaps: list[tuple[int, float]]) -> None:
    """A device may leave some out."""
    times = SendTimes()
    for at_s in itertools.accumulate(0.1 * count + jitter_s for count, jitter_s in gaps):
        assert times.add(at_s) == at_s


@given(st.lists(st.tuples(st.integers(1, 9), st.floats(0.0, 3.0)), min_size=1, max_size=30))
def test_message_is_sent_before_it_arrives_and_after_the_one_before(bunches: list[tuple[int, float]]) -> None:
    times, now_s, last_s = SendTimes(), 0.0, -math.inf
    for size, gap_s in bunches:
        now_s += gap_s
        for _ in range(size):
            sent_s = times.add(now_s)
            assert last_s <= sent_s <= now_s
            assert sent_s >= now_s - LONGEST_S * 2
            last_s = sent_s
            now_s += 0.0001


# -- stamps -----------------------------------------------------------------------------------------------------------


@given(st.lists(st.integers(-900_000_000, 900_000_000), min_size=1, max_size=50))
def test_stamps_never_go_backwards(steps_ns: list[int]) -> None:
    view, stamp_ns, shown_ns = OdometryEstimator(), 10**18, 0
    for number, step_ns in enumerate(steps_ns):
        view.update(Pose(), now_s=number * PERIOD_S, wall_ns=max(stamp_ns, stamp_ns + step_ns))
        assert observed(view).stamp_ns >= shown_ns
        shown_ns = observed(view).stamp_ns


def test_a_host_whose_clock_was_set_back_is_followed() -> None:
    view = OdometryEstimator()
    view.update(Pose(), now_s=0.0, wall_ns=10**18)
    view.update(Pose(), now_s=0.1, wall_ns=10**18 - 3600 * 10**9)
    assert observed(view).stamp_ns == 10**18 - 3600 * 10**9


def test_a_restart_after_a_damaged_pose_is_a_restart() -> None:
    view = view_of(arc(0.3, 0.0, 20, Pose()))
    before = shown(view)
    view.update(Pose(50.0, -50.0, 0.0), now_s=2.0, wall_ns=0)
    view.update(Pose(), now_s=2.1, wall_ns=0)
    assert (observed(view).ignored, observed(view).restarts, shown(view)) == (1, 1, before)


@pytest.mark.parametrize("rate_hz", [50, 150, 1_000, 20_000])
def test_a_device_that_publishes_thousands_of_poses_costs_a_snapshot_no_more(rate_hz: int) -> None:
    """And motion and rate are right at every rate."""
    view = OdometryEstimator()
    step_s = 1 / rate_hz
    pose = Pose()
    for number in range(rate_hz):
        view.update(pose, now_s=number * step_s, wall_ns=number)
        pose = DRIVE.integrate(pose, [speed * step_s for speed in DRIVE.wheel_speeds(PlanarVelocity(0.3, 0.0, 1.0))])
    assert len(view._window) <= 2 * WINDOW_S / CLOSEST_S + 2  # two that are kept are at least half of it apart
    found = observed(view)
    assert found.rate_hz == pytest.approx(rate_hz, rel=0.02)
    assert found.twist == pytest.approx(PlanarVelocity(0.3, yaw_rad_s=1.0), rel=1e-3, abs=1e-9)


def test_another_has_the_same_settings_and_no_pose() -> None:
    slow = PlanarVelocity(0.1, yaw_rad_s=0.2)
    view = OdometryEstimator(continues=True, fastest=slow)
    view.update(Pose(1.0, 2.0, 3.0), now_s=0.0, wall_ns=0)
    other = view.anew()
    assert (other._continues, other._fastest) == (True, slow)
    assert other.snapshot(0.0) is None


# -- devices that know less than a pose -------------------------------------------------------------------------------


def test_velocities_alone_are_a_motion_without_a_pose() -> None:
    view = OdometryEstimator()
    for number in range(8):
        view.update(None, now_s=number * PERIOD_S, wall_ns=number, twist=PlanarVelocity(0.2))
    found = observed(view, 0.75)
    assert (found.pose, found.twist, found.is_moving, found.count) == (None, PlanarVelocity(0.2), None, 8)
    assert found.rate_hz == pytest.approx(10.0)


def test_moves_or_stands_alone_has_neither_pose_nor_velocity() -> None:
    view = OdometryEstimator()
    for is_moving in (True, False):
        view.update(None, now_s=0.0, wall_ns=0, is_moving=is_moving)
        found = observed(view, 0.1)
        assert (found.pose, found.twist, found.is_moving) == (None, None, is_moving)


@pytest.mark.parametrize("twist", [None, PlanarVelocity(math.nan)])
def test_reading_of_nothing_is_ignored(twist: PlanarVelocity | None) -> None:
    view = OdometryEstimator()
    view.update(None, now_s=0.0, wall_ns=0, twist=twist)
    assert (view.snapshot(0.0), view.count, view.ignored) == (None, 0, 1)


def test_after_a_pose_readings_without_one_do_not_renew_it() -> None:
    view = view_of([Pose(1.0), Pose(1.02)])
    view.update(None, now_s=0.2, wall_ns=0, twist=PlanarVelocity(0.2))
    found = observed(view, 0.6)
    assert (found.pose, found.age_s, found.ignored) == (Pose(1.02), pytest.approx(0.5), 1)


def test_first_pose_after_velocities_begins_the_window() -> None:
    view = OdometryEstimator()
    view.update(None, now_s=0.0, wall_ns=0, twist=PlanarVelocity(0.2))
    view.update(Pose(5.0), now_s=0.1, wall_ns=0)
    view.update(Pose(5.02), now_s=0.2, wall_ns=0)
    found = observed(view, 0.2)
    assert (found.pose, found.twist) == (Pose(5.02), pytest.approx(PlanarVelocity(0.2)))


@pytest.mark.parametrize(("age_s", "rate_hz"), [(0.0, 10.0), (1.0, 10.0), (1.25, 0.8), (2.1, 0.0), (6.12, 0.0)])
def test_rate_of_poses_that_no_longer_come_ages(age_s: float, rate_hz: float) -> None:
    view = view_of([Pose(0.01 * number) for number in range(10)])
    assert observed(view, 0.9 + age_s).rate_hz == pytest.approx(rate_hz)


def test_rate_of_a_slow_device_is_its_own_until_the_next_message_is_late() -> None:
    assert aged_rate_hz(0.6, 1.5) == 0.6
    assert aged_rate_hz(0.6, 1.9) == pytest.approx(1 / 1.9)
