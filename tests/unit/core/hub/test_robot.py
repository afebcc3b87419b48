"""Robots of this and of other daemons: what is shown of them, and why they move."""

import asyncio
import dataclasses
import math
import struct

import msgspec
import pytest
from structlog.testing import capture_logs

from hostlink.core.config import CalibrationConfig, Config, RobotConfig
from hostlink.core.hub.any_robot import MAX_LOCK_REASON
from hostlink.core.hub.remote_state import RemoteOdometry
from hostlink.core.hub.robot_settings import correction_of, limits_of, of_namesake
from hostlink.core.protocol.endpoint import EndpointKind
from hostlink.core.robot.kinematics import Pose
from hostlink.core.robot.odometry import OdometrySnapshot
from hostlink.core.robot.velocity import ZERO, PlanarVelocity
from hostlink.errors import CommandRefused, ConfigError, DeviceGone, UnknownTopic
from tests.support.fake_device import robot_topics, topic
from tests.support.gates import drive_gate
from tests.support.memory_hub import MemoryHub, in_hub
from tests.support.remote_robots import RecordingHosts, reach, remote_robot
from tests.support.virtual_loop import inside

SLOW = PlanarVelocity(0.1)


def pose(x_m: float, y_m: float = 0.0, theta_rad: float = 0.0) -> bytes:
    return struct.pack("<3d", x_m, y_m, theta_rad)


@inside(in_hub)
async def test_state_shows_driver_velocity_lock_and_link(made: MemoryHub) -> None:
    device = await made.connect()
    ann = made.hub.join("ann", priority=70)
    ann.address = "10.0.0.9"
    ann.drive(made.robot(), SLOW)
    await asyncio.sleep(0.1)
    state = made.robot().state(made.now_s)
    assert (state.name, state.link, state.host) == ("robot_0", device.link.number, None)
    assert (state.holder, state.holder_address, state.priority) == ("ann", "10.0.0.9", 70)
    assert (state.velocity, state.lock_reason, state.unreachable) == (SLOW, None, None)
    assert (state.velocity_topic, state.odometry_topic) == ("/robot_0/velocity_commands", "/robot_0/odometry")
    assert (state.reset_topic, state.odometry_type) == ("/robot_0/reset_odometry", "geometry_msgs/Pose2D")
    assert state.frames is not None
    assert state.frames > 0
    assert state.battery_v is None
    assert state.lease_s == 0.5
    made.robot().lock("smoke")
    state = made.robot().state(made.now_s)
    assert (state.lock_reason, state.holder, state.velocity) == ("smoke", None, ZERO)
    await device.aclose()
    await asyncio.sleep(0.05)
    state = made.robot().state(made.now_s)
    assert (state.link, state.frames, state.device_errors) == (None, None, ())


@inside(in_hub)
async def test_pose_of_the_device_becomes_the_odometry_and_calls_followers(made: MemoryHub) -> None:
    device = await made.connect()
    called: list[int] = []
    made.hub.join("ann").follow(made.robot(), lambda: called.append(1))
    for number in range(3):
        await device.send(125, pose(0.1 * number))
        await asyncio.sleep(0.1)
    found = made.robot().odometry.snapshot(made.now_s)
    assert found.pose.x_m == pytest.approx(0.2)
    assert found.twist.x_m_s == pytest.approx(1.0, rel=0.2)
    assert len(called) == 3
    await device.send(125, b"short")
    await asyncio.sleep(0.05)
    assert made.robot().unreadable == 0  # the session refuses a payload of another size
    assert made.robot().odometry.count == 3


@inside(in_hub)
async def test_pose_that_a_program_publishes_is_not_the_robot_s(made: MemoryHub) -> None:
    await made.connect()
    ann = made.hub.join("ann")
    ann.advertise("/robot_0/odometry", "geometry_msgs/Pose2D")
    ann.publish("/robot_0/odometry", pose(7.0))
    assert made.robot().odometry.count == 0


@inside(in_hub)
async def test_battery_of_the_device_is_shown_until_it_leaves(made: MemoryHub) -> None:
    infos = [*robot_topics(), topic(EndpointKind.PUBLISHER, 126, "/robot_0/battery", "sensor_msgs/BatteryState")]
    device = await made.connect(infos)
    found = made.hub.catalog.message("sensor_msgs/BatteryState")
    await device.send(126, found.encode({"voltage": 12.5, "percentage": 0.5}))
    await asyncio.sleep(0.05)
    state = made.robot().state(made.now_s)
    assert (state.battery_v, state.battery_percent) == (12.5, 50.0)
    await device.aclose()
    await asyncio.sleep(0.05)
    assert made.robot().state(made.now_s).battery_v is None


@inside(in_hub, Config(robots={"robot_0": RobotConfig(max_linear_deceleration_m_s2=0.5)}))
async def test_reason_why_a_robot_moves_names_the_driver_then_the_ramp(made: MemoryHub) -> None:
    await made.connect()
    robot = made.robot()
    assert robot.why_moving() == "the stop was sent, and its device has not obeyed it yet"
    drive_gate(robot, PlanarVelocity(0.5), owner="ann")
    await asyncio.sleep(0.1)
    assert robot.why_moving() == "driven by ann"
    robot.stop()
    assert robot.why_moving() == "it slows down within its deceleration limits"


@inside(in_hub)
async def test_reason_why_a_moving_robot_ignores_a_stop_is_its_recording(made: MemoryHub) -> None:
    await made.connect(
        [*robot_topics(), topic(EndpointKind.PUBLISHER, 130, "/robot_0/played", "hostlink_msgs/PlayedRecording")]
    )
    drive_gate(made.robot(), PlanarVelocity(0.5), owner="ann")
    assert made.robot().why_moving() == "it is a recording, which obeys nobody"


@inside(in_hub)
async def test_reason_why_the_motion_is_unknown_says_what_is_missing(made: MemoryHub) -> None:
    device = await made.connect()
    robot = made.robot()
    assert robot.why_unknown() == "it sends no odometry"
    await device.send(125, pose(0.0))
    await asyncio.sleep(0.05)
    assert robot.why_unknown() == "no odometry has come since the stop"
    assert robot.measured(made.now_s) is not None
    assert robot.measured(made.now_s + 3.0) is None
    await asyncio.sleep(2.0)
    assert robot.why_unknown() == "nothing has come from its device for 2.1 s"
    await device.aclose()
    await asyncio.sleep(0.05)
    assert robot.why_unknown() == "its device is not connected"
    assert robot.measured(made.now_s) is None


@inside(in_hub)
async def test_lock_and_unlock_are_logged_with_the_reason(made: MemoryHub) -> None:
    await made.connect()
    made.robot().lock("smoke\x1b[31m")
    made.robot().unlock()
    made.robot().unlock()
    assert [each["reason"] for each in made.logged("robot.locked")] == ["smoke?[31m"]
    assert len(made.logged("robot.unlocked")) == 1


@inside(in_hub)
async def test_reason_of_a_lock_is_kept_whole_or_says_that_it_is_cut(made: MemoryHub) -> None:
    reason = "the person at the third bench has pressed the emergency stop because a cable lies across the aisle"
    await made.connect()
    made.robot().lock(reason)
    assert made.robot().gate.lock_reason == reason
    made.robot().unlock()
    made.robot().lock("x" * (MAX_LOCK_REASON + 1))
    assert made.robot().gate.lock_reason == "x" * (MAX_LOCK_REASON - 1) + "…"


@inside(in_hub)
async def test_locked_robot_is_surely_there_on_the_link_of_the_lock_alone(made: MemoryHub) -> None:
    device = await made.connect()
    robot = made.robot()
    robot.lock()
    assert robot.gate.lock_reason == "emergency stop"
    assert robot.is_surely_there()
    await device.aclose()
    await asyncio.sleep(0.05)
    assert not robot.is_surely_there()


def test_limits_and_correction_follow_the_configuration() -> None:
    config = RobotConfig(address="10.0.0.2", max_linear_m_s=0.3, odom_topic="/o", calibration=CalibrationConfig())
    assert limits_of(config).max_linear_m_s == 0.3
    assert correction_of(config) is None
    namesake = of_namesake(config)
    assert (namesake.address, namesake.odom_topic, namesake.max_linear_m_s) == (None, None, 0.3)
    assert of_namesake(None) == RobotConfig()
    with pytest.raises(ConfigError):
        limits_of(dataclasses.replace(config, max_linear_m_s=-1.0))


# -- robots of other daemons ------------------------------------------------------------------------------------------


@inside(in_hub)
async def test_command_of_a_remote_robot_is_admitted_here_and_sent_there(made: MemoryHub) -> None:
    hosts = RecordingHosts()
    robot = remote_robot(made.hub, "robot_7", hosts)
    made.hub.robots.put_remote(robot)
    with pytest.raises(CommandRefused):
        drive_gate(robot, SLOW)
    robot.connect(12, 100)
    drive_gate(robot, SLOW, owner="ann", priority=60)
    drive_gate(robot, SLOW, owner="ann", epoch=robot.admission.epoch)
    assert hosts.sent == [("drive", SLOW, "ann", 60, None), ("drive", SLOW, "ann", 50, 100)]
    robot.also_at = ("third",)
    with pytest.raises(DeviceGone, match="several robots have this name, at other, third"):
        drive_gate(robot, SLOW)
    with pytest.raises(DeviceGone):
        robot.unlock()


@inside(in_hub)
async def test_stop_and_lock_reach_other_daemons_that_have_the_name(made: MemoryHub) -> None:
    hosts = RecordingHosts()
    reach(made.hub, hosts)
    robot = remote_robot(made.hub, "robot_7", hosts)
    robot.stop()
    robot.lock("smoke")
    robot.unlock()
    await made.hub.gates.settled()
    assert hosts.sent == [("stop", "robot_7"), ("lock", "robot_7", "smoke"), ("unlock",), ("settled",)]
    hosts.sent.clear()
    await made.connect()
    here = made.robot()
    here.stop()
    here.lock()
    assert hosts.sent == []
    here.also_at = ("other",)
    here.stop()
    here.lock("smoke")
    assert hosts.sent == [("stop", "robot_0"), ("lock", "robot_0", "smoke")]
    made.hub.robots.stop_all()
    assert hosts.sent[2:] == [("stop", None)]
    made.hub.robots.stop_all_here()
    assert len(hosts.sent) == 3


@inside(in_hub)
async def test_description_of_a_remote_robot_interrupts_locks_and_unlocks_its_admission(made: MemoryHub) -> None:
    robot = remote_robot(made.hub, "robot_7", RecordingHosts())
    robot.connect(12, 100)
    drive_gate(robot, SLOW, owner="ann")
    before = robot.admission.epoch
    robot.update(robot.known, epoch=100)
    assert robot.admission.epoch == before
    robot.update(robot.known, epoch=101)
    assert robot.admission.epoch == before + 1
    with pytest.raises(CommandRefused):
        drive_gate(robot, SLOW, owner="ann")
    robot.update(msgspec.structs.replace(robot.known, lock_reason="smoke"), epoch=102)
    assert robot.state(made.now_s).lock_reason == "smoke"
    robot.update(msgspec.structs.replace(robot.known, lock_reason=None), epoch=103)
    assert robot.admission.lock_reason is None
    robot.connect(None, None)
    assert robot.link is None
    assert robot.why_unknown() == "its device is not connected"


def test_remote_odometry_grows_older_and_says_whether_a_pose_is_new() -> None:
    odometry = RemoteOdometry()
    assert odometry.snapshot(0.0) is None
    snapshot = OdometrySnapshot(
        pose=Pose(1.0), twist=ZERO, age_s=0.2, rate_hz=10.0, count=3, restarts=0, ignored=0, stamp_ns=5
    )
    assert odometry.update(snapshot, 10.0)
    assert not odometry.update(snapshot, 11.0)
    found = odometry.snapshot(11.5)
    assert (found.age_s, odometry.count, odometry.read_at_s) == (pytest.approx(0.7), 3, 11.5)
    assert odometry.update(dataclasses.replace(snapshot, restarts=1), 12.0)


# -- the registry -----------------------------------------------------------------------------------------------------


@inside(in_hub)
async def test_robot_is_found_here_first_unless_it_is_away_and_connected_to_another_daemon(made: MemoryHub) -> None:
    robots = made.hub.robots
    device = await made.connect()
    remote = remote_robot(made.hub, "robot_0", RecordingHosts())
    robots.put_remote(remote)
    assert robots.find("/robot_0") is made.robot()
    remote.connect(12, 1)
    assert robots.find("robot_0") is made.robot()
    await device.aclose()
    await asyncio.sleep(0.05)
    assert robots.find("robot_0") is remote
    assert robots.all() == [remote]
    assert robots.here() == [made.robot()]
    assert robots.is_known(remote)
    assert robots.is_known(made.robot())
    robots.pop_remote("robot_0")
    assert not robots.is_known(remote)
    assert robots.pop_remote("robot_0") is None
    assert robots.find("robot_0") is made.robot()
    with pytest.raises(UnknownTopic, match="other"):
        robots.find("other")
    with pytest.raises(UnknownTopic):
        robots.find_here("other")


@inside(in_hub)
async def test_source_that_commanded_before_the_robot_existed_is_disarmed(made: MemoryHub) -> None:
    for find in (made.hub.robots.find, made.hub.robots.find_here):
        with pytest.raises(UnknownTopic):
            find("robot_0", driver=lambda: "ann")
    await made.connect()
    with pytest.raises(CommandRefused):
        drive_gate(made.robot(), SLOW, owner="ann")
    assert drive_gate(made.robot(), SLOW, owner="bob") == SLOW


@inside(in_hub)
async def test_reconfigured_limits_hold_at_once_for_each_velocity_topic(made: MemoryHub) -> None:
    more = topic(EndpointKind.SUBSCRIBER, 110, "/robot_0/cmd_vel_raw", "geometry_msgs/Twist")
    await made.connect([*robot_topics(), more])
    drive_gate(made.robot(), PlanarVelocity(0.5), owner="ann")
    made.hub.robots.reconfigure({"robot_0": RobotConfig(max_linear_m_s=0.2, cmd_vel_max_age_s=2.0)})
    assert made.robot().gate.target == PlanarVelocity(0.2)
    assert made.robot().admission.max_stamp_age_s == 2.0
    for drivable in made.robot().beside:
        assert drivable.gate.limits.apply(PlanarVelocity(1.0)) == PlanarVelocity(0.2)
    made.hub.robots.reconfigure({})
    assert made.robot().admission.max_stamp_age_s == math.inf
    assert made.robot().config == RobotConfig()


def test_robot_without_device_is_forgotten_unless_it_is_configured() -> None:
    async def test(made: MemoryHub) -> None:
        device = await made.connect()
        made.hub.robots.forget("robot_0")
        assert made.hub.robots.has("robot_0")  # it is connected
        await device.aclose()
        await asyncio.sleep(0.05)
        made.hub.robots.forget("robot_0")
        assert not made.hub.robots.has("robot_0")
        assert made.hub.robots.forgotten == 1
        made.hub.robots.forget("robot_0")
        assert made.hub.robots.forgotten == 1

    with capture_logs():
        in_hub(test)


@inside(in_hub)
async def test_link_leads_to_its_device_robot_and_drivables(made: MemoryHub) -> None:
    device, robots = await made.connect(), made.hub.robots
    assert robots.of_link(device.link) is made.robot()
    assert robots.of_link("no link") is None
    assert robots.drivables() == [made.robot()]
    assert robots.new_number() > device.link.number


@inside(in_hub)
async def test_poses_with_nan_age_the_last_good_one_and_are_named(made: MemoryHub) -> None:
    device = await made.connect()
    for number in range(5):
        await device.send(125, pose(0.1 * number))
        await asyncio.sleep(0.1)
    for _ in range(30):
        await device.send(125, struct.pack("<3d", math.nan, 0.0, 0.0))
        await asyncio.sleep(0.1)
    robot = made.robot()
    found = robot.odometry.snapshot(made.now_s)
    assert found.pose.x_m == pytest.approx(0.4)
    assert found.age_s == pytest.approx(3.0, abs=0.3)
    assert (found.rate_hz, found.ignored) == (0.0, 30)
    assert robot.why_unknown() == "it sent 30 poses with NaN or infinity in the last 30 s"
    assert "bad_pose" in robot.state(made.now_s).device_errors


@inside(in_hub)
async def test_poses_of_another_planet_are_named_and_are_not_odometry(made: MemoryHub) -> None:
    device = await made.connect()
    for number in range(20):
        await device.send(125, struct.pack("<3d", 1e308 * (-1) ** number, 1e308, 1e300))
        await asyncio.sleep(0.1)
    await asyncio.sleep(1.0)
    robot = made.robot()
    assert robot.odometry.snapshot(made.now_s) is None
    assert robot.why_unknown() == "it sent 20 poses farther than 1000 km away in the last 30 s"
    assert "bad_pose" in robot.state(made.now_s).device_errors


@inside(in_hub)
async def test_driven_robot_whose_odometry_runs_backwards_is_found(made: MemoryHub) -> None:
    device = await made.connect()
    robot = made.robot()
    for number in range(40):
        drive_gate(robot, PlanarVelocity(0.3), owner="ann")
        await device.send(125, pose(-0.03 * number))
        await asyncio.sleep(0.1)
    assert "odometry_disagrees" in robot.state(made.now_s).device_errors


@inside(in_hub)
async def test_robot_that_follows_its_commands_has_no_finding(made: MemoryHub) -> None:
    device = await made.connect()
    robot = made.robot()
    for number in range(100):
        drive_gate(robot, PlanarVelocity(0.3), owner="ann")
        await device.send(125, pose(0.03 * number))
        await asyncio.sleep(0.1)
    assert not {"odometry_disagrees", "odometry_jumps", "bad_pose", "odometry_unsent"} & set(
        robot.state(made.now_s).device_errors
    )
