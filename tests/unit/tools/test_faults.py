"""The relay's decisions: what a line does to bytes, and when faults are due."""

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tools.faults import BOOT_NOISE_BYTES, Fault, FaultyLine, Habits, Kind, Rule, Schedule, Script, Span, boot_noise

DATA = bytes(range(1, 101))


def drain(line: FaultyLine) -> list[tuple[float, bytes]]:
    """Return all pieces that arrive, with their times."""
    found = []
    while (next_s := line.next_s()) is not None:
        found += [(next_s, piece) for piece in line.pop_due(next_s)]
    return found


def test_a_line_without_habits_passes_bytes_at_once_as_they_came() -> None:
    line = FaultyLine(Habits(), "0")
    line.send(b"one", 1.0)
    assert (line.next_s(), line.pop_due(1.0)) == (1.0, [b"one"])
    line.send(b"two", 2.0)
    line.send(b"three", 2.5)
    assert line.pop_due(3.0) == [b"two", b"three"]
    assert (line.next_s(), line.waiting_bytes) == (None, 0)


def test_split_gives_pieces_of_the_requested_size_one_after_another() -> None:
    line = FaultyLine(Habits(split_bytes=Span(3, 3)), "0")
    line.send(DATA, 0.0)
    found = drain(line)
    assert [len(piece) for _, piece in found] == [3] * 33 + [1]
    assert len({at_s for at_s, _ in found}) == len(found)


def test_merge_gives_what_came_within_its_time_as_one() -> None:
    line = FaultyLine(Habits(merge_s=0.1), "0")
    for number in range(4):
        line.send(bytes([number]), 0.03 * number + 0.01)
    assert drain(line) == [(pytest.approx(0.1), b"\x00\x01\x02\x03")]


def test_rate_is_kept_on_average() -> None:
    line = FaultyLine(Habits(rate_bytes_s=100.0), "0")
    for _ in range(5):
        line.send(bytes(10), 0.0)
    assert [at_s for at_s, _ in drain(line)] == pytest.approx([0.1, 0.2, 0.3, 0.4, 0.5])


def test_lost_segment_delays_all_and_held_pieces_arrive_as_one() -> None:
    line = FaultyLine(Habits(), "0")
    line.stand_still(1.0)
    line.send(b"one", 0.1)
    line.send(b"two", 0.2)
    assert line.pop_due(0.9) == []
    assert line.next_s() == 1.0
    assert line.pop_due(1.0) == [b"onetwo"]


def test_a_cut_loses_what_is_on_the_line() -> None:
    line = FaultyLine(Habits(delay_s=Span(1.0, 1.0)), "0")
    line.send(b"one", 0.0)
    line.cut()
    assert (line.next_s(), line.pop_due(5.0), line.waiting_bytes) == (None, [], 0)


@pytest.mark.parametrize(("kind", "length"), [(Kind.DROP, 96), (Kind.DAMAGE, 100), (Kind.DUPLICATE, 104)])
def test_harm_is_done_once_to_the_next_bytes(kind: Kind, length: int) -> None:
    line = FaultyLine(Habits(), "0")
    line.harm(kind, 4)
    line.send(DATA, 0.0)
    line.send(DATA, 1.0)
    first, second = line.pop_due(1.0)
    assert len(first) == length
    assert first != DATA
    assert second == DATA
    assert line.harmed[kind] == 4


def test_harm_to_more_bytes_than_waiting_continues_with_the_next() -> None:
    line = FaultyLine(Habits(), "0")
    line.harm(Kind.DROP, 3)
    line.send(b"ab", 0.0)
    line.send(b"cdef", 0.0)
    assert len(b"".join(line.pop_due(0.0))) == 3


habits = st.builds(
    Habits,
    split_bytes=st.none() | st.builds(Span, st.integers(1, 5), st.integers(5, 9)),
    merge_s=st.sampled_from([0.0, 0.05]),
    delay_s=st.builds(Span, st.floats(0, 0.1), st.floats(0.1, 0.3)),
    rate_bytes_s=st.none() | st.floats(50.0, 5000.0),
)
story = st.lists(st.tuples(st.floats(0.0, 0.5), st.binary(max_size=60), st.sampled_from([0.0, 0.0, 0.4])), max_size=12)


@given(habits, story)
def test_without_harm_all_bytes_come_out_in_order_and_never_early(
    habits: Habits, story: list[tuple[float, bytes, float]]
) -> None:
    line = FaultyLine(habits, "0")
    now_s, found, last_s = 0.0, b"", 0.0
    for pause_s, data, still_s in story:
        now_s += pause_s
        if still_s:
            line.stand_still(now_s + still_s)
        line.send(data, now_s)
        found += b"".join(line.pop_due(now_s))
        assert line.next_s() is None or line.next_s() > now_s
    for at_s, piece in drain(line):
        assert at_s >= last_s
        found, last_s = found + piece, at_s
    assert found == b"".join(data for _, data, _ in story)


@given(habits, story, st.integers(0, 9))
def test_the_same_seed_gives_the_same_faults(
    habits: Habits, story: list[tuple[float, bytes, float]], seed: int
) -> None:
    def run() -> list[tuple[float, bytes]]:
        line = FaultyLine(habits, str(seed))
        now_s = 0.0
        for pause_s, data, _ in story:
            now_s += pause_s
            line.harm(Kind.DAMAGE, 2)
            line.send(data, now_s)
        return drain(line)

    assert run() == run()


def test_a_schedule_gives_each_fault_once_its_time_has_come() -> None:
    rules = (
        Rule(Span(10, 10), repeats=False, kind=Kind.CUT, amount=Span(0, 0)),
        Rule(Span(4, 4), repeats=True, kind=Kind.LOSE, amount=Span(1, 1)),
    )
    schedule = Schedule(Script(rules=rules))
    lose, cut = Fault(Kind.LOSE, 1, None), Fault(Kind.CUT, 0, None)
    assert schedule.next_s() == 4
    assert schedule.pop_due(3.9) == []
    assert schedule.pop_due(8.0) == [lose, lose]
    assert schedule.pop_due(12.0) == [cut, lose]
    assert schedule.next_s() == 16


def test_boot_noise_is_the_same_each_time() -> None:
    noise = boot_noise(random.Random(1))
    assert noise == boot_noise(random.Random(1))
    assert len(noise) == BOOT_NOISE_BYTES
    assert noise.count(0xFF) > BOOT_NOISE_BYTES / 10
