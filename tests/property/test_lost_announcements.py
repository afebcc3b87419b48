"""Incomplete announcements in any parts: kept topics, dropped topics, and the number of topic requests."""

import contextlib
import itertools
import random
from collections import Counter

from hypothesis import given
from hypothesis import strategies as st

from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind
from hostlink.core.protocol.rosserial.frame import FIRST_TOPIC_ID, Id, encode
from hostlink.core.protocol.rosserial.topic_table import MAX_MISSED
from hostlink.errors import UnknownTopic
from tests.support.session_host import LED, ODOMETRY, TEXT, TIME, Host, wire
from tests.support.strategies import fewer_examples

MESSAGE = encode(ODOMETRY.id, bytes(24))
TOPICS = [
    ODOMETRY,
    DeviceEndpoint(EndpointKind.PUBLISHER, 126, "/battery", "std_msgs/Float32", "m", 512),
    DeviceEndpoint(EndpointKind.SERVICE_CLIENT_PUBLISHER, 127, "/ask", "my_srvs/Mine", "m", 512),
    LED,
    TEXT,
    DeviceEndpoint(EndpointKind.SERVICE_CLIENT_SUBSCRIBER, 102, "/ask", "my_srvs/Mine", "m", 512),
]

behind = st.sampled_from([b"", b"", TIME, MESSAGE])
announcements = st.lists(
    st.tuples(st.sampled_from(TOPICS), behind), min_size=1, max_size=8, unique_by=lambda part: part[0]
)


@given(st.lists(announcements, max_size=12), st.booleans())
def test_endpoint_is_removed_after_three_announcements_without_it(
    story: list[list[tuple[DeviceEndpoint, bytes]]], is_lossy: bool
) -> None:
    host = Host(*TOPICS, is_lossy=is_lossy)
    lacked: Counter[DeviceEndpoint] = Counter()
    for parts in story:
        announced = {info for info, _ in parts}
        host.receive(TIME)  # not silent, which would cause a request
        host.session.probe()
        host.events = host.session.tick(now_s=host.now_s)
        while not host.requests():  # no request between the parts of an announcement
            host.wait(0.05)
        for info, message in parts:
            host.receive(wire(info) + message)
            assert all(one in host.session.topics for one in TOPICS if lacked[one] < MAX_MISSED - 1)
        host.wait(0.55)
        lacked = Counter({one: lacked[one] + 1 for one in TOPICS if one not in announced})
        assert set(host.session.topics) == {one for one in TOPICS if lacked[one] < MAX_MISSED}


def answers(host: Host, device: list[DeviceEndpoint], chance: random.Random, loss: float) -> int:
    """Answer the received topic requests in datagrams of one frame. Return the number of answered requests."""
    requests = sum(frame.topic_id == Id.PUBLISHER and chance.random() >= loss for frame in host.sent())
    for _ in range(requests):
        for datagram in [TIME, *(wire(info) for info in device)]:
            if chance.random() >= loss:
                host.receive(datagram, after_s=0.0)
    return requests


@given(st.integers(0, 2**32), st.floats(0.0, 0.4))
def test_topic_requests_end_soon_after_the_last_lost_datagram(seed: int, loss: float) -> None:
    chance, host = random.Random(seed), Host(is_lossy=True)
    for tenth in range(600):
        loss_now = loss if tenth < 300 else 0.0
        answers(host, TOPICS, chance, loss_now)
        if chance.random() >= loss_now:
            host.receive(TIME if tenth % 25 == 24 else MESSAGE, after_s=0.0)
        host.session.tick(now_s=host.now_s)
        host.wait(0.1)
        if tenth == 400:
            before = host.session.counts.topic_requests
    assert before <= 36
    assert host.session.counts.topic_requests == before


@fewer_examples(3)
@given(st.integers(0, 2**32), st.booleans())
def test_changing_topics_are_requested_at_most_once_a_second(seed: int, is_lossy: bool) -> None:
    chance, host = random.Random(seed), Host(is_lossy=is_lossy)
    asked_at_s: list[float] = []
    meanings: dict[int, DeviceEndpoint] = {}
    for _ in range(300):
        device = [
            info._replace(id=info.id + chance.randrange(2), name=chance.choice("ab") + info.name)
            for info in chance.sample(TOPICS, chance.randrange(1, len(TOPICS)))
        ]
        if chance.random() < 0.2:  # unrequested
            host.receive(TIME + wire(*device) + chance.choice([b"", TIME, MESSAGE]), after_s=0.0)
            meanings |= {info.id: info for info in device}
        for info in host.session.topics:
            if info.type == LED.type:
                with contextlib.suppress(UnknownTopic):  # the topic is being replaced
                    host.session.publish(info.name, b"\x01")
        sent_ids = [frame.topic_id for frame in host.sent()]
        assert all(meanings[each].type == LED.type for each in sent_ids if each >= FIRST_TOPIC_ID)
        if Id.PUBLISHER in sent_ids:
            asked_at_s.append(host.now_s)
            host.receive(TIME + wire(*device), after_s=0.0)
            meanings |= {info.id: info for info in device}
        host.wait(0.1)
    assert all(later >= earlier + 0.99 for earlier, later in itertools.pairwise(asked_at_s))
