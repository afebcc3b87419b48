"""Arrival: how old the bytes of a source may be, for what each read tells about those behind it."""

from hypothesis import given
from hypothesis import strategies as st

from hostlink.core.runtime.arrival import CALM_S, SETTLE_S, Arrival


def read(arrival: Arrival, now_s: float, *, is_more: bool = False, takes_s: float = 0.0) -> float:
    """Read all bytes within `takes_s`, and return their earliest arrival."""
    came_s = arrival.arrive(now_s)
    arrival.leave(now_s + takes_s, is_more=is_more)
    return came_s


def test_bytes_that_were_read_alone_are_as_old_as_their_read() -> None:
    arrival = Arrival()
    assert [read(arrival, now_s) for now_s in (1.0, 1.001, 5.0)] == [1.0, 1.001, 5.0]


def test_first_bytes_are_as_old_as_the_wait_of_their_connection() -> None:
    arrival = Arrival(1.0)
    assert [read(arrival, now_s) for now_s in (4.0, 4.1)] == [1.0, 4.1]


def test_bytes_behind_others_are_as_old_as_the_first_of_them() -> None:
    arrival = Arrival()
    assert [read(arrival, number / 100, is_more=number < 300) for number in range(100, 302)] == [1.0] * 202


def test_bytes_that_wait_for_a_turn_are_as_old_as_the_first_of_them() -> None:
    arrival = Arrival()
    assert [arrival.arrive(1.0), arrival.arrive(1.4), arrival.arrive(9.0)] == [1.0] * 3
    arrival.leave(9.1, is_more=False)
    assert read(arrival, 9.11) == 1.0  # the sender may have more, and sends it when there is room here


def test_source_is_new_again_when_the_loop_has_read_nothing_for_a_while() -> None:
    arrival = Arrival()
    arrival.arrive(1.0)
    number = arrival.leave(2.0, is_more=True)
    arrival.settle(number)
    assert read(arrival, 2.0 + SETTLE_S) == 2.0 + SETTLE_S


def test_time_without_a_turn_of_the_loop_makes_nothing_new() -> None:
    arrival = Arrival()
    arrival.arrive(1.0)
    number = arrival.leave(2.0, is_more=True)
    assert arrival.arrive(5.0) == 1.0
    arrival.settle(number)  # due, and too late
    arrival.leave(5.0, is_more=False)
    arrival.settle(number)
    assert arrival.arrive(5.001) == 1.0


def test_sender_that_writes_all_the_time_is_new_again_when_nothing_has_waited_for_a_while() -> None:
    arrival = Arrival()
    read(arrival, 1.0, takes_s=2 * SETTLE_S)
    began_s = 1.0 + 2 * SETTLE_S
    came = [(number * 1e-3, read(arrival, began_s + number * 1e-3)) for number in range(1, 200)]
    assert {came_s for after_s, came_s in came if after_s < CALM_S} == {1.0}
    assert all(came_s == began_s + after_s for after_s, came_s in came if after_s > CALM_S + 2e-3)


@given(st.lists(st.tuples(st.floats(0, 0.2), st.floats(0, 0.1), st.booleans(), st.booleans()), min_size=1, max_size=60))
def test_bytes_are_never_newer_than_their_read_and_never_as_old_as_what_was_read_before_all_was(
    reads: list[tuple[float, float, bool, bool]],
) -> None:
    """Bytes are as old as the last time at which nothing waited, or as their read."""
    arrival, now_s, earliest_s = Arrival(), 0.0, 0.0
    for after_s, takes_s, is_more, is_settled in reads:
        now_s += after_s
        came_s = arrival.arrive(now_s)
        assert earliest_s <= came_s <= now_s
        now_s += takes_s
        number = arrival.leave(now_s, is_more=is_more)
        if number and is_settled:
            now_s += SETTLE_S
            arrival.settle(number)
        earliest_s = now_s if not number or is_settled else came_s
