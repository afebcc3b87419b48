"""Board: a device of the simulated world. It obeys velocities, tells its pose, counts, and connects again."""

import math
import random
import struct
from collections.abc import Callable

from hostlink.core.protocol.endpoint import EndpointKind
from hostlink.core.protocol.rosserial.control import encode_topic_info
from hostlink.core.protocol.rosserial.frame import HEADER, Frame, Id, encode
from hostlink.core.protocol.rosserial.protocol import ROSSERIAL
from hostlink.core.protocol.rosserial.stream import FrameStream
from hostlink.core.protocol.session import DeviceProtocol
from tests.support.fake_device import topic
from tests.support.simulation.clock import WorldLoop
from tests.support.simulation.journal import Counted, Journal, Obeyed, Rebooted
from tests.support.simulation.wire import Connection

POSE_ID, COUNT_ID, VELOCITY_ID, TEXT_ID = 125, 126, 100, 101
TWIST, POSE, NUMBER = struct.Struct("<6d"), struct.Struct("<3d"), struct.Struct("<I")
TIME_S = 2.5  # between two requests for the time
WATCHDOG_S = 0.5
DEAF_S = 11.0  # without a time answer: the host is gone

Dial = Callable[["Board"], Connection | None]


class Board:
    """rosserial's device side: announces its topics when it is asked, requests the time, and says no more than that."""

    protocol: DeviceProtocol = ROSSERIAL
    least_velocities = 10  # that it gets in a short ride
    held_s = 0.0  # as in Opened

    @staticmethod
    def velocities_in(data: bytes) -> list[bytes]:
        """Return the velocities in what is written to a board."""
        found, start = [], data.find(b"\xff\xfe")
        while 0 <= start <= len(data) - HEADER.size:
            _, size_bytes, _, topic_id = HEADER.unpack_from(data, start)
            begin = start + HEADER.size
            if topic_id == VELOCITY_ID and size_bytes == TWIST.size:
                found.append(data[begin : begin + size_bytes])
            start = data.find(b"\xff\xfe", begin + size_bytes + 1)
        return found

    def __init__(self, loop: WorldLoop, journal: Journal, dial: Dial, number: int, dice: random.Random) -> None:
        self.name, self.address = f"robot_{number}", f"10.0.0.{number + 2}"
        self.is_present = True
        self.velocity = (0.0, 0.0)  # m/s, rad/s
        self._loop, self._journal, self._dial, self._dice = loop, journal, dial, dice
        self.has_watchdog = dice.random() < 0.5
        self._pose_s, self._count_s = dice.choice((0.05, 0.1)), dice.choice((0.05, 0.1, 0.25))
        self._reconnect_s = (0.1, 1.5)
        self.topics = [
            topic(EndpointKind.PUBLISHER, POSE_ID, f"/{self.name}/odometry", "geometry_msgs/Pose2D"),
            topic(EndpointKind.PUBLISHER, COUNT_ID, f"/{self.name}/count", "std_msgs/UInt32"),
            topic(EndpointKind.SUBSCRIBER, VELOCITY_ID, f"/{self.name}/velocity_commands", "geometry_msgs/Twist"),
            topic(EndpointKind.SUBSCRIBER, TEXT_ID, f"/{self.name}/text", "std_msgs/UInt32"),
        ]
        self.connection: Connection | None = None
        self._stream = FrameStream()
        self._is_configured = self._is_hung = False
        self._pose = (0.0, 0.0, 0.0)
        self._moved_s = self._obeyed_s = self._time_s = 0.0
        self._count = 0
        self._life = 0  # of its program: what an earlier one has planned is not done

    def start(self) -> None:
        """Switch it on."""
        self._life += 1
        self._is_configured = self._is_hung = False
        self._drive(0.0, 0.0)
        self._pose = (0.0, 0.0, 0.0)
        life = self._life
        self._repeat(self._pose_s, self._tell_pose, life)
        self._repeat(self._count_s, self._tell_count, life)
        self._repeat(TIME_S, self._request_time, life)
        self._loop.after(self._dice.uniform(0.0, 0.5), self._connect, life)

    def reboot(self, *, keeps_connection: bool) -> None:
        """Power off and on; its radio may keep the connection."""
        self._journal.add(Rebooted(self._loop.world_s, self.name))
        if not keeps_connection:
            self._hang_up()
        self._stream = FrameStream()
        self.start()

    def leave(self) -> None:
        """Switch it off for good."""
        self.is_present = False
        self._life += 1
        self._hang_up()

    def hang(self, seconds: float) -> None:
        """Stop its program and its line for a time."""
        self._is_hung = True
        self._loop.after(seconds, self._go_on)
        if self.connection is not None:
            self.connection.stall(seconds)

    # -- the connection -----------------------------------------------------------------------------------------------

    def receive(self, data: bytes) -> None:
        """Read bytes of the host."""
        for item in self._stream.feed(data):
            if isinstance(item, Frame):
                self._read(item)

    def lose_connection(self) -> None:
        """Connect again, as passthroughs do."""
        self.connection = None
        if self.is_present:
            self._is_configured = False
            self._loop.after(self._dice.uniform(*self._reconnect_s), self._connect, self._life)

    def _connect(self, life: int) -> None:
        if life != self._life or self.connection is not None:
            return
        self._stream = FrameStream()
        self.connection = self._dial(self)
        if self.connection is None:
            self._loop.after(self._dice.uniform(*self._reconnect_s), self._connect, life)

    def _hang_up(self) -> None:
        connection, self.connection = self.connection, None
        if connection is not None:
            connection.close()

    # -- its program --------------------------------------------------------------------------------------------------

    def _read(self, frame: Frame) -> None:
        match frame.topic_id:
            case Id.PUBLISHER:
                self._send(encode(Id.TIME, bytes(8)))
                self._send(b"".join(encode(info.kind, encode_topic_info(info)) for info in self.topics))
                self._is_configured, self._time_s = True, self._loop.world_s
            case Id.TIME:
                self._time_s = self._loop.world_s
            case Id.STOP:
                self._is_configured = False
            case topic_id if topic_id == VELOCITY_ID and len(frame.payload) == TWIST.size:
                self._obey(frame.payload)
            case topic_id if topic_id == TEXT_ID and len(frame.payload) == NUMBER.size:
                self._count_text(frame.payload)

    def _obey(self, payload: bytes) -> None:
        linear, *_, angular = TWIST.unpack(payload)
        self._obeyed_s = self._loop.world_s
        self._drive(linear, angular)
        if self.has_watchdog:
            self._loop.after(WATCHDOG_S + 1e-6, self._watch, self._life)

    def _count_text(self, payload: bytes) -> None:
        number = self.connection.number if self.connection is not None else 0
        self._journal.add(Counted(self._loop.world_s, number, f"text {self.name}", *NUMBER.unpack(payload)))

    def _watch(self, life: int) -> None:
        if life == self._life and self._loop.world_s >= self._obeyed_s + WATCHDOG_S and any(self.velocity):
            self._drive(0.0, 0.0)

    def _drive(self, linear_m_s: float, angular_rad_s: float) -> None:
        self._move()
        if (linear_m_s, angular_rad_s) != self.velocity:
            self._journal.add(Obeyed(self._loop.world_s, self.name, linear_m_s, angular_rad_s))
        self.velocity = (linear_m_s, angular_rad_s)

    def _move(self) -> None:
        (x, y, theta), (linear, angular) = self._pose, self.velocity
        step_s, self._moved_s = self._loop.world_s - self._moved_s, self._loop.world_s
        self._pose = (
            x + linear * math.cos(theta) * step_s,
            y + linear * math.sin(theta) * step_s,
            theta + angular * step_s,
        )

    def _tell_pose(self) -> None:
        self._move()
        self._publish(POSE_ID, POSE.pack(*self._pose))

    def _tell_count(self) -> None:
        if self._publish(COUNT_ID, NUMBER.pack(self._count)):
            self._count += 1

    def _request_time(self) -> None:
        if self._loop.world_s > self._time_s + DEAF_S:
            self._is_configured = False
        self._publish(Id.TIME, bytes(8))

    def _publish(self, topic_id: int, payload: bytes) -> bool:
        return self._is_configured and not self._is_hung and self._send(encode(topic_id, payload))

    def _send(self, data: bytes) -> bool:
        if self.connection is not None:
            self.connection.send(data)
        return self.connection is not None

    def _repeat(self, interval_s: float, act: Callable[[], object], life: int) -> None:
        def turn() -> None:
            if life == self._life:
                act()
                self._loop.after(interval_s, turn)

        self._loop.after(self._dice.uniform(0.0, interval_s), turn)

    def _go_on(self) -> None:
        self._is_hung = False
