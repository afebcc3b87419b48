"""Invariants of the session: any bytes raise nothing, and a good device recovers."""

import contextlib
import dataclasses
import itertools
from collections.abc import Iterable

from hypothesis import given
from hypothesis import strategies as st

from hostlink.core.protocol import events
from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind
from hostlink.core.protocol.rosserial.control import encode_topic_info
from hostlink.core.protocol.rosserial.frame import TOPICS_REQUEST, Id, encode
from hostlink.core.protocol.rosserial.session import Session
from hostlink.errors import HostlinkError
from tests.support.strategies import damaged, frames, noise, split, topic_infos, wire_of

GOOD = [
    DeviceEndpoint(EndpointKind.PUBLISHER, 125, "/odometry", "geometry_msgs/Pose2D", "m", 512),
    DeviceEndpoint(EndpointKind.SUBSCRIBER, 100, "/velocity", "geometry_msgs/Twist", "m", 512),
]
TIME = encode(Id.TIME, bytes(8))
PROTOCOL_1 = b"\xff\xff\x0a\x00\x08\x00" + bytes(8) + b"\xed"
SIZES = {"geometry_msgs/Pose2D": 24, "geometry_msgs/Twist": 48}

infos = topic_infos.map(lambda info: encode(info.kind, encode_topic_info(info)))
controls = st.builds(encode, st.integers(0, 12), st.binary(max_size=30))
lines = st.lists(st.one_of(noise, frames.map(wire_of), infos, controls, st.just(TIME)), max_size=6).map(b"".join)


@given(st.lists(st.tuples(lines, st.floats(0.0, 3.0)), max_size=15), st.data())
def test_any_bytes_in_any_state_raise_nothing_and_a_request_recovers(
    story: list[tuple[bytes, float]], data: st.DataObject
) -> None:
    session = Session(check=lambda info: SIZES.get(info.type), is_lossy=data.draw(st.booleans()))
    now_s = 0.0
    requested_at_s = [now_s for event in session.open(now_s=now_s) if isinstance(event, events.TopicsRequested)]
    for line, pause_s in story:
        was_steady, before_s = session.is_steady, session.deadline_s()
        for event in session.receive(damaged(line, data), now_s=now_s):
            requested_at_s += [now_s] * isinstance(event, events.TopicsRequested)
        if was_steady and session.is_steady and not session.outbox.has_waiting:
            assert session.deadline_s() >= before_s  # a link keeps its timer then
        until_s = now_s + pause_s
        ticks = 0
        while (deadline_s := session.deadline_s()) <= until_s:
            now_s = max(now_s, deadline_s)
            for event in session.tick(now_s=now_s):
                requested_at_s += [now_s] * isinstance(event, events.TopicsRequested)
            ticks += 1
            assert ticks < 2000, "a deadline that a tick does not move"
        now_s = until_s
        for info in session.topics:
            sends_only_what_fits_the_device(session, info, now_s)
    assert all(later >= earlier + 1.0 for earlier, later in itertools.pairwise(requested_at_s))
    comes_back(session, now_s)


def heard(reads: Iterable[bytes]) -> tuple[list[events.Event], dict[str, int]]:
    """Every event except TopicsRequested: a longer read may request the topics earlier."""
    session = Session(check=lambda info: SIZES.get(info.type))
    session.open(now_s=0.0)
    found = [event for read in reads for event in session.receive(read, now_s=0.0)]
    counts = dataclasses.asdict(session.counts) | {"topic_requests": 0}
    return [event for event in found if not isinstance(event, events.TopicsRequested)], counts


@given(lines, st.lists(st.sampled_from([GOOD, GOOD[:1], GOOD[1:]]), max_size=3), st.data())
def test_every_split_gives_the_same_events(
    line: bytes, tellings: list[list[DeviceEndpoint]], data: st.DataObject
) -> None:
    parts = [b"".join(encode(info.kind, encode_topic_info(info)) for info in infos) for infos in tellings]
    wire = damaged(b"".join(part + encode(125, bytes(24)) + line for part in [*parts, PROTOCOL_1]), data)
    assert heard(split(wire, data)) == heard([wire]) == heard(bytes([byte]) for byte in wire)


def sends_only_what_fits_the_device(session: Session, info: DeviceEndpoint, now_s: float) -> None:
    """Publish to a topic. A message is for the newest endpoint of that name, also during a negotiation."""
    payload = bytes(SIZES.get(info.type, 5))
    taker = None
    with contextlib.suppress(HostlinkError):  # either refused, or sent and within the limits
        taker = session.endpoint_of(info.name, payload)
        session.publish(info.name, payload)
    while (outgoing := session.pop_frame(now_s=now_s, wall_ns=0)) is not None:
        frame = outgoing.frame
        topic_id = int.from_bytes(frame[5:7], "little")
        if topic_id >= 100:
            assert taker is not None
            assert topic_id == taker.id
            assert len(frame) <= taker.buffer_bytes or taker.buffer_bytes <= 0


def comes_back(session: Session, now_s: float) -> None:
    """Check that a device that answers the next topic request works again."""
    requested = False
    for _ in range(2000):
        now_s += 0.01
        while (outgoing := session.pop_frame(now_s=now_s, wall_ns=0)) is not None:
            requested = requested or outgoing.frame == TOPICS_REQUEST
        if requested:
            break
        session.tick(now_s=now_s)
    assert requested, "it never asked again"
    announced = TIME + b"".join(encode(info.kind, encode_topic_info(info)) for info in GOOD) + TIME
    # Junk that waits for its end may hide one answer. It is given up, and the next answer is received.
    found = session.receive(announced, now_s=now_s) + session.receive(encode(125, bytes(24)), now_s=now_s)
    if not any(isinstance(event, events.MessageReceived) and event.topic == GOOD[0] for event in found):
        for _ in range(3):
            now_s += 2.5
            session.tick(now_s=now_s)
        found = session.receive(announced + encode(125, bytes(24)), now_s=now_s)
    assert any(isinstance(event, events.MessageReceived) and event.topic == GOOD[0] for event in found)
    session.publish("/velocity", bytes(48))
