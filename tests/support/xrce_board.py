"""A virtual micro-ROS board: a stock client library and a program on it, and a link between it and a session.

Written from the observed bytes of boards. It shares no code with hostlink/core/protocol/xrce. A program is a
generator: `received = yield until_s` waits for one message. The client does what client 3.0.1 does: it reads one
message a turn, postpones its HEARTBEAT with each message that arrives, and sends everything again that is not
acknowledged when an ACKNACK has a bit.
"""

import heapq
import itertools
import struct
from collections import deque
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass, field
from random import Random
from typing import Any

from hostlink.core.protocol.events import Event
from hostlink.core.protocol.xrce.session import XrceSession

Program = Generator[float, bytes | None, Any]

CREATE_CLIENT, CREATE, GET_INFO, DELETE, STATUS_AGENT, STATUS, INFO, WRITE, READ, DATA = range(10)
ACKNACK, HEARTBEAT, RESET, FRAGMENT, TIMESTAMP, TIMESTAMP_REPLY = range(10, 16)
HEARTBEAT_S = 0.1
TURNS_MAX = 10_000
PARTICIPANT, TOPIC, PUBLISHER, SUBSCRIBER, WRITER, READER, REQUESTER, REPLIER = range(1, 9)
BINARY, XML, REFERENCE = 3, 2, 1
TWIST = struct.Struct("<6d")


def padded(data: bytes, size: int = 4) -> bytes:
    return data + bytes(-len(data) % size)


def text(value: str, before: bytes = b"") -> bytes:
    """A string as CDR has it behind `before`, with its padding."""
    raw = value.encode() + b"\0"
    return padded(before) + struct.pack("<I", len(raw)) + raw


def sub(kind: int, payload: bytes, flags: int = 1) -> bytes:
    return struct.pack("<BBH", kind, flags, len(payload) & 0xFFFF) + payload


def submessages(body: bytes) -> Iterator[tuple[int, int, bytes]]:
    at = 0
    while at + 4 <= len(body):
        kind, flags, size = struct.unpack_from("<BBH", body, at)
        yield kind, flags, body[at + 4 : at + 4 + size]
        at += 4 + size + -size % 4


def ahead(first: int, second: int) -> int:
    """Distance from the first number to the second, as a signed 16-bit number."""
    return ((second - first + 0x8000) & 0xFFFF) - 0x8000


@dataclass
class Published:
    """One publication: when, for how long it blocked, and whether it was acknowledged."""

    at_s: float
    took_s: float
    is_done: bool


class Client:
    """The client library, without input and output: `sent` has what it sends."""

    def __init__(
        self, *, key: bytes, session: int = 0x81, mtu: int = 512, history: int = 4, has_reliable_input: bool = True
    ) -> None:
        self.key, self.session, self.mtu, self.history = key, session, mtu, history
        self.has_reliable_input = has_reliable_input
        self.now_s = 0.0
        self.sent: list[bytes] = []
        self.heartbeats = 0
        self.resent = 0
        self.old_acknacks = 0
        self.offset_ns: int | None = None
        self.is_synchronised = False
        self.statuses: dict[int, int] = {}
        self.agent_status: int | None = None
        self.pong: int | None = None
        self.taken: list[tuple[float, int, int, bytes]] = []  # time, object, request, payload
        self.on_data: Callable[[int, bytes], None] | None = None
        self._request = 9
        self.reset()

    def reset(self) -> None:
        """Begin all streams anew."""
        self.last_sent = self.last_acked = 0xFFFF
        self.slots: dict[int, bytes] = {}
        self.last_handled = self.last_announced = 0xFFFF
        self.kept: dict[int, bytes] = {}
        self.best_effort = 0
        self.last_best_effort = 0xFFFF
        self.tries, self.next_heartbeat_s = 0, float("inf")

    @property
    def room_bytes(self) -> int:
        """Longest body of a message. The client announces four bytes less than its transport takes."""
        return self.mtu - 4 - (8 if self.session < 0x80 else 4)

    def request(self) -> int:
        self._request += 1
        return self._request

    def send(self, stream: int, number: int, body: bytes, session: int | None = None) -> None:
        session = self.session if session is None else session
        self.sent.append(struct.pack("<BBH", session, stream, number) + (self.key if session < 0x80 else b"") + body)

    # -- listening ----------------------------------------------------------------------------------------------------

    def listen(self, timeout_s: float) -> Program:
        """Read one message, and send HEARTBEATs meanwhile. Return whether there was one."""
        until_s = self.now_s + timeout_s
        while True:
            if ahead(self.last_acked, self.last_sent) > 0:
                if self.tries == 0:
                    self.next_heartbeat_s, self.tries = self.now_s + HEARTBEAT_S, 1
                elif self.now_s >= self.next_heartbeat_s:
                    self.tries += 1
                    self.next_heartbeat_s += HEARTBEAT_S * 2**self.tries
                    self.heartbeats += 1
                    first = (self.last_acked + 1) & 0xFFFF
                    self.send(0, 0, sub(HEARTBEAT, struct.pack("<HHB", first, self.last_sent, 0x80)))
            else:
                self.next_heartbeat_s = float("inf")
            message = yield min(until_s, max(self.next_heartbeat_s, self.now_s + 0.001))
            if message is not None:
                self.tries = 0  # the fault that the host repairs
                self.read(message)
                return True
            if self.now_s >= until_s:
                return False

    def read(self, message: bytes) -> None:
        """Read one message of the host."""
        head = 8 if self.session < 0x80 else 4
        if len(message) <= 8 or message[0] != self.session or (head == 8 and message[4:8] != self.key):
            if message[:1] in (b"\x80", b"\0"):
                self._read_pong(message[8 if message[0] < 0x80 else 4 :])
            return
        _, stream, number = struct.unpack_from("<BBH", message)
        body = message[head:]
        if stream == 0:
            self._read_body(body)
        elif stream < 0x80:
            if ahead(self.last_best_effort, number) > 0:
                self.last_best_effort = number
                self._read_body(body)
        elif self.has_reliable_input:
            self._read_reliable(number, body)
            self._acknowledge()

    def _read_pong(self, body: bytes) -> None:
        for kind, _, payload in submessages(body):
            if kind == INFO:
                self.pong = payload[5]

    def _read_reliable(self, number: int, body: bytes) -> None:
        if 0 < ahead(self.last_handled, number) <= self.history and number not in self.kept:
            self.kept[number] = body
        if ahead(self.last_announced, number) > 0:
            self.last_announced = number
        while (first := (self.last_handled + 1) & 0xFFFF) in self.kept:
            if self.kept[first][0] != FRAGMENT:
                self.last_handled = first
                self._read_body(self.kept.pop(first))
                continue
            numbers = [first]
            while self.kept[numbers[-1]][1] & 2 == 0:
                numbers.append((numbers[-1] + 1) & 0xFFFF)
                if numbers[-1] not in self.kept or self.kept[numbers[-1]][0] != FRAGMENT:
                    return
            self.last_handled = numbers[-1]
            self._read_body(b"".join(self.kept.pop(each)[4:] for each in numbers))

    def _acknowledge(self) -> None:
        first = (self.last_handled + 1) & 0xFFFF
        while first in self.kept:
            first = (first + 1) & 0xFFFF
        missing = 0
        for place in range(max(ahead(first, self.last_announced) + 1, 0)):
            if (first + place) & 0xFFFF not in self.kept:
                missing |= 1 << place
        self.send(0, 0, sub(ACKNACK, struct.pack("<H", first) + struct.pack(">H", missing & 0xFFFF) + b"\x80"))

    def _read_body(self, body: bytes) -> None:
        for kind, _, payload in submessages(body):
            if kind == STATUS_AGENT:
                self.agent_status = payload[0]
            elif kind == STATUS:
                self.statuses[int.from_bytes(payload[:2], "big")] = payload[4]
            elif kind == DATA:
                request, object_id = struct.unpack_from(">HH", payload)
                self.taken.append((self.now_s, object_id, request, payload[4:]))
                if self.on_data is not None:
                    self.on_data(object_id, payload[4:])
            elif kind == HEARTBEAT and self.has_reliable_input and payload[4] == 0x80:
                first, last = int.from_bytes(payload[:2], "little"), int.from_bytes(payload[2:4], "little")
                if ahead((self.last_handled + 1) & 0xFFFF, first) > 0:  # what the host does not keep is given up
                    self.last_handled = (first - 1) & 0xFFFF
                if ahead(self.last_announced, last) > 0:
                    self.last_announced = last
                self._acknowledge()
            elif kind == ACKNACK and payload[4] == 0x80:
                self._read_acknack(int.from_bytes(payload[:2], "little"), int.from_bytes(payload[2:4], "big"))
            elif kind == TIMESTAMP_REPLY:
                sec, nsec, _, _, then_s, then_ns = struct.unpack("<iIiIiI", payload)
                there = sec * 10**9 + nsec
                here = (then_s * 10**9 + then_ns + round(self.now_s * 1e9)) // 2
                self.offset_ns, self.is_synchronised = here - there, True
            elif kind == INFO:
                self.pong = payload[5]

    def _read_acknack(self, first: int, missing: int) -> None:
        if self.agent_status != 0:
            return  # of the session before a restart; the streams begin when the client is created
        # A number that was never sent would move the client's history by thousands: the host must not acknowledge it.
        assert ahead(self.last_sent, first) <= 1, (self.last_sent, first)
        if ahead(self.last_acked, first) < 1:  # an older one: the client counts through all numbers
            self.old_acknacks += 1
            self.slots.clear()
            self.last_acked = (first - 1) & 0xFFFF
        while self.last_acked != (first - 1) & 0xFFFF:
            self.last_acked = (self.last_acked + 1) & 0xFFFF
            self.slots.pop(self.last_acked, None)
        self.tries = 0
        if missing:
            for number in sorted(self.slots, key=lambda each: ahead(self.last_acked, each)):
                self.resent += 1
                self.send(0x80, number, self.slots[number])

    # -- streams to the host ------------------------------------------------------------------------------------------

    def put(self, submessage: bytes) -> bool:
        """Send a submessage reliably, in fragments if it is long. Return whether the history has room."""
        bodies = [submessage]
        if len(submessage) > self.room_bytes:
            size = self.room_bytes - 4
            parts = [submessage[at : at + size] for at in range(0, len(submessage), size)]
            bodies = [sub(FRAGMENT, part, 3 if part is parts[-1] else 1) for part in parts]
        if len(self.slots) + len(bodies) > self.history:
            return False
        for body in bodies:
            self.last_sent = (self.last_sent + 1) & 0xFFFF
            self.slots[self.last_sent] = body
            self.send(0x80, self.last_sent, body)
        return True

    def put_best_effort(self, *bodies: bytes) -> None:
        self.send(1, self.best_effort, b"".join(map(padded, bodies)))
        self.best_effort = (self.best_effort + 1) & 0xFFFF

    def confirm(self, timeout_s: float) -> Program:
        """Wait until everything is acknowledged. Return whether it is."""
        until_s = self.now_s + timeout_s
        while ahead(self.last_acked, self.last_sent) > 0 and self.now_s < until_s:
            yield from self.listen(until_s - self.now_s)
        return self.last_acked == self.last_sent

    def publish(self, writer: int, payload: bytes, timeout_s: float = 1.0) -> Program:
        """rcl_publish of a reliable publisher."""
        began_s = self.now_s
        if not self.put(sub(WRITE, struct.pack(">HH", self.request(), writer) + payload)):
            yield from self.confirm(timeout_s)
            return Published(began_s, self.now_s - began_s, is_done=False)
        is_done = yield from self.confirm(timeout_s)
        return Published(began_s, self.now_s - began_s, is_done)

    def publish_best_effort(self, writer: int, payload: bytes) -> None:
        self.put_best_effort(sub(WRITE, struct.pack(">HH", self.request(), writer) + payload))

    # -- beginning ----------------------------------------------------------------------------------------------------

    def creation(self) -> bytes:
        """The message that creates the client."""
        head = struct.pack("<BBH", self.session & 0x80, 0, 0) + (self.key if self.session < 0x80 else b"")
        info = b"XRCE\x01\x00\x01\x0f" + self.key + bytes((self.session, 0)) + struct.pack("<H", self.mtu - 4)
        return head + sub(CREATE_CLIENT, info)

    def connect(self, attempts: int = 10, interval_s: float = 1.0) -> Program:
        """rclc_support_init."""
        self.agent_status = None
        self.reset()
        for _ in range(attempts):
            self.sent.append(self.creation())
            until_s = self.now_s + interval_s
            while self.agent_status is None and self.now_s < until_s:
                yield from self.listen(until_s - self.now_s)
            if self.agent_status is not None:
                self.reset()
                return self.agent_status == 0
        return False

    def ping(self, timeout_s: float = 0.1, session: int = 0x80) -> Program:
        """rmw_uros_ping_agent. Return whether the host answered in time."""
        self.pong = None
        self.send(0, 0, sub(GET_INFO, bytes.fromhex("000AFFFD02000000")), session)
        until_s = self.now_s + timeout_s
        while self.pong is None and self.now_s < until_s:
            message = yield until_s
            if message is not None:
                self.read(message)
        return self.pong is not None

    def synchronise(self, timeout_s: float = 0.01) -> Program:
        """rmw_uros_sync_session. Return whether the host answered in time."""
        self.is_synchronised = False
        now_ns = round(self.now_s * 1e9)
        self.send(0, 0, sub(TIMESTAMP, struct.pack("<iI", *divmod(now_ns, 10**9))))
        until_s = self.now_s + timeout_s
        while not self.is_synchronised and self.now_s < until_s:
            yield from self.listen(until_s - self.now_s)
        return self.is_synchronised

    def status(self, submessage: bytes, request: int, timeout_s: float = 1.0) -> Program:
        """Send a request reliably, and wait for its status. Return it; None if there is none in time."""
        until_s = self.now_s + timeout_s
        if not self.put(submessage):
            return None
        while request not in self.statuses and self.now_s < until_s:
            yield from self.listen(until_s - self.now_s)
        return self.statuses.get(request)

    def create(
        self, object_id: int, content: bytes, parent: int, *, form: int = BINARY, flags: int = 7, timeout_s: float = 1.0
    ) -> Program:
        """Create an object, and wait for its status."""
        request, submessage = self.creating(object_id, content, parent, form, flags)
        return (yield from self.status(submessage, request, timeout_s))

    def creating(
        self, object_id: int, content: bytes, parent: int, form: int = BINARY, flags: int = 7
    ) -> tuple[int, bytes]:
        """The id and the submessage of a request to create an object."""
        request = self.request()
        kind = object_id & 0xF
        payload = struct.pack(">HH", request, object_id) + bytes((kind, form, 0, 0))
        payload += struct.pack("<I", len(content)) + content
        payload = (
            padded(payload, 2) + struct.pack("<H", parent) if kind == PARTICIPANT else payload + parent.to_bytes(2)
        )
        return request, sub(CREATE, payload, flags)

    def delete(self, object_id: int) -> Program:
        request = self.request()
        return (yield from self.status(sub(DELETE, struct.pack(">HH", request, object_id)), request))

    def read_data(
        self,
        object_id: int,
        stream: int = 0x80,
        samples: int = 0xFFFF,
        seconds: int = 0,
        bytes_s: int = 0,
        pace_ms: int = 0,
    ) -> int:
        """Ask for the messages of a reader. Return the id of the request."""
        request = self.request()
        control = struct.pack("<HHHH", samples, seconds, bytes_s, pace_ms)
        self.put(sub(READ, struct.pack(">HH", request, object_id) + bytes((stream, 0, 0, 1)) + control))
        return request


# -- what rmw_microxrcedds creates ------------------------------------------------------------------------------------


def participant(node: str) -> bytes:
    return text(node, b"\0\1")


def topic(name: str, type_: str) -> bytes:
    return text(type_, text(name) + b"\0\1")


def endpoint(topic_id: int, *, is_reader: bool, is_reliable: bool = True) -> bytes:
    qualities = struct.pack("<H", 3 if is_reliable else 2) + b"\1\0\x0a\0" + bytes(4 + is_reader)
    return topic_id.to_bytes(2) + b"\1\0" + qualities


def service(name: str, type_: str) -> bytes:
    """A service by its name without slash and its type such as std_srvs::srv::dds_::SetBool."""
    built = text(f"{type_}_Response_", text(f"{type_}_Request_", text(f"/{name}")))
    return text(f"rr/{name}Reply", text(f"rq/{name}Request", built + b"\1") + b"\1")


def object_id(number: int, kind: int) -> int:
    return number << 4 | kind


PLACES = 4  # for messages of all subscriptions, in the stock middleware


@dataclass
class Stock:
    """The program of a board like linorobot2: an Odometry and an Imu at 50 Hz, and a velocity."""

    client: Client
    odometry: bytes
    imu: bytes
    period_s: float = 0.02
    turn_s: float = 0.0  # what else the loop does
    is_reliable: bool = True
    pings: bool = True
    restarts: bool = False  # has code to reconnect
    gives_up: bool = True  # looks for its host after two publications that failed, and ends if there is none
    begun: int = 0x01020304
    published: list[Published] = field(default_factory=list)
    is_running: bool = False
    failed_at: str = ""
    taken: list[tuple[float, float]] = field(default_factory=list)  # time, and linear velocity
    keeps: int = (
        PLACES  # messages that wait for the next turn of its loop, the newest dropped; 0: each is taken at once
    )
    hangs_at_s: float = float("inf")  # its loop does nothing from then on, for hangs_for_s
    hangs_for_s: float = 0.0
    kept: deque[tuple[int, bytes]] = field(default_factory=deque)

    ODOMETRY, IMU, COMMAND = object_id(0, WRITER), object_id(1, WRITER), object_id(0, READER)

    def keep(self, object_: int, payload: bytes) -> None:
        """Keep a message as the middleware does: a program that blocks in a publish takes none."""
        if not self.keeps:
            self.take(object_, payload)
        elif self.is_running and len(self.kept) < self.keeps:  # before, it has no reader
            self.kept.append((object_, payload))

    def take(self, object_: int, payload: bytes) -> None:
        if object_ == self.COMMAND:
            self.taken.append((self.client.now_s, TWIST.unpack(payload)[0]))

    def objects(self) -> list[tuple[int, bytes, int]]:
        """Objects that it creates, with the parents."""
        odometry, imu, twist = (
            "nav_msgs::msg::dds_::Odometry_",
            "sensor_msgs::msg::dds_::Imu_",
            "geometry_msgs::msg::dds_::Twist_",
        )
        node, reliable = object_id(0, PARTICIPANT), self.is_reliable
        return [
            (node, participant("linorobot_base_node"), 0),
            (object_id(0, TOPIC), topic("rt/odom/unfiltered", odometry), node),
            (object_id(0, PUBLISHER), b"\0\0", node),
            (
                self.ODOMETRY,
                endpoint(object_id(0, TOPIC), is_reader=False, is_reliable=reliable),
                object_id(0, PUBLISHER),
            ),
            (object_id(1, TOPIC), topic("rt/imu/data", imu), node),
            (object_id(1, PUBLISHER), b"\0\0", node),
            (self.IMU, endpoint(object_id(1, TOPIC), is_reader=False, is_reliable=reliable), object_id(1, PUBLISHER)),
            (object_id(2, TOPIC), topic("rt/cmd_vel", twist), node),
            (object_id(0, SUBSCRIBER), b"\0\0", node),
            (self.COMMAND, endpoint(object_id(2, TOPIC), is_reader=True), object_id(0, SUBSCRIBER)),
        ]

    def run(self) -> Program:
        """The program from its start. With code to reconnect it begins again after each failure, with another key."""
        self.client.on_data = self.keep
        while True:
            yield from self.once()
            self.is_running = False
            if not self.restarts:
                return
            self.begun += 1
            self.client.key = self.begun.to_bytes(4)
            yield from self.pause(0.2)

    def once(self) -> Program:
        """Connect, create everything and work until the host has lost the session."""
        client, failed = self.client, 0
        while self.pings and not (yield from client.ping()):
            yield from self.pause(0.1)
        if not (yield from client.connect()):
            self.failed_at = "connect"
            return
        for id_, content, parent in self.objects():
            status = yield from client.create(id_, content, parent)
            if status not in {0, 1}:
                self.failed_at = f"create {id_:04x}: {status}"
                return
        self.is_running = True
        yield from client.synchronise()
        client.read_data(self.COMMAND)
        next_s = client.now_s
        while (
            not self.gives_up or failed < 2 or ((yield from client.ping(session=client.session)) and client.pong == 1)
        ):
            failed = failed if failed < 2 else 0
            if client.now_s >= next_s:
                next_s = max(next_s + self.period_s, client.now_s)
                for writer, payload in ((self.ODOMETRY, self.odometry), (self.IMU, self.imu)):
                    if self.is_reliable:
                        self.published.append((yield from client.publish(writer, payload)))
                        failed = 0 if self.published[-1].is_done else failed + 1
                    else:
                        client.publish_best_effort(writer, payload)
            yield from client.listen(0.0)  # spin: one message a turn
            if self.kept:
                self.take(*self.kept.popleft())
            yield from self.pause(max(self.turn_s, 0.001))
            if client.now_s >= self.hangs_at_s:
                self.hangs_at_s = float("inf")
                yield from self.pause(self.hangs_for_s)

    def pause(self, seconds: float) -> Program:
        """Do something else: messages wait."""
        until_s = self.client.now_s + seconds
        while self.client.now_s < until_s:
            yield -until_s  # negative: not even for a message


@dataclass
class Talker:
    """A program that publishes on one topic and subscribes to another. It does what a test puts into `steps`."""

    client: Client
    published: tuple[str, str]  # name of the topic, and its type
    subscribed: tuple[str, str]
    taken: list[bytes] = field(default_factory=list)
    steps: deque[Program] = field(default_factory=deque)
    is_running: bool = False

    WRITER, READER, WRITTEN = object_id(0, WRITER), object_id(0, READER), object_id(0, TOPIC)

    def run(self) -> Program:
        """Create everything, then do one step after the other."""
        node, read = object_id(0, PARTICIPANT), object_id(1, TOPIC)
        groups = object_id(0, PUBLISHER), object_id(0, SUBSCRIBER)
        self.client.on_data = lambda _, payload: self.taken.append(payload)
        assert (yield from self.client.connect())
        for id_, content, parent in (
            (node, participant("talker"), 0),
            (self.WRITTEN, topic(*self.published), node),
            (groups[0], b"\0\0", node),
            (self.WRITER, endpoint(self.WRITTEN, is_reader=False), groups[0]),
            (read, topic(*self.subscribed), node),
            (groups[1], b"\0\0", node),
            (self.READER, endpoint(read, is_reader=True), groups[1]),
        ):
            assert (yield from self.client.create(id_, content, parent)) == 0
        self.client.read_data(self.READER)
        self.is_running = True
        while True:
            yield from self.steps.popleft() if self.steps else self.client.listen(0.01)

    def publish(self, payload: bytes) -> None:
        """Publish a message as the next step."""
        self.steps.append(self.client.publish(self.WRITER, payload))

    def change_type(self, type_: str) -> None:
        """Create the topic that is published again with another type, and its writer, as the stock library does."""
        self.steps.append(self.client.create(self.WRITTEN, topic(self.published[0], type_), object_id(0, PARTICIPANT)))
        again = endpoint(self.WRITTEN, is_reader=False)
        self.steps.append(self.client.create(self.WRITER, again, object_id(0, PUBLISHER)))


# -- transports -------------------------------------------------------------------------------------------------------


def crc16(data: bytes) -> int:
    """CRC-16 with the polynomial 8005, bit by bit, from the lowest."""
    crc = 0
    for byte in data:
        for place in range(8):
            is_set = (crc ^ byte >> place) & 1
            crc = crc >> 1 ^ (0xA001 if is_set else 0)
    return crc


class Datagrams:
    """The board's end of UDP."""

    def encode(self, message: bytes) -> bytes:
        return message

    def decode(self, data: bytes) -> list[bytes]:
        return [data]


class Lengths(Datagrams):
    """The board's end of a TCP connection."""

    def __init__(self) -> None:
        self._rest = b""

    def encode(self, message: bytes) -> bytes:
        return struct.pack("<H", len(message)) + message

    def decode(self, data: bytes) -> list[bytes]:
        self._rest += data
        found = []
        while len(self._rest) >= 2 and len(self._rest) >= 2 + (size := struct.unpack_from("<H", self._rest)[0]):
            found.append(self._rest[2 : 2 + size])
            self._rest = self._rest[2 + size :]
        return found


class Serial(Datagrams):
    """The board's end of a serial line, byte by byte."""

    def __init__(self) -> None:
        self._frame: list[int] | None = None
        self._is_escaped = False

    def encode(self, message: bytes) -> bytes:
        """A frame from the board, whose address is 1, to the host."""
        sent = bytearray(b"\x7e")
        for byte in b"\1\0" + struct.pack("<H", len(message)) + message + struct.pack("<H", crc16(message)):
            sent += bytes((0x7D, byte ^ 0x20)) if byte in {0x7D, 0x7E} else bytes((byte,))
        return bytes(sent)

    def decode(self, data: bytes) -> list[bytes]:
        found = []
        for byte in data:
            if byte == 0x7E:
                self._frame, self._is_escaped = [], False
            elif byte == 0x7D:
                self._is_escaped = True
            elif self._frame is not None:
                self._frame.append(byte ^ 0x20 if self._is_escaped else byte)
                self._is_escaped = False
                size = self._frame[2] + (self._frame[3] << 8) if len(self._frame) > 3 else 0xFFFF
                if len(self._frame) == size + 6:
                    message, crc = bytes(self._frame[4:-2]), bytes(self._frame[-2:])
                    found += [message] if crc == struct.pack("<H", crc16(message)) else []
                    self._frame = None
        return found


# -- the link between a board and a session ---------------------------------------------------------------------------


@dataclass
class Link:
    """A network in both directions: what it loses, doubles and delays."""

    random: Random
    loss: float = 0.0
    doubles: float = 0.0
    overtakes: float = 0.0  # share of datagrams that others overtake
    delay_s: tuple[float, float] = (0.0005, 0.003)
    last_s: dict[bool, float] = field(default_factory=dict)

    def arrivals(self, now_s: float, *, to_board: bool) -> list[float]:
        """Times at which a datagram that is sent now arrives: none, one or two."""
        found: list[float] = []
        while not found or self.random.random() < self.doubles:
            at_s = now_s + self.random.uniform(*self.delay_s)
            if self.random.random() >= self.overtakes:
                at_s = self.last_s[to_board] = max(at_s, self.last_s.get(to_board, 0.0))
            else:
                at_s += self.delay_s[1]
            found.append(at_s)
        return [] if self.random.random() < self.loss else found


class World:
    """A board, a session and the link between them, in virtual time."""

    def __init__(
        self,
        session: XrceSession,
        program: Program,
        client: Client,
        link: Link,
        transport: Datagrams | None = None,
        damage: float = 0.0,
    ) -> None:
        """`transport`: the board's end. `damage`: share of the writes of which a byte is damaged."""
        self.session, self.client, self.link = session, client, link
        self.transport = transport or Datagrams()
        self.damage = damage
        self.now_s = 0.0
        self.found: list[tuple[float, Event]] = []
        self.to_board = 0  # bytes
        self.frames: list[tuple[float, bytes]] = []  # what the host sent
        self._program = program
        self._inbox: deque[bytes] = deque()
        self._heap: list[tuple[float, int, Callable[[], None]]] = []
        self._order = itertools.count()
        self._waits_until_s = 0.0
        self._waits_for_messages = True
        self._turns = 0  # at the same time
        self.is_host_there = True
        self.session.open(now_s=0.0)
        self._step(None)

    # -- time ---------------------------------------------------------------------------------------------------------

    def at(self, time_s: float, action: Callable[[], None]) -> None:
        heapq.heappush(self._heap, (time_s, next(self._order), action))

    def run(self, until_s: float) -> None:
        """Let both sides live until then."""
        while True:
            host_s = self.session.deadline_s() if self.is_host_there else float("inf")
            wait_s = self.session.outbox.wait_s(self.now_s) if self.is_host_there else None
            if wait_s is not None:
                host_s = min(host_s, self.now_s + wait_s)
            next_s = min(host_s, self._waits_until_s, self._heap[0][0] if self._heap else float("inf"), until_s)
            self._turns = self._turns + 1 if next_s <= self.now_s else 0
            assert self._turns < TURNS_MAX, (self.now_s, host_s, self._waits_until_s, self._heap[:1])
            self.now_s = max(self.now_s, next_s)
            self.client.now_s = self.now_s
            if self._heap and self._heap[0][0] <= self.now_s:
                heapq.heappop(self._heap)[2]()
            elif host_s <= self.now_s:
                if self.session.deadline_s() <= self.now_s:
                    self._note(self.session.tick(now_s=self.now_s))
                self.write()
            elif self._waits_until_s <= self.now_s:
                message = self._inbox.popleft() if self._inbox and self._waits_for_messages else None
                self._step(message)
            else:
                return

    # -- the board ----------------------------------------------------------------------------------------------------

    def do(self, program: Program, *, within_s: float = 30.0) -> Any:
        """Let the board run a program to its end. Return its result. Then it listens."""
        results: list[Any] = []

        def run() -> Program:
            results.append((yield from program))
            while True:
                yield from self.client.listen(1.0)

        self._program = run()
        self._step(None)
        until_s = self.now_s + within_s
        while not results and self.now_s < until_s:
            self.run(min(self.now_s + 0.001, until_s))
        (result,) = results
        return result

    def _step(self, message: bytes | None) -> None:
        try:
            until_s = self._program.send(message) if message is not None else next(self._program)
        except StopIteration:
            until_s = float("inf")
        self._waits_for_messages = until_s >= 0
        self._waits_until_s = abs(until_s)
        sent, self.client.sent = self.client.sent, []
        for each in sent:
            for at_s in self.link.arrivals(self.now_s, to_board=False):
                data = self._damaged(self.transport.encode(each))
                self.at(at_s, lambda data=data: self._to_host(data))  # type: ignore[misc]
        if self._inbox and self._waits_for_messages:
            self._waits_until_s = self.now_s

    def _damaged(self, data: bytes) -> bytes:
        if self.link.random.random() >= self.damage:
            return data
        place = self.link.random.randrange(len(data))
        return data[:place] + bytes((self.link.random.randrange(256),)) + data[place + 1 :]

    def _to_board(self, data: bytes) -> None:
        self._inbox.extend(self.transport.decode(self._damaged(data)))
        if self._waits_for_messages:
            self._waits_until_s = self.now_s

    def restart_board(self, client: Client, program: Program) -> None:
        """Switch the board off and on."""
        self.client, self._program = client, program
        client.now_s = self.now_s
        self._inbox.clear()
        self._waits_until_s, self._waits_for_messages = self.now_s, True
        self._step(None)

    # -- the host -----------------------------------------------------------------------------------------------------

    def _to_host(self, message: bytes) -> None:
        if self.is_host_there:
            self._note(self.session.receive(message, now_s=self.now_s))
            self.write()

    def _note(self, found: list[Event]) -> None:
        self.found += [(self.now_s, each) for each in found]

    def write(self) -> None:
        """Send what the session has queued."""
        while self.session.outbox.has_waiting:
            outgoing = self.session.pop_frame(now_s=self.now_s, wall_ns=10**18 + round(self.now_s * 1e9))
            if outgoing is None:
                return
            self.frames.append((self.now_s, outgoing.frame))
            self.to_board += len(outgoing.frame)
            for at_s in self.link.arrivals(self.now_s, to_board=True):
                self.at(at_s, lambda frame=outgoing.frame: self._to_board(frame))  # type: ignore[misc]

    def send_to_host(self, data: bytes) -> None:
        """Let bytes of anything at the address of the board arrive at the host."""
        self._to_host(data)

    def restart_host(self, session: XrceSession, *, away_s: float = 0.5) -> None:
        """End the host, and start it again after a while."""
        self.is_host_there = False

        def begin() -> None:
            self.session, self.is_host_there = session, True
            self._note(session.open(now_s=self.now_s))
            self.write()

        self.at(self.now_s + away_s, begin)
