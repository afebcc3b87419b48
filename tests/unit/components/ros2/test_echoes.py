"""Echoes of the bridge's own messages are not sent back to the daemon."""

from hypothesis import given
from hypothesis import strategies as st

from hostlink.components.ros2.conversion import MAX_REMEMBERED, Echoes


def test_a_message_is_an_echo_once_for_each_time_it_was_published() -> None:
    echoes = Echoes()
    echoes.publish(b"a")
    echoes.publish(b"a")
    assert [echoes.is_echo(b"a") for _ in range(3)] == [True, True, False]


@given(st.lists(st.binary(max_size=2), max_size=MAX_REMEMBERED), st.lists(st.binary(max_size=2), max_size=20))
def test_message_of_another_publisher_passes(own: list[bytes], others: list[bytes]) -> None:
    echoes = Echoes()
    for data in own:
        echoes.publish(data)
    assert all(echoes.is_echo(data) for data in own)
    assert not any(echoes.is_echo(data) for data in others)


def test_remembered_messages_are_bounded() -> None:
    echoes = Echoes()
    for number in range(10 * MAX_REMEMBERED):
        echoes.publish(b"%d" % number)
    assert not echoes.is_echo(b"0")
    assert echoes.is_echo(b"%d" % (10 * MAX_REMEMBERED - 1))
