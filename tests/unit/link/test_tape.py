"""The tape of a link: the last 64 KiB with their times, in bounded memory, whatever the pieces."""

from hypothesis import given
from hypothesis import strategies as st

from hostlink.link.tape import TAPE_BYTES, Tape


def contents(tape: Tape, since: int = 0) -> bytes:
    return b"".join(piece.data for piece in tape.pieces(since))


def test_it_gives_back_what_passed_with_the_times() -> None:
    tape = Tape()
    tape.add(b"abc", 1.0)
    tape.add(b"", 1.5)
    tape.add(b"de", 2.0)
    assert list(tape.pieces()) == [(1.0, 3, b"abc"), (2.0, 5, b"de")]
    assert list(tape.pieces(4)) == [(2.0, 5, b"e")]
    assert list(tape.pieces(5)) == []
    assert tape.lost_bytes() == 0


@given(st.lists(st.integers(0, 3 * TAPE_BYTES), max_size=6), st.integers(0, 9 * TAPE_BYTES))
def test_what_it_keeps_is_the_end_of_what_passed(sizes: list[int], since: int) -> None:
    tape, passed = Tape(), b""
    for number, size in enumerate(sizes):
        data = bytes([number]) * size
        tape.add(data, float(number))
        passed += data
    kept = contents(tape)
    assert len(kept) >= min(len(passed), TAPE_BYTES)
    assert len(kept) <= 1.25 * TAPE_BYTES
    assert passed.endswith(kept)
    assert tape.total_bytes == len(passed)
    assert contents(tape, since) == passed[max(since, len(passed) - len(kept)) :]
    assert tape.lost_bytes(since) == max(0, len(passed) - len(kept) - since)


def test_single_bytes_are_all_kept_and_their_times_stay_in_order_and_few() -> None:
    tape = Tape()
    for number in range(3 * TAPE_BYTES):
        tape.add(bytes([number & 0xFF]), number / 1000)
    pieces = list(tape.pieces())
    assert len(contents(tape)) >= TAPE_BYTES
    assert len(pieces) <= 4096
    times = [piece.time_s for piece in pieces]
    assert times == sorted(times)
    for piece in pieces:
        first = piece.end - len(piece.data)
        assert 0 <= first / 1000 - piece.time_s <= 0.1  # the earlier time of neighbours, never a later one
