"""KinematicRobot: a simulated robot of any drive. Its wheels turn as told, within their speed and acceleration.

It has no motors, no slip and no UART: what the firmware's world has. Pure: time is an argument.
"""

import math
from struct import Struct

from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind
from hostlink.core.protocol.rosserial.control import encode_topic_info
from hostlink.core.protocol.rosserial.frame import FIRST_TOPIC_ID, Frame, Id, encode
from hostlink.core.protocol.rosserial.stream import FrameStream
from hostlink.core.robot.kinematics import (
    AckermannDrive,
    Drive,
    MecanumDrive,
    Omni4Drive,
    OmniDrive,
    Pose,
    SkidSteerDrive,
    Steering,
)
from hostlink.core.robot.ros_messages import POSE_VARIANCES, TWIST_VARIANCES, covariance_of
from hostlink.core.robot.velocity import PlanarVelocity, Twist
from hostlink.workbench.sim.board import SimulatedBoard

DRIVES: dict[str, Drive] = {  # of a robot as large as a box of shoes
    "skid_steer": SkidSteerDrive(wheel_separation_m=0.24, separation_factor=1.5),
    "mecanum": MecanumDrive(wheel_separation_m=0.24, wheelbase_m=0.20),
    "omni3": OmniDrive(wheel_distance_m=0.14),
    "omni4": Omni4Drive(wheel_distance_m=0.14),
    "ackermann": AckermannDrive(wheelbase_m=0.26, max_steering_rad=0.42, wheel_separation_m=0.2),
}
MAX_WHEEL_M_S = 0.8
MAX_WHEEL_M_S2 = 2.0
STEP_S = 0.01
ODOMETRY_STEPS = 5  # 20 Hz
WATCHDOG_S = 0.5  # without a velocity the board stops
TIME_INTERVAL_S = 2.5  # of requests for the time, as in rosserial's library
SILENCE_S = 11.0  # without an answer the board has lost its host
LONGEST_S = 1.0  # a later call does not make up for more

TWIST_ID, ACKERMANN_ID, ODOMETRY_ID = FIRST_TOPIC_ID, FIRST_TOPIC_ID + 1, FIRST_TOPIC_ID + 25
BUFFER_BYTES = 1024
TWIST_MD5, TWIST_BYTES = "9f195f881246fdfa2798d1d3eebca84a", 48
ACKERMANN = Struct("<5f")  # steering_angle, its velocity, speed, acceleration, jerk
ACKERMANN_MD5 = "3512e91b48d69674a0e86fadf1ea8231"
ODOMETRY_MD5 = "cd5e73d190d741a2f92e81eda573aca7"
_STAMP = Struct("<III")  # sequence number, seconds, nanoseconds
_TIME = Struct("<II")
_POSE = Struct("<7d")
_COVARIANCE = Struct("<36d")
_OF_POSE = _COVARIANCE.pack(*covariance_of(POSE_VARIANCES))
_OF_TWIST = _COVARIANCE.pack(*covariance_of(TWIST_VARIANCES))
_NS = 1_000_000_000


class KinematicRobot(SimulatedBoard):
    """Board with `<name>/cmd_vel` (Twist) and `<name>/odom` (Odometry); a car also has `<name>/ackermann_cmd`.

    What is impossible for the drive it leaves out, as a real one does: y, or a turn in place.
    """

    def __init__(self, name: str, drive: Drive, *, clock_rate: float = 1.0) -> None:
        """Switch the robot on. `clock_rate`: seconds of its clock per second."""
        self.name, self.drive = name, drive
        self.pose = Pose()
        self.wheels_m_s = (0.0,) * len(drive.wheels)
        self._clock_rate = clock_rate
        self._began_s: float | None = None
        self._steps = 0
        self._start()

    def _start(self) -> None:
        """Begin as after switching on; the robot stays where it is, and its wheels turn on."""
        self.origin, self._odometry = self.pose, Pose()
        self._target = PlanarVelocity()
        self._stream = FrameStream()
        self._sent = bytearray()
        self._sequence = 0
        self._is_configured = False
        self._commanded_s = self._asked_s = self._heard_s = -math.inf
        self._offset_ns = 0  # of the host's clock

    @property
    def is_configured(self) -> bool:
        """Whether the host has asked for the topics, and answers."""
        return self._is_configured

    @property
    def quiet_s(self) -> float:
        """Time to the next step."""
        return STEP_S

    @property
    def _clock_s(self) -> float:
        """Time of the board since it was switched on."""
        return self._steps * STEP_S * self._clock_rate

    def send(self, data: bytes) -> None:
        """Pass bytes from the host to the board."""
        for found in self._stream.feed(data):
            if isinstance(found, Frame):
                self._receive(found)

    def cut(self) -> None:
        """Drop the bytes on the line in both directions."""
        self._stream = FrameStream()
        self._sent.clear()

    def reboot(self) -> None:
        """Switch the board off and on. Its odometry begins anew where it is."""
        self._start()

    def advance(self, now_s: float) -> bytes:
        """Run the board up to `now_s`. Return the bytes that it sent since the last call."""
        if self._began_s is None:
            self._began_s = now_s
        due = math.floor((now_s - self._began_s) / STEP_S + 1e-6) - self._steps
        if due * STEP_S > LONGEST_S:  # the program was paused
            self._began_s += due * STEP_S - LONGEST_S
            due = round(LONGEST_S / STEP_S)
        for _ in range(due):
            self._step()
        sent = bytes(self._sent)
        self._sent.clear()
        return sent

    def _receive(self, frame: Frame) -> None:
        if frame.topic_id == Id.PUBLISHER:
            for info in self._topics():
                self._sent += encode(info.kind, encode_topic_info(info))
            self._is_configured, self._heard_s = True, self._clock_s
        elif frame.topic_id == Id.TIME and len(frame.payload) == _TIME.size:
            seconds, nanoseconds = _TIME.unpack(frame.payload)
            self._offset_ns = seconds * _NS + nanoseconds - round(self._clock_s * _NS)
            self._heard_s = self._clock_s
        elif frame.topic_id == Id.STOP:
            self._is_configured, self._target = False, PlanarVelocity()
        elif frame.topic_id == TWIST_ID and len(frame.payload) == TWIST_BYTES:
            self._command(Twist.decode(frame.payload).planar)
        elif (
            frame.topic_id == ACKERMANN_ID
            and len(frame.payload) == ACKERMANN.size
            and isinstance(self.drive, AckermannDrive)
        ):
            angle_rad, _, speed_m_s, _, _ = ACKERMANN.unpack(frame.payload)
            if math.isfinite(angle_rad):
                self._command(self.drive.velocity_of(Steering(speed_m_s, angle_rad)))

    def _command(self, velocity: PlanarVelocity) -> None:
        if not velocity.is_finite:
            return
        if not self.drive.has_y:
            velocity = velocity._replace(y_m_s=0.0)
        self._target = self.drive.limited(self.drive.possible(velocity), MAX_WHEEL_M_S)
        self._commanded_s = self._clock_s

    def _topics(self) -> list[DeviceEndpoint]:
        topics = [
            DeviceEndpoint(
                EndpointKind.PUBLISHER,
                ODOMETRY_ID,
                f"{self.name}/odom",
                "nav_msgs/Odometry",
                ODOMETRY_MD5,
                BUFFER_BYTES,
            ),
            DeviceEndpoint(
                EndpointKind.SUBSCRIBER,
                TWIST_ID,
                f"{self.name}/cmd_vel",
                "geometry_msgs/Twist",
                TWIST_MD5,
                BUFFER_BYTES,
            ),
        ]
        if isinstance(self.drive, AckermannDrive):
            name, type_name = f"{self.name}/ackermann_cmd", "ackermann_msgs/AckermannDrive"
            topics.append(
                DeviceEndpoint(EndpointKind.SUBSCRIBER, ACKERMANN_ID, name, type_name, ACKERMANN_MD5, BUFFER_BYTES)
            )
        return topics

    def _step(self) -> None:
        self._steps += 1
        now_s = self._clock_s
        if now_s >= self._commanded_s + WATCHDOG_S:
            self._target = PlanarVelocity()
        self._drive_on()
        if now_s >= self._asked_s + TIME_INTERVAL_S:
            self._asked_s = now_s
            self._sent += encode(Id.TIME, b"")
        if self._is_configured and now_s >= self._heard_s + SILENCE_S:
            self._is_configured = False
        if self._is_configured and self._steps % ODOMETRY_STEPS == 0:
            self._sent += encode(ODOMETRY_ID, self._encode_odometry())

    def _drive_on(self) -> None:
        """Turn the wheels for a step; all change their speed by the same share, which keeps the body on its line."""
        wanted = self.drive.wheel_speeds(self._target)
        missing = max(abs(there - here) for here, there in zip(self.wheels_m_s, wanted, strict=True))
        share = 1.0 if missing <= MAX_WHEEL_M_S2 * STEP_S else MAX_WHEEL_M_S2 * STEP_S / missing
        self.wheels_m_s = tuple(
            [here + (there - here) * share for here, there in zip(self.wheels_m_s, wanted, strict=True)]
        )
        rolled = [speed_m_s * STEP_S for speed_m_s in self.wheels_m_s]
        self.pose = self.drive.integrate(self.pose, rolled)
        self._odometry = self.drive.integrate(self._odometry, rolled)

    def _encode_odometry(self) -> bytes:
        seconds, nanoseconds = divmod(self._offset_ns + round(self._clock_s * _NS), _NS)
        self._sequence += 1
        pose, half_rad = self._odometry, self._odometry.theta_rad / 2
        return b"".join(
            (
                _STAMP.pack(self._sequence, seconds, nanoseconds),
                _text(f"{self.name}/odom"),
                _text(f"{self.name}/base_link"),
                _POSE.pack(pose.x_m, pose.y_m, 0.0, 0.0, 0.0, math.sin(half_rad), math.cos(half_rad)),
                _OF_POSE,
                self.drive.velocity(self.wheels_m_s).encode(),
                _OF_TWIST,
            )
        )


def _text(text: str) -> bytes:
    encoded = text.encode()
    return len(encoded).to_bytes(4, "little") + encoded
