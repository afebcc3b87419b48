"""Any bytes from ROS 2 are a message or a BadPayload, and no publisher signs for another after any order of tokens."""

from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from hostlink.components.graphs.ros2_qos import Qos
from hostlink.components.graphs.ros2_types import Ros2Types
from hostlink.components.zenoh.rmw_protocol import (
    Attachment,
    EndpointToken,
    NodeToken,
    RemoteGraph,
    TokenKind,
    gid_of,
)
from hostlink.errors import BadPayload
from tests.support.fake_device import CATALOG
from tests.support.strategies import fewer_examples

TYPES = Ros2Types(CATALOG, "kilted")
NAMES = [
    "diagnostic_msgs/DiagnosticArray",
    "geometry_msgs/Twist",
    "geometry_msgs/TwistStamped",
    "nav_msgs/Odometry",
    "rosgraph_msgs/Log",
    "sensor_msgs/JointState",
    "sensor_msgs/Range",
    "std_msgs/ByteMultiArray",
    "std_msgs/Empty",
    "std_msgs/String",
    "tf2_msgs/TFMessage",
    "visualization_msgs/Marker",
]
SUBJECTS = [("/robot_0/cmd_vel", "geometry_msgs/msg/Twist"), ("/robot_1/cmd_vel", "geometry_msgs/msg/Twist")]
DRAWN = [bytes([number]) * 16 for number in range(4)]


@pytest.mark.parametrize("name", NAMES)
@given(data=st.data())
def test_any_bytes_are_a_message_or_refused(name: str, data: st.DataObject) -> None:
    known, type_ = CATALOG.message(name), TYPES.message(name)
    zeros = type_.to_cdr(known.encode({}))
    cut = data.draw(st.integers(0, len(zeros)))
    raw = zeros[:cut] + data.draw(st.binary(max_size=64))
    try:
        payload = type_.from_cdr(raw)
    except BadPayload:
        return
    known.decode(payload)
    assert type_.from_cdr(type_.to_cdr(payload)) == payload


@given(st.binary(max_size=40))
def test_any_bytes_are_an_attachment_or_none(data: bytes) -> None:
    attachment = Attachment.decode(data)
    assert attachment is None or attachment.encode() == data


class Tokens(RuleBasedStateMachine):
    """Tokens come and go, and messages are signed by hashes and by drawn gids."""

    @initialize()
    def begin(self) -> None:
        self.graph = RemoteGraph(0, Counter())
        self.alive: dict[str, tuple[str, str]] = {}

    def key(self, session: int, subject: tuple[str, str]) -> str:
        node = NodeToken(0, f"a{session}", 0, "/", "driver")
        return EndpointToken(TokenKind.PUBLISHER, node, 1, *subject, "RIHS01_0", Qos()).encode()

    @rule(session=st.integers(0, 3), subject=st.sampled_from(SUBJECTS))
    def come(self, session: int, subject: tuple[str, str]) -> None:
        key = self.key(session, subject)
        self.graph.add(key)
        self.alive[key] = subject

    @rule(session=st.integers(0, 3), subject=st.sampled_from(SUBJECTS))
    def go(self, session: int, subject: tuple[str, str]) -> None:
        key = self.key(session, subject)
        before = {gid: self.graph._by_gid[gid].key for gid in DRAWN if gid in self.graph._by_gid}
        removed = self.graph.remove(key)
        assert (removed is None) == (self.alive.pop(key, None) is None)
        if removed is not None and removed.publisher is not None:
            released = {each.key for each in removed.unsure} | {key}
            assert all(owner in released for gid, owner in before.items() if gid not in self.graph._by_gid)

    @rule(session=st.integers(0, 3), signed=st.sampled_from(SUBJECTS), subject=st.sampled_from(SUBJECTS))
    def sign(self, session: int, signed: tuple[str, str], subject: tuple[str, str]) -> None:
        key = self.key(session, signed)
        found = self.graph.publisher(gid_of(key), subject)
        if key in self.alive:
            assert (found is not None) == (signed == subject)
            assert found is None or found.key == key

    @rule(gid=st.sampled_from(DRAWN), subject=st.sampled_from(SUBJECTS))
    def sign_by_a_drawn_gid(self, gid: bytes, subject: tuple[str, str]) -> None:
        found = self.graph.publisher(gid, subject)
        if found is not None:
            assert found.subject == subject
            assert not found.has_signed

    @invariant()
    def whoever_signs_is_there(self) -> None:
        if hasattr(self, "alive"):
            assert self.graph._tokens.keys() == self.alive.keys()
            owners = [publisher.key for publisher in self.graph._by_gid.values()]
            assert set(owners) <= self.alive.keys()
            assert max(Counter(owners).values(), default=0) <= 2
            for subject in SUBJECTS:
                expected = {key for key, of in self.alive.items() if of == subject}
                assert {each.key for each in self.graph.publishers(subject)} == expected


TestTokens = Tokens.TestCase
TestTokens.settings = fewer_examples(2, stateful_step_count=30)
