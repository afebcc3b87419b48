"""The simulated robot: the numbers of docs/robot.md, its watchdog, and odometry against what the wheels truly did."""

import math
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hostlink.messages.catalog import Catalog
from hostlink.protocol.control import Parameter, decode_log, decode_parameter_request, encode_parameter
from hostlink.protocol.frame import TOPICS_REQUEST, Frame, Id, encode
from hostlink.protocol.stream import FrameStream
from hostlink.sim.controller import LEFT_GAINS, MinimumJerk, WheelController, motor_output
from hostlink.sim.device import SimulatedDevice
from hostlink.sim.drive_train import DriveTrain
from hostlink.sim.faults import FAULTS
from hostlink.sim.geometry import Geometry
from hostlink.sim.robot import LOOP_S, SimulatedRobot
from hostlink.sim.run import world_of
from hostlink.sim.world import World
from hostlink.sim.world_parameters import WheelParameters, WorldParameters
from hostlink.sim.worlds import AnyWorld

CATALOG = Catalog()
METRES_PER_TICK = math.tau * 0.045 / 230.4


class Track:
    """A robot on a line without delay, driven for a while."""

    def __init__(self, world: AnyWorld | None = None) -> None:
        self.robot = SimulatedRobot("robot_0", CATALOG, device=SimulatedDevice(baud=None), world=world)
        self.now_s = 0.0
        self.robot.device.from_host.send(TOPICS_REQUEST, 0.0)
        self.frames: list[Frame] = []
        self.drive(0.0, 0.0, 0.2)

    def drive(self, linear: float, angular: float, seconds: float, *, is_commanded: bool = True) -> None:
        twist = CATALOG.message("geometry_msgs/Twist")
        assert twist is not None
        payload = twist.encode({"linear": {"x": linear}, "angular": {"z": angular}})
        for turn in range(round(seconds / LOOP_S)):
            if is_commanded and turn % 3 == 0:
                self.robot.device.from_host.send(encode(100, payload), self.now_s)
            assert self.robot.turn(self.now_s) is None
            self.now_s += LOOP_S
            sent = self.robot.device.to_host.pop(self.now_s)
            self.frames += [item for item in FrameStream().feed(sent) if isinstance(item, Frame)]


def test_it_reaches_the_commanded_speed_and_its_odometry_shows_it() -> None:
    track = Track()
    track.drive(0.2, 0.0, 10.0)
    assert track.robot.speed_m_s == pytest.approx(0.2, rel=0.1)
    truth_m = sum(wheel.rolled_ticks for wheel in track.robot.wheels) / 2 * METRES_PER_TICK
    assert track.robot.pose.x_m == pytest.approx(truth_m, abs=0.005)
    assert abs(track.robot.pose.y_m) < 0.02


def test_a_turn_to_the_left_is_positive() -> None:
    track = Track()
    track.drive(0.15, 0.5, 5.0)
    assert 0.5 < track.robot.pose.theta_rad < math.pi
    assert track.robot.pose.y_m > 0.05


def test_backwards_is_backwards() -> None:
    track = Track()
    track.drive(-0.2, 0.0, 5.0)
    assert track.robot.pose.x_m < -0.3


def test_it_stops_within_0_6_s_of_the_last_command() -> None:
    track = Track()
    track.drive(0.3, 0.0, 5.0)
    track.drive(0.0, 0.0, 0.6, is_commanded=False)
    assert [control.pwm for control in track.robot.controllers] == [0, 0]
    track.drive(0.0, 0.0, 0.4, is_commanded=False)
    assert abs(track.robot.speed_m_s) < 0.01


def test_a_zero_command_stops_it_at_once() -> None:
    track = Track()
    track.drive(0.3, 0.0, 5.0)
    track.drive(0.0, 0.0, 0.1)
    assert [control.pwm for control in track.robot.controllers] == [0, 0]


def test_it_publishes_at_ten_hertz() -> None:
    track = Track()
    track.frames.clear()
    track.drive(0.1, 0.0, 3.0)
    assert sum(frame.topic_id == 125 for frame in track.frames) == 30
    assert sum(frame.topic_id == 126 for frame in track.frames) == 30


def test_reset_makes_the_present_place_the_origin() -> None:
    track = Track()
    track.drive(0.2, 0.0, 3.0)
    track.robot.device.from_host.send(encode(101, b""), track.now_s)
    track.drive(0.0, 0.0, LOOP_S)
    assert abs(track.robot.pose.x_m) < 0.02


def configured(parameters: dict[str, Parameter]) -> tuple[Track, list[str]]:
    """A robot whose host answers with these parameters; and what it logs."""
    track = Track()
    logs: list[str] = []
    for _ in range(10):
        for frame in track.frames:
            if frame.topic_id == Id.PARAMETER:
                name = (decode_parameter_request(frame.payload) or "").removeprefix("/robot_0/")
                answer = encode_parameter(parameters.get(name, Parameter()))
                track.robot.device.from_host.send(encode(Id.PARAMETER, answer), track.now_s)
            if frame.topic_id == Id.LOG and (log := decode_log(frame.payload)) is not None:
                logs.append(log.text)
        track.frames.clear()
        track.drive(0.0, 0.0, 0.1)
    return track, [text for text in logs if text != "robot_0 is ready"]


def test_each_wheel_has_a_radius_and_ticks_of_its_own() -> None:
    track, logs = configured(
        {
            "wheel_radius": Parameter(floats=(0.0449, 0.0453)),
            "ticks_per_turn": Parameter(floats=(230.4, 231.5)),
            "wheel_separation": Parameter(floats=(0.2143,)),
        }
    )
    assert logs == ["wheel radius 44.900 and 45.300 mm, 214.30 mm apart", "ticks a turn 230.400 and 231.500"]
    wanted = Geometry(wheel_radius_m=(0.0449, 0.0453), ticks_per_turn=(230.4, 231.5))
    assert track.robot.geometry.metres_per_tick == pytest.approx(wanted.metres_per_tick)
    assert track.robot.geometry.wheel_separation_m == pytest.approx(0.2143)


def test_numbers_that_no_wheel_has_are_refused() -> None:
    track, logs = configured({"wheel_radius": Parameter(floats=(math.nan,)), "ticks_per_turn": Parameter(ints=(0,))})
    assert logs == [
        "wheel_radius refused: 1 or 2 numbers from 0.005 to 0.5",
        "ticks_per_turn refused: 1 or 2 numbers from 1.000 to 100000.0",
    ]
    assert track.robot.geometry == Geometry()


def test_gains_by_message() -> None:
    track = Track()
    vector = CATALOG.message("geometry_msgs/Vector3")
    assert vector is not None
    track.robot.device.from_host.send(encode(103, vector.encode({"x": 1.0, "y": 2.0, "z": 3.0})), track.now_s)
    track.drive(0.0, 0.0, LOOP_S)
    gains = track.robot.controllers[1].pid.gains
    assert (gains.kp, gains.ki, gains.kd) == (1.0, 2.0, 3.0)


@pytest.mark.parametrize(
    ("wanted", "pwm"),
    [(0, 0), (10, 0), (11, 700), (700, 700), (701, 701), (4095, 4095), (5000, 4095), (-11, -700), (math.nan, 0)],
)
def test_the_dead_band(wanted: float, pwm: int) -> None:
    assert motor_output(wanted) == pwm


def test_minimum_jerk_lasts_as_computed_and_ends_where_it_should() -> None:
    curve = MinimumJerk()
    curve.aim(100.0)
    values = [curve.step(0.1) for _ in range(20)]  # 0.018 s a tick/s: 1.8 s
    assert values == sorted(values)
    assert values[8] == pytest.approx(50.0)
    assert values[17] == pytest.approx(100.0)
    assert values[19] == 100.0


def test_minimum_jerk_without_a_change_is_there_at_once() -> None:
    curve = MinimumJerk()
    curve.aim(0.0)
    assert curve.step(0.1) == 0.0


def test_the_encoder_keeps_its_sign_until_the_wheel_has_stopped() -> None:
    """Told to reverse at full speed, a wheel rolls on; its ticks still count forwards."""
    control, wheel = WheelController(LEFT_GAINS), DriveTrain()
    rolled = 0.0
    for turn in range(300):
        control.aim(250.0 if turn < 200 else -250.0)
        rolled += control.step(wheel.step(control.pwm, LOOP_S), LOOP_S)
    assert rolled == pytest.approx(wheel.rolled_ticks, abs=12)


def errors(track: Track) -> list[str]:
    logs = [decode_log(frame.payload) for frame in track.frames if frame.topic_id == Id.LOG]
    return [log.text for log in logs if log is not None and log.level == 3]


def pwms(track: Track) -> list[int]:
    return [control.pwm for control in track.robot.controllers]


def test_a_blocked_wheel_stops_both_is_logged_once_and_waits_for_a_zero() -> None:
    track = Track()
    track.robot.wheels[1].grip(0.0)
    track.drive(0.2, 0.0, 4.0)
    assert pwms(track) == [0, 0]
    assert [text.partition(":")[0] for text in errors(track)] == ["right wheel stalled"]
    track.robot.wheels[1].release()
    track.drive(0.2, 0.0, 2.0)
    assert pwms(track) == [0, 0]
    track.drive(0.0, 0.0, 0.5)
    track.drive(0.2, 0.0, 3.0)
    assert min(pwms(track)) > 0
    assert len(errors(track)) == 1


@pytest.mark.parametrize(("linear", "angular"), [(math.nan, 0.0), (0.2, math.inf), (1e308, 0.0), (1e308, -1e308)])
def test_a_velocity_that_is_no_number_stops_it_and_the_next_one_drives(linear: float, angular: float) -> None:
    track = Track()
    track.drive(0.2, 0.0, 2.0)
    track.drive(linear, angular, LOOP_S)
    assert pwms(track) == [0, 0]
    assert errors(track) == ["a velocity that is no number: stopped"]
    track.drive(0.2, 0.0, 3.0)
    assert track.robot.speed_m_s > 0.1


@pytest.mark.parametrize(("fault", "reported"), [("stalled_wheel", "stalled"), ("runaway_wheel", "runs away")])
def test_the_faults_of_a_wheel_are_found_when_it_is_driven(fault: str, reported: str) -> None:
    track = Track()
    FAULTS[fault].break_wheel(track.robot.wheels[0])
    track.drive(0.0, 0.0, 3.0)
    assert errors(track) == []
    track.drive(0.1, 0.0, 4.0)
    assert [text.partition(":")[0] for text in errors(track)] == [f"left wheel {reported}"]
    assert pwms(track) == [0, 0]


wheels = st.builds(
    WheelParameters,
    full_speed_rad_s=st.floats(6.8, 8.5),
    rise_constant_s=st.floats(0.02, 0.2),
    coast_constant_s=st.floats(0.2, 1.0),
    brake_constant_s=st.floats(0.02, 0.2),
    dead_zone_pwm=st.floats(0.0, 800.0),
    has_jump=st.sampled_from([0.0, 1.0]),
)
worlds = st.builds(
    lambda wheel, caster_pwm: WorldParameters(left=wheel, right=wheel, caster_pwm=caster_pwm),
    wheels,
    st.sampled_from([0.0, 300.0]),
)
speeds = st.sampled_from([-0.3, -0.2, -0.1, 0.1, 0.2, 0.3])
stories = st.lists(st.tuples(speeds, st.floats(0.1, 3.0), st.floats(0.0, 0.3)), min_size=1, max_size=6)


@settings(max_examples=settings.default.max_examples // 2)
@given(worlds, stories)
def test_its_odometry_shows_what_its_wheels_do_in_any_world(
    drawn: WorldParameters, story: list[tuple[float, float, float]]
) -> None:
    track = Track(World(drawn))
    for linear, seconds, pause_s in story:
        track.drive(linear, 0.0, seconds)
        track.drive(0.0, 0.0, pause_s)
    track.drive(0.0, 0.0, 1.5)
    truth_m = sum(wheel.rolled_ticks for wheel in track.robot.wheels) / 2 * METRES_PER_TICK
    assert track.robot.pose.x_m == pytest.approx(truth_m, abs=0.003 * (1 + len(story)))
    assert abs(track.robot.speed_m_s) < 0.006
    assert errors(track) == []


def test_the_drive_train_does_not_depend_on_the_length_of_its_steps() -> None:
    coarse, fine = DriveTrain(), DriveTrain()
    ticks = coarse.step(2000, 1.0), sum(fine.step(2000, 0.01) for _ in range(100))
    assert coarse.speed_ticks_s == pytest.approx(fine.speed_ticks_s)
    assert abs(ticks[0] - ticks[1]) <= 1


def test_stiction_stops_a_wheel_below_its_least_pwm() -> None:
    wheel = DriveTrain()
    assert wheel.step(300, 1.0) == 0


BATTERY_ID, ERRORS_ID = 127, 128


def published(track: Track, topic_id: int, type_name: str) -> list[dict[str, Any]]:
    type_ = CATALOG.message(type_name)
    assert type_ is not None
    return [type_.decode(frame.payload) for frame in track.frames if frame.topic_id == topic_id]


def numbers(track: Track) -> list[list[int]]:
    return [list(message["data"]) for message in published(track, ERRORS_ID, "std_msgs/UInt16MultiArray")]


def test_it_publishes_its_battery_and_that_nothing_is_wrong_once_a_second() -> None:
    track = Track()
    track.frames.clear()
    track.drive(0.0, 0.0, 3.0)
    states = published(track, BATTERY_ID, "sensor_msgs/BatteryState")
    assert [state["voltage"] for state in states] == [12.0] * 3
    assert math.isnan(states[0]["percentage"])
    assert numbers(track) == [[]] * 3


def test_a_stalled_wheel_and_a_lost_driver_have_numbers() -> None:
    track = Track()
    track.drive(0.2, 0.0, 1.0)
    track.drive(0.2, 0.0, 1.0, is_commanded=False)
    assert numbers(track)[-1] == [31]
    track = Track()
    track.robot.wheels[0].grip(0.0)
    track.drive(0.3, 0.0, 4.0)
    assert numbers(track)[-1] == [11]


def stand(track: Track, seconds: float) -> None:
    """With a host that answers with the time; without one the device falls silent after 11 s."""
    for _ in range(round(seconds)):
        track.robot.device.from_host.send(encode(Id.TIME, bytes(8)), track.now_s)
        track.drive(0.0, 0.0, 1.0)


def test_a_battery_that_stays_low_is_logged_once() -> None:
    track = Track()
    track.robot.world.be(WorldParameters(battery_v=10.2))
    stand(track, 20.0)
    assert errors(track) == ["battery low: 10.2 V, below 10.5 V"]
    assert numbers(track)[-1] == [51]
    track.robot.world.be(WorldParameters())
    stand(track, 15.0)
    assert numbers(track)[-1] == []


def test_the_robots_of_a_fleet_slip_each_in_its_own_way() -> None:
    slippery = WheelParameters(slip_noise_m=0.01)
    drawn = WorldParameters(left=slippery, right=slippery)
    headings = set()
    for number in (0, 1, 0):
        track = Track(world_of(number, drawn))
        track.drive(0.2, 0.0, 6.0)
        headings.add(track.robot.world.theta_rad)
    assert len(headings) == 2
