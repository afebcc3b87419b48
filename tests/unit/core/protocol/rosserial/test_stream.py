"""FrameStream: a table of the bytes that a line may carry."""

import pytest

from hostlink.core.protocol.rosserial.frame import Frame, encode
from hostlink.core.protocol.rosserial.stream import MAX_CLAIMED_BYTES, FrameStream, Rejection, Skipped

A, B = Frame(125, b"first"), Frame(126, b"second")
WIRE_A, WIRE_B = encode(*A), encode(*B)
LIAR = b"\xff\xfe\xe8\xfd\x1a"  # claims 65000 bytes


def events(stream: FrameStream, *reads: bytes) -> list[Frame | Skipped]:
    return [event for read in reads for event in stream.feed(read)]


def frames(stream: FrameStream, *reads: bytes) -> list[Frame]:
    return [event for event in events(stream, *reads) if isinstance(event, Frame)]


@pytest.mark.parametrize(
    "junk",
    [
        b"x",
        b"\xff",
        b"\xff\xff",
        b"\xff\xfe",
        b"\xff\xfe\xff",
        WIRE_B[:5],
        WIRE_B[:-1],
        b"\xff\xfe\x00\x01\xfe\x7d\x00abc",
    ],
    ids=["text", "FF", "two FF", "sync", "two syncs", "half a header", "cut frame", "claims 256 bytes"],
)
def test_good_frame_after_junk_is_found(junk: bytes) -> None:
    stream = FrameStream()
    assert events(stream, junk + WIRE_A) == [Skipped(junk), A]


def test_rejected_syncs_inside_a_right_frame_are_not_counted() -> None:
    """Bad length checksum, bad checksum, length over the limit, wrong size, and too many headers: nothing was lost."""
    wrong = bytes([*b"\xff\xfe\x01\x00\xfe\x7d\x00x", 0])
    payload = b"".join([b"\xff\xfe" * 9, wrong, b"\xff\xfe\x00\x10\xef", encode(125, b"four")])
    stream = FrameStream(fixed_bytes={125: 24})
    assert (
        events(stream, encode(130, payload), *[bytes([byte]) for byte in encode(130, payload)])
        == [Frame(130, payload)] * 2
    )
    assert stream.rejected == {}
    crowded = Frame(130, candidates_with_one_end(1000, 7000)[:-1])
    large = FrameStream(limit_bytes=65535)
    assert events(large, encode(*crowded)) == [crowded]
    assert large.rejected == {}


def test_rejected_syncs_inside_a_damaged_frame_are_counted() -> None:
    stream = FrameStream()
    broken = bytearray(encode(125, b"ab\xff\xfecdefghij"))
    broken[-2] ^= 1
    assert frames(stream, bytes(broken) + WIRE_B) == [B]
    assert stream.rejected == {Rejection.CHECKSUM: 1, Rejection.LENGTH_CHECKSUM: 1}


def test_damaged_payload_costs_its_frame_and_no_other() -> None:
    stream = FrameStream()
    broken = bytearray(WIRE_A)
    broken[9] ^= 1
    found = events(stream, bytes(broken) + WIRE_B)
    assert found[-1] == B
    assert b"".join(event.data for event in found if isinstance(event, Skipped)) == broken
    assert stream.rejected == {Rejection.CHECKSUM: 1}


def test_frame_inside_a_false_frame_is_found_at_once() -> None:
    """A damaged length field claims more bytes than will arrive. The next frame does not wait for them."""
    stream = FrameStream()
    false_header = b"\xff\xfe\xe8\x03\x14\x7d\x00"
    assert frames(stream, false_header + WIRE_A) == [A]


def test_nested_false_headers_are_skipped() -> None:
    stream = FrameStream()
    liar = b"\xff\xfe\x20\x00\xdf"
    assert frames(stream, liar * 5 + WIRE_A + liar + WIRE_B) == [A, B]


def test_default_limit_applies_before_topics_are_known() -> None:
    largest = Frame(125, bytes(1024))
    stream = FrameStream()
    assert frames(stream, encode(*largest), encode(125, bytes(1025)), WIRE_A) == [largest, A]
    assert stream.rejected[Rejection.TOO_LONG] == 1


def test_unread_frames_are_kept_when_the_caller_stops_iterating() -> None:
    """A caller that wants one frame leaves the rest of a read to the next call."""
    stream = FrameStream()
    assert next(stream.feed(WIRE_A + WIRE_B + WIRE_A)) == A
    assert frames(stream, WIRE_B) == [B, A, B]
    assert len(stream.pending) == 0


def test_length_above_the_limit_is_rejected() -> None:
    stream = FrameStream(limit_bytes=100)
    big = encode(125, bytes(101))
    assert frames(stream, big + WIRE_A) == [A]
    assert stream.rejected[Rejection.TOO_LONG] == 1
    stream.limit_bytes = 101
    assert frames(stream, big) == [Frame(125, bytes(101))]


def test_size_that_the_type_cannot_have_is_damage() -> None:
    fixed = {125: 24}
    stream = FrameStream(fixed_bytes=fixed)
    assert frames(stream, WIRE_A + WIRE_B) == [B]
    assert stream.rejected == {Rejection.WRONG_SIZE: 1}
    fixed[125] = 5
    assert frames(stream, WIRE_A) == [A]


def test_changed_limit_applies_to_the_next_frame_of_the_same_read() -> None:
    fixed: dict[int, int] = {}
    stream = FrameStream(fixed_bytes=fixed)
    found = []
    for event in stream.feed(WIRE_B + WIRE_A):
        found.append(event)
        fixed[125] = 24
    assert found[0] == B
    assert A not in found


def test_incomplete_frame_is_given_up_and_its_bytes_are_read_again() -> None:
    stream = FrameStream()
    assert events(stream, b"\xff\xfe\x10\x00\xef\x7d\x00" + WIRE_A[:6]) == []
    assert list(stream.give_up()) == [Skipped(b"\xff\xfe\x10\x00\xef\x7d\x00")]
    assert events(stream, WIRE_A[6:]) == [A]
    assert stream.rejected == {Rejection.INCOMPLETE: 1}


def test_give_up_with_an_empty_buffer_does_nothing() -> None:
    stream = FrameStream()
    assert list(stream.give_up()) == []
    assert stream.rejected == {}


def test_give_up_after_an_unfinished_iteration_keeps_the_frames_that_were_not_read() -> None:
    stream = FrameStream()
    assert next(stream.feed(WIRE_A + LIAR + WIRE_B)) == A
    assert list(stream.give_up()) == [Skipped(LIAR), B]
    assert stream.rejected == {Rejection.INCOMPLETE: 1}


def test_half_a_sync_is_given_up_too() -> None:
    stream = FrameStream()
    assert events(stream, b"\xff") == []
    assert list(stream.give_up()) == [Skipped(b"\xff")]


def test_give_up_of_the_outer_frame_keeps_the_inner_one() -> None:
    stream = FrameStream()
    liar = b"\xff\xfe\x20\x00\xdf"
    assert events(stream, liar + b"\xff\xfe\x21\x00\xde" + WIRE_A[:6]) == []
    assert list(stream.give_up()) == [Skipped(liar)]
    assert frames(stream, WIRE_A[6:]) == [A]
    assert len(stream.pending) == 0


def candidates_with_one_end(count: int, size_bytes: int) -> bytes:
    """Headers that all claim to end at the last byte, none with the right checksum there."""
    wire = bytearray(size_bytes)
    for at in range(0, 6 * count, 6):
        claim_bytes = size_bytes - at - 8
        low, high = claim_bytes & 0xFF, claim_bytes >> 8
        wire[at : at + 6] = bytes([0xFF, 0xFE, low, high, ~(low + high) & 0xFF, 4])  # the six bytes sum to 0 modulo 256
    return bytes(wire)


@pytest.mark.parametrize("read_bytes", [1, 512, 65536])
@pytest.mark.parametrize(("count", "size_bytes"), [(10_000, 65_543), (5000, 65_543), (260, 65_543), (1000, 7000)])
def test_one_byte_completes_few_candidates(count: int, size_bytes: int, read_bytes: int) -> None:
    stream = FrameStream(limit_bytes=65535)
    wire = candidates_with_one_end(count, size_bytes)
    before = wire[:-1]
    assert events(stream, *[before[at : at + read_bytes] for at in range(0, len(before), read_bytes)]) == []
    assert stream.rejected == {}  # a frame around all of them may still be correct
    assert frames(stream, wire[-1:]) == []
    assert stream.rejected.keys() == {Rejection.TOO_MANY, Rejection.CHECKSUM}
    claims_bytes = [size_bytes - at for at in range(0, 6 * count, 6)]
    assert sum(claims_bytes[: stream.rejected[Rejection.CHECKSUM]]) <= MAX_CLAIMED_BYTES
    assert stream.rejected.total() == count
    assert frames(stream, WIRE_A + WIRE_B) == [A, B]


def test_as_many_candidates_as_a_small_limit_allows_are_all_followed() -> None:
    stream = FrameStream()
    assert frames(stream, candidates_with_one_end(170, 1032) + WIRE_A) == [A]
    assert stream.rejected == {Rejection.CHECKSUM: 170}


def test_among_too_many_candidates_the_first_to_end_is_followed() -> None:
    stream = FrameStream(limit_bytes=65535)
    large = Frame(130, bytes(3000))
    assert frames(stream, LIAR * 5 + encode(*large) + WIRE_A) == [large, A]
    assert stream.rejected == {Rejection.TOO_MANY: 2}
