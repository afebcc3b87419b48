"""Invariants of the stream, for every cut, merge and damage of the bytes."""

from collections.abc import Iterable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.core.protocol.rosserial.frame import MAX_PAYLOAD_BYTES, Frame, encode
from hostlink.core.protocol.rosserial.stream import FrameStream, Skipped
from tests.support.strategies import damaged, fewer_examples, frames, noise, split, topic_ids, wire_of

LIMIT_BYTES = 1024


def joined(reads: Iterable[bytes]) -> tuple[list[Frame | bytes], int]:
    """Return frames and joined skipped bytes in order, and the pending bytes."""
    stream = FrameStream(limit_bytes=LIMIT_BYTES)
    return joined_events(stream, reads), len(stream.pending)


def joined_events(stream: FrameStream, reads: Iterable[bytes]) -> list[Frame | bytes]:
    found: list[Frame | bytes] = []
    for read in reads:
        for event in stream.feed(read):
            if isinstance(event, Frame):
                found.append(event)
            elif found and isinstance(found[-1], bytes):
                found[-1] += event.data
            else:
                found.append(event.data)
    return found


# No whole frame in the payload, which would be read instead. Hypothesis draws some from literals of the code.
unambiguous = frames.filter(lambda frame: joined([wire_of(frame)]) == ([frame], 0))
nested = st.recursive(
    noise | frames.map(wire_of),
    lambda inner: st.builds(lambda topic_id, parts: encode(topic_id, b"".join(parts)), topic_ids, st.lists(inner)),
    max_leaves=6,
)
lines = st.lists(nested, max_size=12).map(b"".join)


@given(st.lists(unambiguous, max_size=10), st.data())
def test_encoded_frames_are_decoded(sent: list[Frame], data: st.DataObject) -> None:
    wire = b"".join(map(wire_of, sent))
    found, pending = joined(split(wire, data))
    assert found == sent
    assert pending == 0


# Payloads of which most bytes are syncs or headers: an int16 of -257 is a sync.
sync_payloads = st.lists(st.just(b"\xff\xfe") | noise | st.binary(max_size=4), max_size=40).map(b"".join)
sync_frames = st.builds(Frame, topic_ids, sync_payloads).filter(lambda frame: joined([wire_of(frame)]) == ([frame], 0))


@given(st.lists(sync_frames, max_size=10), st.data())
def test_intact_stream_with_syncs_in_its_payloads_counts_no_damage(sent: list[Frame], data: st.DataObject) -> None:
    stream = FrameStream(limit_bytes=LIMIT_BYTES)
    assert joined_events(stream, split(b"".join(map(wire_of, sent)), data)) == sent
    assert stream.rejected == {}


@fewer_examples(2)
@given(lines, st.data())
def test_every_split_counts_the_same_damage(wire: bytes, data: st.DataObject) -> None:
    whole, cut = FrameStream(limit_bytes=LIMIT_BYTES), FrameStream(limit_bytes=LIMIT_BYTES)
    line = damaged(wire, data)
    assert joined_events(whole, [line]) == joined_events(cut, split(line, data))
    assert whole.rejected == cut.rejected


@fewer_examples(2)
@given(lines, st.data())
def test_rejected_syncs_are_at_most_the_skipped_syncs(wire: bytes, data: st.DataObject) -> None:
    line = damaged(wire, data)
    stream = FrameStream(limit_bytes=LIMIT_BYTES)
    skipped = at = 0
    for event in (event for read in split(line, data) for event in stream.feed(read)):
        size = len(event.data) if isinstance(event, Skipped) else len(wire_of(event))
        if isinstance(event, Skipped):
            skipped += sum(line.startswith(b"\xff\xfe", start) for start in range(at, at + size))
        at += size
    assert stream.rejected.total() <= skipped


@pytest.mark.slow
@given(lines, st.data())
def test_every_split_gives_the_same_events(wire: bytes, data: st.DataObject) -> None:
    assert joined(split(wire, data)) == joined([wire])


@fewer_examples(2)
@given(lines, st.data())
def test_every_damage_gives_the_same_events_byte_by_byte(wire: bytes, data: st.DataObject) -> None:
    line = damaged(wire, data)
    assert joined(bytes([byte]) for byte in line) == joined([line])


def header(claim_bytes: int) -> bytes:
    return b"\xff\xfe" + claim_bytes.to_bytes(2, "little") + bytes([~(claim_bytes + (claim_bytes >> 8)) & 0xFF])


large_claims = st.integers(20_000, MAX_PAYLOAD_BYTES).map(header)
crowded = st.lists(large_claims | large_claims | nested, min_size=14, max_size=30).map(b"".join)


@pytest.mark.slow
@fewer_examples(2)
@given(crowded, st.integers(0, 70_000), st.data())
def test_every_split_gives_the_same_events_with_too_many_candidates(
    wire: bytes, padding_bytes: int, data: st.DataObject
) -> None:
    whole, cut = FrameStream(limit_bytes=MAX_PAYLOAD_BYTES), FrameStream(limit_bytes=MAX_PAYLOAD_BYTES)
    line = wire + bytes(padding_bytes) + wire
    assert joined_events(whole, [line]) == joined_events(cut, split(line, data))
    assert whole.rejected == cut.rejected
    assert len(whole.pending) == len(cut.pending)


def plainly_read(wire: bytes) -> list[Frame | bytes]:
    """Reference implementation: the first complete and correct frame wins; then continue after it."""
    found: list[Frame | bytes] = []
    at = 0
    while True:
        right = [(end, start) for start in range(at, len(wire)) if (end := right_end(wire, start))]
        if not right:
            return found
        end, start = min(right)
        if start > at:
            found.append(wire[at:start])
        found.append(Frame(int.from_bytes(wire[start + 5 : start + 7], "little"), wire[start + 7 : end - 1]))
        at = end


def right_end(wire: bytes, start: int) -> int:
    """Return the end of the frame at `start`; 0 if there is none."""
    size = int.from_bytes(wire[start + 2 : start + 4], "little")
    end = start + 8 + size
    if wire[start : start + 2] != b"\xff\xfe" or size > LIMIT_BYTES or end > len(wire):
        return 0
    are_right = sum(wire[start + 2 : start + 5]) % 256 == 255 and sum(wire[start + 5 : end]) % 256 == 255
    return end if are_right else 0


@fewer_examples(2)
@given(lines, st.data())
def test_stream_agrees_with_the_reference_implementation(wire: bytes, data: st.DataObject) -> None:
    line = damaged(wire, data)
    found, _ = joined(split(line, data))
    if found and isinstance(found[-1], bytes):  # how much of the end is already skipped depends on what may follow
        found.pop()
    assert found == plainly_read(line)


@fewer_examples(2)
@given(lines, st.data())
def test_no_byte_is_lost(wire: bytes, data: st.DataObject) -> None:
    line = damaged(wire, data)
    stream = FrameStream(limit_bytes=LIMIT_BYTES)
    observed = b""
    for read in split(line, data):
        for event in stream.feed(read):
            observed += event.data if isinstance(event, Skipped) else wire_of(event)
    assert len(observed) + len(stream.pending) == len(line)
    assert line.startswith(observed)
    assert len(stream.pending) <= LIMIT_BYTES + 8
    while stream.pending:
        for event in stream.give_up():
            observed += event.data if isinstance(event, Skipped) else wire_of(event)
    assert observed == line


@given(st.binary(max_size=40).map(lambda junk: junk.replace(b"\xff", b"")), unambiguous, st.data())
def test_junk_without_a_sync_never_costs_the_frame_after_it(junk: bytes, frame: Frame, data: st.DataObject) -> None:
    found, pending = joined(split(junk + wire_of(frame), data))
    assert found == ([junk] if junk else []) + [frame]
    assert pending == 0


@fewer_examples(2)
@given(lines, st.lists(unambiguous, min_size=1, max_size=5))
def test_enough_intact_frames_after_any_junk_are_found(wire: bytes, sent: list[Frame]) -> None:
    """A false header can hide a frame once. The frames after its claimed length are all found."""
    flood = b"".join(map(wire_of, sent)) * (LIMIT_BYTES // 8)
    found, _ = joined([wire + flood])
    assert all(frame in found for frame in sent)
