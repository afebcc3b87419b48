"""Publishers by signature, and their removal by token."""

from collections import Counter

import pytest

from hostlink.components.graphs.ros2_qos import Qos
from hostlink.components.zenoh import rmw_protocol
from hostlink.components.zenoh.rmw_protocol import (
    OWN_ENCLAVE,
    Attachment,
    EndpointToken,
    NodeToken,
    RemoteGraph,
    SourceClock,
    TokenKind,
    gid_of,
)

SUBJECT = ("/cmd_vel", "geometry_msgs/msg/Twist")
DRAWN, OTHER = b"\1" * 16, b"\2" * 16


def key_of(
    session: str, *, topic: str = SUBJECT[0], kind: TokenKind = TokenKind.PUBLISHER, domain: int = 0, enclave: str = ""
) -> str:
    node = NodeToken(domain, session, 0, "/", "driver", enclave)
    return EndpointToken(kind, node, 1, topic, SUBJECT[1], "RIHS01_0", Qos()).encode()


def graph_of(*keys: str) -> RemoteGraph:
    graph = RemoteGraph(0, Counter())
    for key in keys:
        assert graph.add(key) is not None
    return graph


def test_a_publisher_is_found_by_the_gid_of_its_token() -> None:
    graph = graph_of(key_of("aa"), key_of("bb"))
    found = graph.publisher(gid_of(key_of("bb")), SUBJECT)
    assert found is not None
    assert found.key == key_of("bb")


def test_a_gid_counts_for_its_own_topic_only() -> None:
    graph = graph_of(key_of("aa"), key_of("bb", topic="/other"))
    assert graph.publisher(gid_of(key_of("bb", topic="/other")), SUBJECT) is None


def test_signature_without_a_token_is_unknown() -> None:
    graph = graph_of(key_of("aa", topic="/other"), key_of("bb", kind=TokenKind.SUBSCRIPTION))
    assert graph.publisher(DRAWN, SUBJECT) is None


def test_a_drawn_gid_is_bound_to_a_publisher_that_has_signed_nothing() -> None:
    graph = graph_of(key_of("aa"), key_of("bb"))
    assert graph.publisher(gid_of(key_of("aa")), SUBJECT)
    bound = graph.publisher(DRAWN, SUBJECT)
    assert bound is not None
    assert bound.key == key_of("bb")
    assert graph.publisher(DRAWN, SUBJECT) is bound
    assert graph.publisher(OTHER, SUBJECT) is None


def test_signature_by_a_token_takes_it_back_from_a_drawn_gid() -> None:
    graph = graph_of(key_of("aa"))
    assert graph.publisher(DRAWN, SUBJECT) is not None
    assert graph.publisher(gid_of(key_of("aa")), SUBJECT) is not None
    assert graph.publisher(DRAWN, SUBJECT) is None
    assert not graph.is_known(DRAWN)


def test_signature_of_a_publisher_that_left_is_unknown() -> None:
    graph = graph_of(key_of("aa"))
    removed = graph.remove(key_of("aa"))
    assert removed is not None
    assert removed.publisher is not None
    assert graph.publisher(gid_of(key_of("aa")), SUBJECT) is None
    assert graph.remove(key_of("aa")) is None
    assert len(graph._tokens) == 0


def test_of_those_that_drew_their_gids_any_may_be_the_one_that_is_gone() -> None:
    graph = graph_of(key_of("aa"), key_of("bb"), key_of("cc"))
    graph.publisher(gid_of(key_of("cc")), SUBJECT)
    graph.publisher(DRAWN, SUBJECT)
    graph.publisher(OTHER, SUBJECT)
    removed = graph.remove(key_of("bb"))
    assert removed is not None
    assert {each.key for each in removed.unsure} == {key_of("aa")}
    again = graph.publisher(OTHER, SUBJECT)
    assert again is not None
    assert again.key == key_of("aa")


def test_one_that_signed_by_its_token_leaves_the_others_alone() -> None:
    graph = graph_of(key_of("aa"), key_of("bb"))
    graph.publisher(gid_of(key_of("bb")), SUBJECT)
    bound = graph.publisher(DRAWN, SUBJECT)
    removed = graph.remove(key_of("bb"))
    assert removed is not None
    assert removed.unsure == ()
    assert graph.publisher(DRAWN, SUBJECT) is bound


@pytest.mark.parametrize("key", ["x", key_of("aa", domain=1)])
def test_token_of_another_graph_is_counted(key: str) -> None:
    graph = graph_of()
    assert graph.add(key) is None
    assert graph.counts == {"malformed_tokens": 1}


def test_nodes_of_other_hosts_of_hostlink_are_left_out() -> None:
    graph = graph_of()
    assert graph.add(key_of("aa", enclave=OWN_ENCLAVE)) is None
    assert len(graph._tokens) == 0
    assert not graph.counts


def test_tokens_are_bounded_for_each_session_and_for_all(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rmw_protocol, "MAX_TOKENS_OF_SESSION", 3)
    monkeypatch.setattr(rmw_protocol, "MAX_TOKENS", 5)
    graph = RemoteGraph(0, Counter())
    for number in range(6):
        graph.add(key_of("aa", topic=f"/topic_{number}"))
    assert len(graph._tokens) == 3
    for number in range(6):
        graph.add(key_of(f"b{number}"))
    assert len(graph._tokens) == 5
    assert graph.counts["crowded_tokens"] == 7
    for key in list(graph._tokens):
        graph.remove(key)
    assert len(graph._tokens) == 0
    assert graph.add(key_of("aa")) is not None


def test_an_attachment_is_33_bytes() -> None:
    attachment = Attachment(7, 1_700_000_000_000_000_000, bytes(range(16)))
    data = attachment.encode()
    assert data[:8] == (7).to_bytes(8, "little")
    assert data[16] == 16
    assert len(data) == 33
    assert Attachment.decode(data) == attachment


@pytest.mark.parametrize("data", [b"", bytes(32), bytes(33), bytes(34), b"\x0fsequence_number" + bytes(60)])
def test_malformed_attachment_is_refused(data: bytes) -> None:
    assert Attachment.decode(data) is None


def test_a_message_that_waited_is_late() -> None:
    clock = SourceClock()
    assert clock.late_s(1, 1_000_000_000, 100.0) == 0
    assert clock.late_s(2, 1_100_000_000, 100.1) == pytest.approx(0, abs=1e-6)
    assert clock.late_s(3, 1_200_000_000, 102.2) == pytest.approx(2.0, abs=0.01)


def test_a_message_after_a_lease_of_lost_ones_may_be_as_old_as_those() -> None:
    clock = SourceClock()
    assert clock.late_s(7, 1_000_000_000, 100.0) == 0
    assert clock.late_s(9, 1_400_000_000, 100.4) == pytest.approx(0, abs=1e-3)  # less than a lease
    assert clock.late_s(10, 2_400_000_000, 101.4) == pytest.approx(0, abs=1e-3)  # none was lost
    assert clock.late_s(15, 3_000_000_000, 102.0) == pytest.approx(0.6)
    assert clock.late_s(16, 3_100_000_000, 102.1) == pytest.approx(0, abs=1e-3)


def test_a_clock_that_is_set_back_delays_nothing() -> None:
    clock = SourceClock()
    clock.late_s(1, 50_000_000_000, 100.0)
    assert clock.late_s(2, 10_000_000_000, 100.1) == 0
    assert clock.late_s(3, 10_100_000_000, 100.2) == pytest.approx(0, abs=1e-3)


def test_messages_out_of_order_do_not_set_the_clock_back() -> None:
    clock = SourceClock()
    clock.late_s(1, 10_000_000_000, 100.0)
    clock.late_s(3, 12_000_000_000, 102.0)
    assert clock.late_s(2, 11_000_000_000, 102.0) == pytest.approx(1.0, abs=0.01)
