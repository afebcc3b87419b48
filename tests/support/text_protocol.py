"""A protocol of text lines, as an example for people who bring their own: docs/protocols.md.

| the device sends      | meaning                                                                   |
|-----------------------|---------------------------------------------------------------------------|
| HELLO car             | it is the robot `car`, with /car/cmd_vel and /car/pose                    |
| POSE 0.5 0 1.57       | its pose: m, m, rad                                                       |

| the host sends        | meaning                                                                   |
|-----------------------|---------------------------------------------------------------------------|
| HELLO?                | who are you? A device says HELLO again                                    |
| VEL 0.2 0             | drive at this velocity: m/s, rad/s                                        |
| BYE                   | the host ends                                                             |
"""

import math
import re
import struct
from collections.abc import Iterable

from hostlink.core.messages.catalog import Catalog
from hostlink.core.protocol import events
from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind
from hostlink.core.protocol.outbox import ControlFrames, Outbox, OutgoingFrame
from hostlink.core.protocol.session import DeviceProtocol, DeviceSession
from hostlink.errors import UnknownTopic, WrongType

HELLO = b"HELLO?\n"
LONGEST_LINE_BYTES = 256
_NAME = re.compile(r"[a-z][a-z0-9_]{0,30}", re.ASCII)
_TWIST, _POSE = struct.Struct("<6d"), struct.Struct("<3d")


class TextSession(DeviceSession):
    """The host's side of one connection."""

    def __init__(self, *, uart_bytes_s: int | None) -> None:
        super().__init__("text", Outbox(ControlFrames(lambda _: b"", HELLO, b"BYE\n"), uart_bytes_s=uart_bytes_s))
        self._topics: tuple[DeviceEndpoint, ...] = ()
        self._rest = b""  # of a line that is not complete

    def open(self, *, now_s: float) -> list[events.Event]:  # noqa: ARG002 - nothing is due later
        self.probe()
        return [events.TopicsRequested("connected")]

    def receive(self, data: bytes, *, now_s: float) -> list[events.Event]:
        self.counts.bytes_from_device += len(data)
        *lines, self._rest = (self._rest + data).split(b"\n")
        found: list[events.Event] = []
        for line in lines:
            if not self._read(line.decode(errors="replace").split(), now_s, found):
                self._skip(line + b"\n")
        if len(self._rest) > LONGEST_LINE_BYTES:
            self._skip(self._rest)
            self._rest = b""
        return found

    def _skip(self, data: bytes) -> None:
        self.counts.skipped_bytes += len(data)
        self.foreign = (self.foreign + data)[-LONGEST_LINE_BYTES:]

    def _read(self, words: list[str], now_s: float, found: list[events.Event]) -> bool:
        """Read one line. Return whether it is of this protocol."""
        match words:
            case ["HELLO", name] if _NAME.fullmatch(name):
                asked_at_s = self.device_clock.topics_answered(now_s)
                if asked_at_s is not None:
                    found.append(events.TopicsAnswered(asked_at_s))
                before, self._topics = (
                    self._topics,
                    (
                        DeviceEndpoint(EndpointKind.SUBSCRIBER, 0, f"/{name}/cmd_vel", "geometry_msgs/Twist"),
                        DeviceEndpoint(EndpointKind.PUBLISHER, 0, f"/{name}/pose", "geometry_msgs/Pose2D"),
                    ),
                )
                self.counts.negotiations += 1
                found.append(events.TopicsNegotiated(self._topics, is_changed=self._topics != before, gap_at=None))
            case ["POSE", *numbers] if self._topics and (pose := _floats(numbers, 3)):
                found.append(events.MessageReceived(self._topics[1], _POSE.pack(*pose)))
            case _:
                return False
        self.counts.frames_from_device += 1
        return True

    def tick(self, *, now_s: float) -> list[events.Event]:  # noqa: ARG002 - nothing is ever due
        return []

    def deadline_s(self) -> float:
        return math.inf

    @property
    def is_steady(self) -> bool:
        return True

    def probe(self) -> None:
        self.outbox.put_topics_request()

    def pop_frame(self, *, now_s: float, wall_ns: int) -> OutgoingFrame | None:
        outgoing = super().pop_frame(now_s=now_s, wall_ns=wall_ns)
        if outgoing is not None and outgoing.frame is HELLO:
            self.device_clock.topics_requested(now_s)
        return outgoing

    @property
    def topics(self) -> tuple[DeviceEndpoint, ...]:
        return self._topics

    def has(self, endpoint: DeviceEndpoint) -> bool:
        return endpoint in self._topics

    def announcement(self, endpoints: Iterable[DeviceEndpoint]) -> bytes:
        return b"".join(f"HELLO {each.name.split('/')[1]}\n".encode() for each in endpoints if each.is_to_device)

    def publish(
        self, topic: str, payload: bytes, *, depth: int = 1, is_urgent: bool = False, is_kept: bool = False
    ) -> None:
        endpoint = self.endpoint_of(topic, payload)
        if is_urgent:
            self.outbox.put_urgent(endpoint.id, _line(payload), is_kept=is_kept)
        else:
            self.outbox.put_command(endpoint.id, _line(payload), depth=depth)

    def endpoint_of(self, topic: str, payload: bytes) -> DeviceEndpoint:
        for each in self._topics:
            if each.is_to_device and each.name == topic:
                if len(payload) != _TWIST.size:
                    raise WrongType(topic, f"{_TWIST.size} bytes", f"{len(payload)} bytes")
                return each
        raise UnknownTopic("topic", topic, tuple(each.name for each in self._topics if each.is_to_device))

    def service_endpoint(self, service: str, payload: bytes) -> DeviceEndpoint:  # noqa: ARG002 - it has none
        raise UnknownTopic("service", service, ())

    def call(self, service: str, payload: bytes) -> None:
        self.service_endpoint(service, payload)

    def response_endpoint(self, request: DeviceEndpoint) -> DeviceEndpoint:
        raise UnknownTopic("endpoint for responses", request.name)

    def respond(self, response: DeviceEndpoint, payload: bytes | None) -> None: ...  # it calls nothing

    def room_bytes(self, endpoint: DeviceEndpoint) -> int:  # noqa: ARG002 - of every endpoint
        return _TWIST.size

    def answer_parameter(self, name: str, parameter: events.Parameter) -> None: ...  # it asks for none

    def send_zero(self, endpoint: DeviceEndpoint, payload: bytes, *, is_kept: bool = False) -> bool:
        if self.has(endpoint):
            self.outbox.put_urgent(endpoint.id, _line(payload), is_kept=is_kept)
        return self.has(endpoint)

    def zero_frames(self, endpoint: DeviceEndpoint, payload: bytes) -> tuple[bytes, ...]:  # noqa: ARG002 - there is one
        return (b"\n" + _line(payload),)  # a line may have been sent in part


class TextProtocol(DeviceProtocol):
    """Registered as `text` in the entry-point group `hostlink.protocols`."""

    name = "text"
    invitation = HELLO

    def session(
        self,
        catalog: Catalog,  # noqa: ARG002 - both types are known
        *,
        uart_bytes_s: int | None,
        max_topics: int,  # noqa: ARG002 - two
        is_lossy: bool,  # noqa: ARG002 - each line is said again
    ) -> DeviceSession:
        return TextSession(uart_bytes_s=uart_bytes_s)

    def is_greeting(self, data: bytes) -> bool:
        return data.startswith(b"HELLO ")


TEXT = TextProtocol()


def _line(payload: bytes) -> bytes:
    linear, *_, angular = _TWIST.unpack(payload)
    return f"VEL {linear:g} {angular:g}\n".encode()


def _floats(words: list[str], count: int) -> list[float] | None:
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        return None
    return numbers if len(numbers) == count else None
