"""Policies that the bridge chooses."""

from hypothesis import given
from hypothesis import strategies as st

from hostlink.components.graphs.ros2_qos import COMMANDS, Qos
from hostlink.components.ros2.plan import publisher_qos, subscription_qos

offers = st.lists(st.builds(Qos, st.booleans(), st.booleans()), max_size=4)


def matches(offer: Qos, request: Qos) -> bool:
    """Whether two ends match in DDS: the requested policies must not exceed the offered ones."""
    return offer.is_reliable >= request.is_reliable and offer.is_latched >= request.is_latched


@given(offers)
def test_a_subscription_matches_every_publisher(found: list[Qos]) -> None:
    assert all(matches(offer, subscription_qos(found)) for offer in found)


@given(st.booleans(), st.booleans())
def test_commands_match_every_publisher(is_reliable: bool, is_latched: bool) -> None:
    assert matches(Qos(is_reliable, is_latched), COMMANDS)


def test_map_latched_by_every_publisher_reaches_later_subscribers() -> None:
    assert subscription_qos([Qos(True, True), Qos(True, True)])[:2] == (True, True)
    assert subscription_qos([Qos(True, True), Qos(True, False)])[:2] == (True, False)


def test_publication_reaches_reliable_and_best_effort_subscriptions() -> None:
    offer = publisher_qos("/robot_0/odom", is_latched=False)
    assert all(matches(offer, Qos(is_reliable, is_latched=False)) for is_reliable in (True, False))


def test_static_transforms_and_latched_topics_reach_later_subscribers() -> None:
    assert publisher_qos("/tf_static", is_latched=False).is_latched
    assert publisher_qos("/map", is_latched=True).is_latched
    assert not publisher_qos("/tf", is_latched=False).is_latched
