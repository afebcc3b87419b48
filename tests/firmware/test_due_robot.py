"""The whole firmware on a board without hardware, with the motors of a world: driven, stopped, read back."""

import math
import struct

import pytest

from hostlink.core.protocol.events import Parameter
from hostlink.core.protocol.rosserial.control import decode_log, decode_parameter_request, encode_parameter
from hostlink.core.protocol.rosserial.frame import STOP_REQUEST, TOPICS_REQUEST, Frame, Id, encode
from hostlink.core.robot.kinematics import Pose
from hostlink.workbench.sim.firmware_world import Firmware
from tests.firmware.due import Retry, Robot, robot

METRES_PER_TICK = 2 * math.pi * 0.045 / 230.4
PASS_S = 0.002  # the period of the loop


def velocity(linear: float, angular: float) -> bytes:
    return encode(100, struct.pack("<6d", linear, 0, 0, 0, 0, angular))


def logged(frames: list[Frame]) -> list[str]:
    logs = [decode_log(frame.payload) for frame in frames if frame.topic_id == Id.LOG]
    return [log.text for log in logs if log is not None]


class Track:
    """The firmware, two motors and a clock."""

    def __init__(self, firmware: Robot, *, starts_at_s: float = 1.0) -> None:
        self.firmware = firmware
        self.now_s = starts_at_s
        self.world = Firmware().world  # without its firmware
        self.motors = (self.world.left, self.world.right)
        self.frames: list[Frame] = []
        self.parameters: dict[str, Parameter] = {}
        self.firmware.feed(TOPICS_REQUEST)
        self.run(0.2)

    def run(self, seconds: float, command: bytes | None = None) -> None:
        """Let the loop turn. A command is sent ten times a second; time and parameters are answered at once."""
        until_s, command_at_s = self.now_s + seconds, self.now_s
        while self.now_s < until_s:
            self.now_s += PASS_S
            if command is not None and self.now_s >= command_at_s:
                self.firmware.feed(command)
                command_at_s += 0.1
            self.world.turn_motors(*self.firmware.pwm, PASS_S, 1)
            self.firmware.loop(self.now_s, *self.edges)
            for frame in self.firmware.sent():
                self.answer(frame)

    def answer(self, frame: Frame) -> None:
        self.frames.append(frame)
        if frame.topic_id == Id.TIME:
            self.firmware.feed(encode(Id.TIME, bytes(8)))
        elif frame.topic_id == Id.PARAMETER:
            name = decode_parameter_request(frame.payload) or ""
            self.firmware.feed(encode(Id.PARAMETER, encode_parameter(self.parameters.get(name, Parameter()))))

    @property
    def edges(self) -> tuple[int, int]:
        return self.motors[0].edges, self.motors[1].edges

    @property
    def speed_m_s(self) -> float:
        return sum(motor.speed_ticks_s for motor in self.motors) / 2 * METRES_PER_TICK


def test_robot_announces_its_topics_and_requests_its_parameters() -> None:
    with robot() as firmware:
        track = Track(firmware)
        names = [frame.payload for frame in track.frames if frame.topic_id in (0, 1)]
        for name in (
            "odometry",
            "plot_data",
            "battery",
            "errors",
            "velocity_commands",
            "reset_odometry",
            "pid_tune_l",
            "pid_tune_r",
        ):
            assert any(f"/robot_0/{name}".encode() in payload for payload in names)
        requests = [decode_parameter_request(frame.payload) for frame in track.frames if frame.topic_id == Id.PARAMETER]
        assert requests == [
            f"/robot_0/{name}"
            for name in (
                "wheel_radius",
                "wheel_separation",
                "ticks_per_turn",
                "gains_left",
                "gains_right",
                "top_speed",
                "battery_low",
            )
        ]
        assert any(b"robot is ready" in frame.payload for frame in track.frames if frame.topic_id == Id.LOG)


def test_robot_drives_and_its_odometry_is_the_motion_of_its_wheels() -> None:
    with robot() as firmware:
        track = Track(firmware)
        track.run(10.0, velocity(0.2, 0.0))
        assert track.speed_m_s == pytest.approx(0.2, rel=0.1)
        truth_m = sum(motor.rolled_ticks for motor in track.motors) / 2 * METRES_PER_TICK
        assert firmware.pose[0] == pytest.approx(truth_m, abs=0.01)


@pytest.mark.parametrize(("linear", "angular"), [(0.15, 0.5), (-0.15, -0.5), (0.0, 1.0), (-0.2, 0.0)])
def test_signs_of_commands_wheels_and_odometry_agree(linear: float, angular: float) -> None:
    with robot() as firmware:
        track = Track(firmware)
        track.run(3.0, velocity(linear, angular))
        left, right = (motor.rolled_ticks for motor in track.motors)
        if linear:
            assert (left + right) * linear > 0
        if angular:
            assert (right - left) * angular > 0
            assert firmware.pose[2] * angular > 0


def test_reverse_is_limited_like_forward() -> None:
    with robot() as firmware:
        track = Track(firmware)
        track.run(12.0, velocity(-2.0, 1.0))
        assert max(abs(motor.speed_ticks_s) for motor in track.motors) <= 281


def test_robot_publishes_ten_times_a_second() -> None:
    with robot() as firmware:
        track = Track(firmware)
        track.frames.clear()
        track.run(3.0)
        assert sum(frame.topic_id == 125 for frame in track.frames) == pytest.approx(30, abs=1)
        assert sum(frame.topic_id == 126 for frame in track.frames) == pytest.approx(30, abs=1)


@pytest.mark.parametrize(
    ("last", "starts_at_s"),
    [
        pytest.param(b"", 1.0, id="silence"),
        pytest.param(b"", 2**32 / 1e6 - 3.0, id="silence while micros wrap"),
        pytest.param(b"", 2**32 / 1e3 - 3.0, id="silence while millis wrap"),
        pytest.param(velocity(0.0, 0.0), 1.0, id="zero"),
        pytest.param(velocity(math.nan, 0.0), 1.0, id="NaN"),
        pytest.param(velocity(0.2, math.inf), 1.0, id="infinite"),
        pytest.param(velocity(3e38, 0.0), 1.0, id="infinite ticks"),
        pytest.param(STOP_REQUEST, 2**32 / 1e3 - 3.0, id="host stops"),
    ],
)
def test_robot_stops_within_0_6_s_of_every_end_of_a_drive(last: bytes, starts_at_s: float) -> None:
    with robot() as firmware:
        track = Track(firmware, starts_at_s=starts_at_s)
        track.run(5.0, velocity(0.3, 0.0))
        assert track.speed_m_s > 0.15
        firmware.feed(last)
        track.run(0.6)
        assert firmware.pwm == (0, 0)
        track.run(0.5)
        assert abs(track.speed_m_s) < 0.01


def test_a_host_that_leaves_stops_it_at_once_also_when_another_is_there_in_the_same_turn() -> None:
    with robot() as firmware:
        track = Track(firmware)
        track.run(2.0, velocity(0.2, 0.0))
        assert min(firmware.pwm) > 0
        firmware.feed(STOP_REQUEST + TOPICS_REQUEST)
        track.run(PASS_S)
        assert firmware.pwm == (0, 0)
        track.run(0.5)
        track.run(2.0, velocity(0.2, 0.0))
        assert min(firmware.pwm) > 0


def test_new_commands_after_a_stop_drive_again() -> None:
    with robot() as firmware:
        track = Track(firmware)
        track.run(3.0, velocity(0.2, 0.0))
        track.run(1.0)
        track.run(3.0, velocity(0.2, 0.0))
        assert track.speed_m_s > 0.1


def test_robot_without_a_host_does_not_move() -> None:
    with robot() as firmware:
        for turn in range(500):
            if turn % 20 == 0:
                firmware.feed(velocity(0.3, 0.0))
            firmware.loop(1.0 + turn * PASS_S, 0, 0)
            assert firmware.pwm == (0, 0)


def test_reset_and_gains_by_message() -> None:
    with robot() as firmware:
        track = Track(firmware)
        track.run(3.0, velocity(0.2, 0.3))
        firmware.feed(encode(101, b""))
        track.run(0.01)
        assert firmware.pose == pytest.approx((0.0, 0.0, 0.0), abs=0.02)
        for wheel in (102, 103):
            firmware.feed(encode(wheel, struct.pack("<3d", 0.0, 0.0, 0.0)))
        track.run(1.0, velocity(0.2, 0.0))
        assert firmware.pwm == (0, 0)  # without gains it does not push


def test_parameters_of_the_host_replace_the_constants_and_nonsense_does_not() -> None:
    with robot() as firmware:
        track = Track(firmware)
        track.parameters = {
            "/robot_0/wheel_radius": Parameter(floats=(0.09,)),
            "/robot_0/wheel_separation": Parameter(floats=(math.nan,)),
        }
        firmware.feed(STOP_REQUEST)
        track.run(0.1)
        firmware.feed(TOPICS_REQUEST)
        track.run(1.0)
        before_m, before_ticks = firmware.pose[0], track.motors[0].rolled_ticks
        track.run(3.0, velocity(0.2, 0.0))
        rolled_ticks = track.motors[0].rolled_ticks - before_ticks
        assert firmware.pose[0] - before_m == pytest.approx(2 * rolled_ticks * METRES_PER_TICK, rel=0.1)


def configured(track: Track, parameters: dict[str, Parameter]) -> list[str]:
    """Renegotiate with these parameters; returns the logged lines."""
    track.parameters = {f"/robot_0/{name}": value for name, value in parameters.items()}
    track.firmware.feed(STOP_REQUEST)
    track.run(0.1)
    track.frames.clear()
    track.firmware.feed(TOPICS_REQUEST)
    track.run(1.0)
    return [text for text in logged(track.frames) if text != "robot is ready"]


CALIBRATED = {
    "wheel_radius": Parameter(floats=(0.0449, 0.0453)),
    "ticks_per_turn": Parameter(floats=(230.4, 231.5)),
    "wheel_separation": Parameter(floats=(0.2143,)),
}
CALIBRATED_TEXTS = ["wheel radius 44.900 and 45.300 mm, 214.30 mm apart", "ticks a turn 230.400 and 231.500"]


def test_each_wheel_has_a_radius_and_ticks_of_its_own() -> None:
    with robot() as firmware:
        track = Track(firmware)
        assert configured(track, CALIBRATED) == CALIBRATED_TEXTS
        before = Pose(*firmware.pose)
        start = [motor.rolled_ticks for motor in track.motors]
        track.run(6.0, velocity(0.2, 0.3))
        track.run(1.0)
        rolled = [motor.rolled_ticks - begun for motor, begun in zip(track.motors, start, strict=True)]
        left_m, right_m = math.tau * 0.0449 / 230.4 * rolled[0], math.tau * 0.0453 / 231.5 * rolled[1]
        assert firmware.pose[2] - before.theta_rad == pytest.approx((right_m - left_m) / 0.2143, abs=0.02)


@pytest.mark.parametrize(
    ("name", "values", "text"),
    [
        ("wheel_radius", (math.nan,), "wheel_radius refused: 1 or 2 numbers from 0.005 to 0.5"),
        ("wheel_radius", (0.045, math.inf), "wheel_radius refused: 1 or 2 numbers from 0.005 to 0.5"),
        ("wheel_radius", (0.045, -0.045), "wheel_radius refused: 1 or 2 numbers from 0.005 to 0.5"),
        ("wheel_radius", (45.0,), "wheel_radius refused: 1 or 2 numbers from 0.005 to 0.5"),
        ("wheel_radius", (0.045, 0.045, 0.045), "wheel_radius refused: 1 or 2 numbers from 0.005 to 0.5"),
        ("ticks_per_turn", (0.0,), "ticks_per_turn refused: 1 or 2 numbers from 1.000 to 100000.0"),
        ("wheel_separation", (0.2, 0.2), "wheel_separation refused: 1 number from 0.020 to 5.0"),
        ("wheel_separation", (0.0,), "wheel_separation refused: 1 number from 0.020 to 5.0"),
    ],
)
def test_impossible_wheel_parameters_are_refused(name: str, values: tuple[float, ...], text: str) -> None:
    with robot() as firmware:
        track = Track(firmware)
        assert configured(track, {name: Parameter(floats=values)}) == [text]
        track.run(2.0, velocity(0.2, 0.0))
        truth_m = sum(motor.rolled_ticks for motor in track.motors) / 2 * METRES_PER_TICK
        assert firmware.pose[0] == pytest.approx(truth_m, abs=0.01)


def test_whole_numbers_of_the_host_are_numbers() -> None:
    with robot() as firmware:
        track = Track(firmware)
        texts = configured(track, {"ticks_per_turn": Parameter(ints=(230, 460))})
        assert texts == ["wheel radius 45.000 and 45.000 mm, 210.00 mm apart", "ticks a turn 230.000 and 460.000"]


def test_robot_does_not_wait_for_missing_parameters() -> None:
    with robot() as firmware:
        firmware.feed(TOPICS_REQUEST)
        world = Firmware().world
        for turn in range(3000):
            if turn % 20 == 0:
                firmware.feed(velocity(0.2, 0.0))
            world.turn_motors(*firmware.pwm, PASS_S, 1)
            firmware.loop(1.0 + turn * PASS_S, world.left.edges, world.right.edges)
        sent = firmware.sent()
        assert sum(frame.topic_id == Id.PARAMETER for frame in sent) == 1
        assert "no answer to wheel_radius: no more questions" in logged(sent)
        assert firmware.pwm[0] > 0


@pytest.mark.parametrize("pass_s", [0.001, 0.017, 0.032, 0.15])
def test_speed_with_an_irregular_loop_is_measured_over_the_time_that_passed(pass_s: float) -> None:
    with robot() as firmware:
        now_s, observed = 1.0, []
        firmware.feed(TOPICS_REQUEST)
        while now_s < 9.0:
            now_s += pass_s
            firmware.loop(now_s, int(now_s * 200), int(now_s * 200))  # two edges a tick
            observed += [struct.unpack("<6d", frame.payload)[0] for frame in firmware.sent() if frame.topic_id == 126]
        late = observed[len(observed) // 2 :]
        assert sum(late) / len(late) == pytest.approx(100.0, rel=0.03)


@pytest.mark.parametrize("gains", [(math.nan, 0.0, 0.0), (1.0, math.inf, 0.0), (1.0, 1.0, -0.1)])
def test_invalid_gains_are_refused(gains: tuple[float, float, float]) -> None:
    with robot() as firmware:
        firmware.feed(TOPICS_REQUEST + encode(102, struct.pack("<3d", *gains)))
        now_s = 1.0
        for step in range(1000):
            now_s += 0.002
            if step % 20 == 0:
                firmware.feed(encode(100, struct.pack("<6d", 0.3, 0, 0, 0, 0, 0)))
            firmware.loop(now_s, 0, 0)
        assert min(firmware.pwm) > 3800  # the wheels are blocked


def test_late_answer_is_not_used_for_another_parameter() -> None:
    with robot() as firmware:
        firmware.feed(TOPICS_REQUEST)
        now_s = 1.0
        for _ in range(800):  # 1.6 s
            now_s += 0.002
            firmware.loop(now_s, 0, 0)
        firmware.feed(encode(Id.PARAMETER, encode_parameter(Parameter(floats=(0.045,)))))  # the wheel's radius
        for step in range(100):
            now_s += 0.002
            firmware.loop(now_s, 0, 2 * step)
        turned_rad = 99 * 2 * math.pi * 0.045 / 230.4 / 0.210
        assert firmware.pose[2] == pytest.approx(turned_rad, rel=0.2)


def test_robot_logs_stops_refusals_and_errors_of_the_link() -> None:
    with robot() as firmware:
        track = Track(firmware)
        track.run(2.0, velocity(0.3, 0.0))
        track.run(1.0)
        track.run(0.2, velocity(0.0, 0.0))
        track.run(1.0)
        assert logged(track.frames).count("no command for 500 ms: stopped") == 1  # a stopped robot needs no commands
        firmware.feed(velocity(math.nan, 0.0))
        firmware.feed(encode(103, struct.pack("<3d", -1.0, 0.0, 0.0)))
        firmware.feed(encode(102, struct.pack("<3d", 20.0, 30.5, 0.125)))
        track.run(0.1)
        assert logged(track.frames)[-3:] == [
            "a velocity that is no number: stopped",
            "right gains refused: each is 0 or more",
            "left Kp 20.00 Ki 30.50 Kd 0.125",
        ]
        firmware.feed(b"\xff\x00" + encode(99, b""))
        track.run(11.0)
        trouble = [text for text in logged(track.frames) if text.startswith("link:")]
        assert trouble == ["link: false starts of frames 3, frames refused 0, not sent 0"]


def test_a_line_that_dribbles_does_not_keep_the_paper_s_clause_from_stopping() -> None:
    """One byte every 8 ms: each ends one wait and begins the next, so that the turn does not end for seconds."""
    with robot(Retry.PAPER) as firmware:
        track = Track(firmware)
        track.run(2.0, velocity(0.3, 0.0))
        assert firmware.pwm[0] > 0
        for byte in encode(100, bytes(480))[:80]:
            firmware.feed(bytes([byte]))
            track.now_s += 0.008
            firmware.loop(track.now_s, *track.edges)
        assert firmware.pwm == (0, 0)
