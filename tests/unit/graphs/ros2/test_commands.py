"""Which velocities may drive: a stream that was interrupted may not, until it was a zero or paused."""

from hypothesis import given
from hypothesis import strategies as st

from hostlink.graphs.ros2.commands import LEASE_S, Commands

PERIOD_S = 0.1


def stream(commands: Commands, link: int | None, *, count: int, from_s: float = 0.0) -> list[bool]:
    """Velocities ten times a second."""
    return [commands.admit(is_zero=False, link=link, now_s=from_s + number * PERIOD_S) for number in range(count)]


def test_a_stream_drives() -> None:
    assert all(stream(Commands(), 1, count=50))


def test_a_device_that_connects_again_is_not_driven_by_a_stream_of_before() -> None:
    commands = Commands()
    assert all(stream(commands, 1, count=5))
    assert not any(stream(commands, 2, count=50, from_s=0.5))
    assert commands.refused == 50


def test_a_zero_begins_anew() -> None:
    commands = Commands()
    stream(commands, 1, count=5)
    assert not any(stream(commands, 2, count=5, from_s=0.5))
    assert commands.admit(is_zero=True, link=2, now_s=1.0)
    assert all(stream(commands, 2, count=5, from_s=1.1))


def test_a_pause_as_long_as_a_lease_begins_anew() -> None:
    commands = Commands()
    stream(commands, 1, count=5)
    commands.interrupt(0.5)
    assert not any(stream(commands, 1, count=5, from_s=0.55))
    assert not commands.admit(is_zero=False, link=1, now_s=0.95 + LEASE_S)
    assert commands.admit(is_zero=False, link=1, now_s=0.96 + 2 * LEASE_S)


def test_what_comes_after_an_interruption_does_not_drive_however_long_it_lasted() -> None:
    commands = Commands()
    stream(commands, 1, count=5)
    commands.interrupt(100.0)  # the bridge stood still, and notices it now
    assert not commands.admit(is_zero=False, link=1, now_s=100.0)


def test_a_robot_that_was_not_there_and_comes_is_not_driven_by_a_stream_of_before() -> None:
    commands = Commands()
    assert all(stream(commands, None, count=5))  # the daemon refuses them
    assert not any(stream(commands, 1, count=5, from_s=0.5))


@given(
    st.lists(
        st.tuples(st.floats(0, 1), st.booleans(), st.sampled_from([None, 1, 2]), st.booleans()), min_size=1, max_size=40
    )
)
def test_no_velocity_is_sent_for_another_link_than_the_stream_began_with(
    steps: list[tuple[float, bool, int | None, bool]],
) -> None:
    commands, now_s, began_with, last_s = Commands(), 0.0, None, float("-inf")
    for wait_s, is_zero, link, is_interrupted in steps:
        now_s += wait_s
        if is_interrupted:
            commands.interrupt(now_s)
            began_with, last_s = "nobody", now_s  # type: ignore[assignment]
        if is_zero or now_s > last_s + LEASE_S:
            began_with = link
        last_s = float("-inf") if is_zero else now_s
        is_sent = commands.admit(is_zero=is_zero, link=link, now_s=now_s)
        assert is_sent or not is_zero
        assert not is_sent or is_zero or link == began_with
