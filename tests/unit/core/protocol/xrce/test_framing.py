"""Framings: datagrams, lengths on TCP, frames with checksums on serial lines."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.core.protocol.xrce.framing import (
    BEGIN,
    ESCAPE,
    CapturedDatagramFraming,
    DatagramFraming,
    Framing,
    LengthFraming,
    SerialFraming,
    crc16,
)

MESSAGE = bytes.fromhex("80000000 02010800 000AFFFD02000000")
messages = st.binary(min_size=4, max_size=80) | st.just(bytes((BEGIN, ESCAPE)) * 4)
noise = st.binary(max_size=20).map(lambda data: data.replace(bytes((BEGIN,)), b""))


def fed(framing: Framing, *pieces: bytes) -> tuple[list[bytes], bytes]:
    """Return the messages and the skipped bytes."""
    found, skipped = [], b""
    for piece in pieces:
        found += framing.feed(piece)
        skipped += b"".join(framing.skipped)
    return found, skipped


def cut(data: bytes, places: list[int]) -> list[bytes]:
    ends = sorted(place % (len(data) + 1) for place in places)
    return [data[start:end] for start, end in zip([0, *ends], [*ends, len(data)], strict=True)]


def test_checksum_is_that_of_the_polynomial_8005_reflected() -> None:
    assert crc16(b"123456789") == 0xBB3D


def test_ping_on_a_serial_line_is_the_frame_that_a_board_sends() -> None:
    frame = SerialFraming().encode(MESSAGE)
    assert frame[:5] == bytes.fromhex("7E 00 01 1000")
    assert frame[5:-2] == MESSAGE
    assert frame[-2:] == crc16(MESSAGE).to_bytes(2, "little")


def test_datagram_is_a_message() -> None:
    framing = DatagramFraming()
    assert fed(framing, MESSAGE) == ([MESSAGE], b"")
    assert framing.encode(MESSAGE) == MESSAGE


@given(st.lists(messages, max_size=5), st.lists(st.integers(0, 500), max_size=5))
def test_messages_on_tcp_are_found_however_their_bytes_are_cut(sent: list[bytes], places: list[int]) -> None:
    framing = LengthFraming()
    data = b"".join(map(framing.encode, sent))
    assert fed(framing, *cut(data, places)) == (sent, b"")


@given(st.lists(st.tuples(noise, messages), max_size=5), noise, st.lists(st.integers(0, 500), max_size=5))
def test_messages_on_a_serial_line_are_found_between_noise(
    sent: list[tuple[bytes, bytes]], end: bytes, places: list[int]
) -> None:
    framing = SerialFraming()
    data = b"".join(before + framing.encode(message) for before, message in sent) + end
    found, skipped = fed(framing, *cut(data, places))
    assert found == [message for _, message in sent]
    assert skipped == b"".join(before for before, _ in sent) + end


@given(messages, messages, st.integers(0, 200))
def test_frame_that_another_one_interrupts_is_skipped(first: bytes, second: bytes, place: int) -> None:
    framing = SerialFraming()
    part = framing.encode(first)
    part = part[: place % len(part)]
    found, skipped = fed(framing, part + framing.encode(second))
    assert found == [second]
    assert skipped == part


@given(messages, st.data())
def test_damaged_byte_costs_its_frame_and_no_other(message: bytes, data: st.DataObject) -> None:
    framing = SerialFraming()
    frame = bytearray(framing.encode(message))
    frame[data.draw(st.integers(5, len(frame) - 1))] ^= data.draw(st.integers(1, 255))
    found, _ = fed(framing, bytes(frame), framing.encode(MESSAGE))
    assert found[-1] == MESSAGE


def test_wrong_checksum_and_a_length_without_a_header_are_counted() -> None:
    framing = SerialFraming()
    frame = bytearray(framing.encode(MESSAGE))
    frame[-1] ^= 1
    assert fed(framing, bytes(frame)) == ([], bytes(frame))
    short = framing.encode(b"abc")
    assert fed(framing, short) == ([], short)
    assert (framing.bad_checksums, framing.bad_lengths) == (1, 1)


@given(st.lists(st.binary(max_size=60), max_size=8), st.sampled_from([SerialFraming, LengthFraming, DatagramFraming]))
def test_any_bytes_raise_nothing(pieces: list[bytes], kind: type[Framing]) -> None:
    framing = kind()
    fed(framing, *pieces)
    assert sum(map(len, framing.skipped)) <= sum(map(len, pieces))


@given(st.lists(st.binary(max_size=60), max_size=8))
def test_no_byte_of_a_serial_line_is_lost(pieces: list[bytes]) -> None:
    framing = SerialFraming()
    found, skipped = fed(framing, *pieces)
    rest = b"".join(framing.skipped) if framing.feed(bytes((BEGIN,))) == [] else b""
    if not found:
        assert skipped + rest == b"".join(pieces)


def test_frame_without_an_end_is_skipped_when_the_next_one_begins() -> None:
    framing = SerialFraming()
    assert fed(framing, b"\x7e\0\1\xff\xff" + bytes(100)) == ([], b"")
    assert fed(framing, framing.encode(MESSAGE)) == ([MESSAGE], b"\x7e\0\1\xff\xff" + bytes(100))


@pytest.mark.parametrize("piece", [b"\x7d", b"\x7d\x7d", b"\x7d\x7d\x5d"])
def test_escape_at_the_end_of_a_read_belongs_to_the_next(piece: bytes) -> None:
    framing = SerialFraming()
    framing.feed(b"\x7e\0\1")
    framing.feed(piece)
    assert fed(framing, framing.encode(MESSAGE))[0] == [MESSAGE]


@given(st.lists(st.binary(min_size=4, max_size=300), min_size=1, max_size=5), st.binary(min_size=1, max_size=100))
def test_messages_before_a_captured_datagram_are_read_one_by_one(messages: list[bytes], datagram: bytes) -> None:
    joined = DatagramFraming().joined(messages)
    assert CapturedDatagramFraming().feed(joined) == messages
    assert CapturedDatagramFraming().feed(joined + datagram) == [*messages, datagram]
    assert CapturedDatagramFraming().feed(datagram) == [datagram]


@pytest.mark.parametrize("framing", [DatagramFraming, LengthFraming, SerialFraming])
def test_first_whole_message_of_a_capture_is_found_or_none(framing: type[Framing]) -> None:
    message = bytes.fromhex("81800500 07010400 00150015")
    pieces = [framing().encode(message) for _ in range(8)]
    for cut in range(1, len(pieces[0])):
        cut_bytes = framing().rest_bytes([pieces[0][cut:], *pieces[1:]])
        rest = b"".join([pieces[0][cut:], *pieces[1:]])[cut_bytes:]
        assert rest == b"".join(pieces[1:])
    assert framing().rest_bytes([]) == 0
    assert framing().rest_bytes([b"\1\2\3"]) == 3
