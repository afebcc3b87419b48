"""Which policies the bridge chooses."""

from hypothesis import given
from hypothesis import strategies as st

from hostlink.graphs.ros2.plan import COMMAND, Qos, publisher_qos, subscription_qos

offers = st.lists(st.builds(Qos, st.booleans(), st.booleans()), max_size=4)


def matches(offer: Qos, request: Qos) -> bool:
    """As DDS has it: what is requested may be no more than what is offered."""
    return offer.is_reliable >= request.is_reliable and offer.is_latched >= request.is_latched


@given(offers)
def test_a_subscription_matches_every_publisher(found: list[Qos]) -> None:
    assert all(matches(offer, subscription_qos(found)) for offer in found)


@given(st.booleans(), st.booleans())
def test_commands_match_every_publisher(is_reliable: bool, is_latched: bool) -> None:
    assert matches(Qos(is_reliable, is_latched), COMMAND)


def test_a_map_that_every_publisher_latches_is_received_by_who_comes_later() -> None:
    assert subscription_qos([Qos(True, True), Qos(True, True)])[:2] == (True, True)
    assert subscription_qos([Qos(True, True), Qos(True, False)])[:2] == (True, False)


def test_what_is_published_reaches_reliable_and_best_effort_subscriptions() -> None:
    offer = publisher_qos("/robot_0/odom", is_latched=False)
    assert all(matches(offer, Qos(is_reliable, is_latched=False)) for is_reliable in (True, False))


def test_static_transforms_and_latched_topics_wait_for_who_comes_later() -> None:
    assert publisher_qos("/tf_static", is_latched=False).is_latched
    assert publisher_qos("/map", is_latched=True).is_latched
    assert not publisher_qos("/tf", is_latched=False).is_latched
