"""WritePace: which clients are slow, and how much they get before they confirm it."""

import pytest

from hostlink.components.gateway.write_pace import LEAST_BYTES, SLOW_S, WRITE_BYTES, WritePace


def slow() -> WritePace:
    pace = WritePace()
    pace.note_pause(SLOW_S)
    return pace


def test_client_that_takes_all_soon_is_sent_no_ping() -> None:
    pace = WritePace()
    pace.note_pause(SLOW_S - 0.01)
    assert (pace.max_bytes, pace.ask(1.0), pace.is_waiting) == (WRITE_BYTES, b"", False)
    assert not pace.confirm(b"0", 1.0)


def test_slow_client_is_waited_for_until_the_pong_of_its_last_ping() -> None:
    pace = slow()
    assert pace.max_bytes == LEAST_BYTES
    assert (pace.ask(1.0), pace.is_waiting) == (b"1", True)
    assert not pace.confirm(b"0", 1.1)
    assert pace.is_waiting
    assert pace.confirm(b"1", 1.1)
    assert not pace.is_waiting
    assert (pace.ask(2.0), pace.is_waiting) == (b"2", True)


@pytest.mark.parametrize(("took_s", "most_bytes"), [(0.9, 4), (1.0, 2), (2.0, 2), (2.1, 1)])
def test_next_write_depends_on_the_time_of_the_last(took_s: float, most_bytes: int) -> None:
    pace = slow()
    pace.ask(0.0)
    pace.confirm(b"1", 0.0)
    assert pace.max_bytes == 2 * LEAST_BYTES
    pace.ask(0.0)
    pace.confirm(b"2", took_s * SLOW_S)
    assert pace.max_bytes == most_bytes * LEAST_BYTES


def test_slow_client_gets_no_less_than_the_least() -> None:
    pace = slow()
    pace.ask(0.0)
    pace.confirm(b"1", 10.0)
    assert pace.max_bytes == LEAST_BYTES


def test_skipped_pong_is_not_awaited_and_the_client_stays_slow() -> None:
    pace = slow()
    pace.ask(0.0)
    pace.skip()
    assert (pace.is_waiting, pace.confirm(b"1", 0.1), pace.max_bytes) == (False, False, LEAST_BYTES)


def test_client_without_pongs_is_never_slow_again() -> None:
    pace = slow()
    pace.ask(0.0)
    pace.give_up()
    pace.note_pause(10.0)
    assert (pace.is_waiting, pace.max_bytes, pace.ask(1.0)) == (False, WRITE_BYTES, b"")
