"""SimulatedRobot: the firmware on its own board, in real time, and its faults. Pure: time is an argument."""

import math
from collections.abc import Callable, Container
from dataclasses import dataclass
from typing import Any

from hostlink.core.protocol.endpoint import EndpointKind
from hostlink.core.protocol.resampling import resample
from hostlink.core.protocol.rosserial.control import decode_topic_info, encode_topic_info
from hostlink.core.protocol.rosserial.frame import Frame, Id, byte_sum, encode
from hostlink.core.protocol.rosserial.stream import FrameStream
from hostlink.workbench.sim.board import SimulatedBoard
from hostlink.workbench.sim.firmware_module import WorldParameters
from hostlink.workbench.sim.firmware_world import Firmware, RobotKind, SimulatedWheel

# -- robot ------------------------------------------------------------------------------------------------------------

BAUD = 38400  # the paper's
PASS_MS = 1000  # longest step of the firmware

RUN_S = 3.0  # interval of the restarts of a faulty board


class SimulatedRobot(Firmware, SimulatedBoard):
    """Firmware in real time. `advance` runs the firmware up to a time and returns the bytes that left its UART.

    While nothing is sent to the robot, `quiet_s` may pass between two calls.
    """

    def __init__(
        self,
        name: str,
        *,
        world: WorldParameters | None = None,
        kind: RobotKind = RobotKind.PAPER,
        baud: int = BAUD,
        clock_rate: float = 1.0,
    ) -> None:
        """Switch the robot on. `baud` 0: bytes are transmitted at once. `clock_rate`: seconds of its clock per second.

        Raises:
            ConfigError: wasmtime is not installed, or has no library for this machine.
            ValueError: a number of the world has no such name, or is out of its range.
        """
        super().__init__(world, name=name, baud=baud, kind=kind)
        self.name = name
        self.set_clock(clock_rate)
        self._began_s: float | None = None
        self._passed_ms = 0

    @property
    def speed_m_s(self) -> float:
        """True forward speed."""
        return (self.world.left.speed_m_s + self.world.right.speed_m_s) / 2

    @property
    def quiet_s(self) -> float:
        """Time in which nothing leaves the UART unless the robot receives bytes; 0 while bytes are on the line."""
        return self.quiet_ms / 1000

    def advance(self, now_s: float) -> bytes:
        """Run the firmware up to `now_s`. Return the bytes that left the UART since the last call."""
        if self._began_s is None:
            self._began_s = now_s
        due_ms = math.floor((now_s - self._began_s) * 1000) - self._passed_ms
        sent = b""
        while due_ms > 0:
            ms = min(due_ms, PASS_MS)
            sent += self.run(ms)
            self._passed_ms += ms
            due_ms -= ms
        return sent


# -- faults -----------------------------------------------------------------------------------------------------------

_TEXT = b"left 12 right 13 battery 11.8 V\r\n"
_TWIST_BYTES = 48  # the payload of a Twist, without the frame around it
_READ_RATIO = 115200 / 57600  # the device at rosserial's usual rate, the reader at 115200
_BOOT_RATIO = 115200 / 74880
_BOOT_TEXT = (
    b"\r\n ets Jan  8 2013,rst cause:1, boot mode:(3,7)\r\n\r\nload 0x40100000, len 1384, room 16 \r\ntail 8\r\n"
    b"chksum 0x2d\r\ncsum 0x2d\r\nvbb28d4a3\r\n~ld\r\n"
)


def _in_protocol_1(frame: Frame) -> bytes:
    body = frame.topic_id.to_bytes(2, "little") + len(frame.payload).to_bytes(2, "little") + frame.payload
    return b"\xff\xff" + body + bytes([~byte_sum(body) & 0xFF])


def _at_another_speed(frame: Frame) -> bytes:
    return resample(encode(*frame), ratio=_READ_RATIO)


def _without(ids: Container[int]) -> Callable[[Frame], bytes]:
    return lambda frame: b"" if frame.topic_id in ids else encode(*frame)


def _announcing(kind: EndpointKind, **changes: Any) -> Callable[[Frame], bytes]:
    """Change what the announcements of topics of one kind say."""

    def transform(frame: Frame) -> bytes:
        info = decode_topic_info(kind, frame.payload) if frame.topic_id == kind else None
        return encode(*frame) if info is None else encode(kind, encode_topic_info(info._replace(**changes)))

    return transform


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """Fault of a robot. The default is a healthy robot."""

    transform: Callable[[Frame], bytes] = lambda frame: encode(*frame)  # changes each frame to the host
    at_power_up: bytes = b""  # bytes before the first frame
    clock_rate: float = 1.0  # seconds of the device's clock per second
    time_requests: int | None = None  # that are passed on; None: all
    runs_s: float | None = None  # interval of its restarts; None: it does not restart
    break_wheel: Callable[[SimulatedWheel], None] = lambda _: None  # fault of its left wheel


HEALTHY = Fault()
FAULTS = {
    "silence": Fault(transform=lambda _: b""),  # the device sends nothing
    "wrong_baud": Fault(transform=_at_another_speed),  # its UART is slower than its reader
    "protocol_1": Fault(transform=_in_protocol_1),  # a library of before 2013
    "text": Fault(transform=lambda frame: _TEXT + encode(*frame)),  # Serial.print between the frames
    "no_topics": Fault(transform=_without(range(Id.SERVICE_CLIENT_SUBSCRIBER + 1))),  # TopicInfos never come
    "wrong_md5": Fault(transform=_announcing(EndpointKind.PUBLISHER, md5="0" * 32)),  # an old definition of a message
    "time_stops": Fault(time_requests=1),  # its requests for the time end after the first
    "small_buffer": Fault(
        transform=_announcing(EndpointKind.SUBSCRIBER, buffer_bytes=_TWIST_BYTES)
    ),  # a frame of a Twist is longer
    "reboots": Fault(runs_s=RUN_S),  # starts anew every RUN_S seconds
    "boot_noise": Fault(at_power_up=resample(_BOOT_TEXT, ratio=_BOOT_RATIO)),  # an ESP8266's boot message
    "clock": Fault(clock_rate=4 / 3),  # a board of 16 MHz with a program for 12 MHz
    "stalled_wheel": Fault(break_wheel=lambda wheel: wheel.grip(0.0)),  # its left wheel is blocked
    "runaway_wheel": Fault(break_wheel=lambda wheel: wheel.break_driver()),  # its left motor's driver is broken
}


WHEEL_FAULTS = tuple(name for name, fault in FAULTS.items() if fault.break_wheel is not HEALTHY.break_wheel)


class FaultyLine:
    """Line from a device to its host that changes the bytes by a fault."""

    def __init__(self, fault: Fault) -> None:
        self._fault = fault
        self._stream = FrameStream()
        self._power_up = fault.at_power_up
        self._time_requests = 0

    def pass_on(self, data: bytes) -> bytes:
        """Return the bytes that the host receives for `data` from the device."""
        if self._fault is HEALTHY:
            return data
        frames = [item for item in self._stream.feed(data) if isinstance(item, Frame) and self._is_passed(item)]
        changed, self._power_up = self._power_up + b"".join(map(self._fault.transform, frames)), b""
        return changed

    def _is_passed(self, frame: Frame) -> bool:
        if frame.topic_id != Id.TIME:
            return True
        self._time_requests += 1
        return self._fault.time_requests is None or self._time_requests <= self._fault.time_requests
