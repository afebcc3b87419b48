"""OriginalDevice: the device side of rosserial, with the faults of the original client library. Pure.

Timing model: the device's program calls `spin` in its loop. The clock that decides is read once, when `spin` begins, in
whole milliseconds, as the original does; bytes are visible when the Uart has them. Where the retry clause waits, `spin`
returns how long; the caller calls it again after that time, and it continues in the same turn. All times are arguments.
"""

import math
from collections.abc import Callable
from enum import Enum, auto

from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind
from hostlink.core.protocol.events import Parameter
from hostlink.core.protocol.rosserial.control import Log, decode_parameter, encode_topic_info
from hostlink.core.protocol.rosserial.frame import FIRST_TOPIC_ID, OVERHEAD_BYTES, Id, encode
from tests.support.device_codec import decode_time, encode_log, encode_parameter_request
from tests.support.uart import BoardUart

# All of the original library (docs/protocol.md#timing).
FRAME_TIMEOUT_MS = 20
TIME_INTERVAL_MS = 2500
HOST_TIMEOUT_MS = 11_000
RETRY_S = 0.010  # the paper's clause
MAX_SUBSCRIBERS = 25
DEFAULT_BUFFER_BYTES = 512


class Mode(Enum):
    """Meaning of the next byte."""

    FIRST_FF = auto()
    PROTOCOL_VERSION = auto()
    SIZE_LOW = auto()
    SIZE_HIGH = auto()
    SIZE_CHECKSUM = auto()
    TOPIC_LOW = auto()
    TOPIC_HIGH = auto()
    MESSAGE = auto()
    MESSAGE_CHECKSUM = auto()


class DeviceCrashed(Exception):
    """The host sent a frame that writes outside the device's memory."""


class OriginalDevice(BoardUart):
    """One device on a UART. Its endpoints get the ids that the original library gives them.

    | mode              | byte                          | next                                             |
    |-------------------|-------------------------------|--------------------------------------------------|
    | FIRST_FF          | FF                            | PROTOCOL_VERSION, and 20 ms from now to finish   |
    | PROTOCOL_VERSION  | FE                            | SIZE_LOW                                         |
    |                   | another                       | FIRST_FF; requests the time if not configured |
    | SIZE_CHECKSUM     | wrong                         | FIRST_FF                                         |
    | MESSAGE_CHECKSUM  | right                         | the frame is acted upon; FIRST_FF                |
    | any but FIRST_FF  | `spin` begins after the 20 ms | FIRST_FF: the rest is read as garbage            |
    """

    def __init__(
        self,
        *,
        baud: int | None = 38400,
        retries: bool = True,
    ) -> None:
        """`retries`: with the paper's retry clause."""
        super().__init__(baud=baud)
        self.is_configured = False
        self.dropped_frames = 0
        self.frames = 0
        self._retries = retries
        self._from_device: list[DeviceEndpoint] = []
        self._to_device: list[tuple[DeviceEndpoint, Callable[[bytes], None]]] = []
        self._parameter: Callable[[Parameter], None] | None = None
        self._mode = Mode.FIRST_FF
        self._size = self._topic_id = self._checksum = 0
        self._message = bytearray()
        self._began_ms = 0
        self._is_spinning = self._is_retrying = False
        self._frame_deadline_ms = 0
        self._time_requested_ms = self._time_received_ms = 0
        self._time_sent_ms = 0
        self._offset_ns = 0

    # -- the program's side -------------------------------------------------------------------------------------------

    def advertise(self, name: str, type_name: str, md5: str) -> int:
        """Announce something that the device sends; returns its id."""
        topic_id = FIRST_TOPIC_ID + MAX_SUBSCRIBERS + len(self._from_device)
        self._from_device.append(
            DeviceEndpoint(EndpointKind.PUBLISHER, topic_id, name, type_name, md5, DEFAULT_BUFFER_BYTES)
        )
        return topic_id

    def subscribe(self, name: str, type_name: str, md5: str, callback: Callable[[bytes], None]) -> int:
        """Announce a topic that the device subscribes to; returns its id."""
        topic_id = FIRST_TOPIC_ID + len(self._to_device)
        self._to_device.append(
            (DeviceEndpoint(EndpointKind.SUBSCRIBER, topic_id, name, type_name, md5, DEFAULT_BUFFER_BYTES), callback)
        )
        return topic_id

    def publish(self, topic_id: int, payload: bytes, now_s: float) -> bool:
        """Send a message; False when it is dropped: not configured, or over the buffer."""
        if topic_id >= FIRST_TOPIC_ID and not self.is_configured:
            return False
        if len(payload) + OVERHEAD_BYTES > DEFAULT_BUFFER_BYTES:
            return False
        self.to_host.send(encode(topic_id, payload), now_s)
        return True

    def log(self, level: int, text: str, now_s: float) -> None:
        """Send a line to the host's log."""
        self.publish(Id.LOG, encode_log(Log(level, text)), now_s)

    def request_time(self, now_s: float) -> None:
        """Request the time: also what a device may begin with where nothing connects."""
        self.publish(Id.TIME, bytes(8), now_s)
        self._time_sent_ms = self._ms(now_s)

    def request_parameter(self, name: str, answer: Callable[[Parameter], None], now_s: float) -> None:
        """Request a parameter. The original waits a second for it; here the program continues."""
        self._parameter = answer
        self.publish(Id.PARAMETER, encode_parameter_request(name), now_s)

    def wall_ns(self, now_s: float) -> int:
        """The host's time as this device knows it: the round trip is added whole, as the original does."""
        return self._offset_ns + self._ms(now_s) * 1_000_000

    def reboot(self) -> None:
        """Power off and on: all that was known of the host is gone."""
        self.from_host.cut()
        self.to_host.cut()
        self.is_configured = False
        self._mode = Mode.FIRST_FF
        self._is_spinning = self._is_retrying = False

    # -- spinOnce -----------------------------------------------------------------------------------------------------

    def spin(self, now_s: float) -> float | None:
        """One turn of spinOnce; None when it is done, else call again after so many seconds. DeviceCrashed."""
        if not self._is_spinning:
            self._is_spinning, self._is_retrying = True, False
            self._began_ms = self._ms(now_s)
            if self._began_ms - self._time_received_ms > HOST_TIMEOUT_MS:
                self.is_configured = False
            if self._mode is not Mode.FIRST_FF and self._began_ms > self._frame_deadline_ms:
                self._drop_frame()
        while True:
            byte = self.from_host.read(now_s)
            if byte is None:
                if self._retries and self._mode is not Mode.FIRST_FF and not self._is_retrying:
                    self._is_retrying = True
                    return RETRY_S
                break
            self._is_retrying = False
            if self._receive_byte(byte, now_s):
                break
        self._is_spinning = False
        if self.is_configured and self._began_ms - self._time_requested_ms > TIME_INTERVAL_MS:
            self.request_time(now_s)
            self._time_requested_ms = self._began_ms
        return None

    def _receive_byte(self, byte: int, now_s: float) -> bool:
        """Advance the state machine; True when this turn of spinOnce ends at this byte."""
        self._checksum += byte
        match self._mode:
            case Mode.MESSAGE:
                self._message.append(byte)
                if len(self._message) == self._size:
                    self._mode = Mode.MESSAGE_CHECKSUM
            case Mode.FIRST_FF:
                if byte == 0xFF:
                    self._mode = Mode.PROTOCOL_VERSION
                    self._frame_deadline_ms = self._began_ms + FRAME_TIMEOUT_MS
            case Mode.MESSAGE_CHECKSUM:
                return self._finish_frame(now_s)
            case _:
                self._receive_header_byte(byte, now_s)
        return False

    def _receive_header_byte(self, byte: int, now_s: float) -> None:
        match self._mode:
            case Mode.PROTOCOL_VERSION:
                self._mode = Mode.SIZE_LOW
                if byte != 0xFE:
                    self._mode = Mode.FIRST_FF
                    if not self.is_configured:
                        self.request_time(now_s)
            case Mode.SIZE_LOW:
                self._size = self._checksum = byte
                self._message.clear()
                self._mode = Mode.SIZE_HIGH
            case Mode.SIZE_HIGH:
                self._size += byte << 8
                self._mode = Mode.SIZE_CHECKSUM
            case Mode.SIZE_CHECKSUM:
                self._mode = Mode.TOPIC_LOW if self._checksum & 0xFF == 0xFF else Mode.FIRST_FF
            case Mode.TOPIC_LOW:
                self._topic_id = self._checksum = byte
                self._mode = Mode.TOPIC_HIGH
            case Mode.TOPIC_HIGH:
                self._topic_id += byte << 8
                self._mode = Mode.MESSAGE if self._size else Mode.MESSAGE_CHECKSUM
                if self._size > DEFAULT_BUFFER_BYTES:
                    raise DeviceCrashed(f"a message of {self._size} bytes into a buffer of {DEFAULT_BUFFER_BYTES}")

    def _drop_frame(self) -> None:
        self._mode = Mode.FIRST_FF
        self.dropped_frames += 1

    def _finish_frame(self, now_s: float) -> bool:
        self._mode = Mode.FIRST_FF
        if self._checksum & 0xFF != 0xFF:
            self.dropped_frames += 1
            return False
        self.frames += 1
        payload = bytes(self._message)
        match self._topic_id:
            case Id.PUBLISHER:
                self.request_time(now_s)
                self._announce_topics(now_s)
                self._time_requested_ms = self._time_received_ms = self._began_ms
                return True
            case Id.TIME:
                self._set_time(payload, now_s)
            case Id.PARAMETER:
                self._receive_parameter(payload)
            case Id.STOP:
                self.is_configured = False
            case topic_id:
                self._call_back(topic_id, payload)
        return False

    def _call_back(self, topic_id: int, payload: bytes) -> None:
        number = topic_id - FIRST_TOPIC_ID
        if not 0 <= number < len(self._to_device):
            raise DeviceCrashed(f"a message for id {topic_id}, which was never announced")
        self._to_device[number][1](payload)

    def _set_time(self, payload: bytes, now_s: float) -> None:
        wall_ns = decode_time(payload)
        now_ms = self._ms(now_s)
        self._offset_ns = wall_ns + (now_ms - self._time_sent_ms) * 1_000_000 - now_ms * 1_000_000
        self._time_received_ms = now_ms

    def _announce_topics(self, now_s: float) -> None:
        for info in [*self._from_device, *(info for info, _ in self._to_device)]:
            self.to_host.send(encode(info.kind, encode_topic_info(info)), now_s)
        self.is_configured = True

    def _receive_parameter(self, payload: bytes) -> None:
        parameter = decode_parameter(payload)
        if parameter is not None and self._parameter is not None:
            answer, self._parameter = self._parameter, None
            answer(parameter)

    def _ms(self, now_s: float) -> int:
        return math.floor(now_s * 1000 + 1e-6)
