"""TCPROS as bytes: headers, messages, malformed headers, and messages over the bound."""

import contextlib
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.components.ros1.tcpros import (
    MAX_FIELDS,
    BadHeader,
    MessageStream,
    decode_header,
    encode_answer,
    encode_failure,
    encode_header,
    encode_message,
)

TEXT = st.text(st.characters(codec="utf-8"), max_size=20)


def test_the_layout_of_a_header() -> None:
    """Example of http://wiki.ros.org/ROS/TCPROS: a length, then the fields with a length each."""
    field = b"callerid=/talker"
    body = struct.pack("<I", len(field)) + field + struct.pack("<I", 10) + b"latching=0"
    assert decode_header(body) == {"callerid": "/talker", "latching": "0"}
    assert encode_header({"callerid": "/talker", "latching": "0"}) == struct.pack("<I", len(body)) + body


@given(st.dictionaries(TEXT.filter(lambda key: key and "=" not in key), TEXT, max_size=8))
def test_a_header_is_read_as_it_was_written(fields: dict[str, str]) -> None:
    assert decode_header(encode_header(fields)[4:]) == fields


@given(st.binary(max_size=200))
def test_any_bytes_are_a_header_or_a_bad_one(body: bytes) -> None:
    with contextlib.suppress(BadHeader):
        assert decode_header(body) == decode_header(encode_header(decode_header(body))[4:])


@pytest.mark.parametrize(
    "body",
    [b"\x01", struct.pack("<I", 5) + b"a=b", struct.pack("<I", 1) + b"a", struct.pack("<I", 2) + b"=b", b"\xff" * 8],
)
def test_malformed_header_is_refused(body: bytes) -> None:
    with pytest.raises(BadHeader):
        decode_header(body)


def test_a_header_of_too_many_fields() -> None:
    with pytest.raises(BadHeader):
        decode_header(encode_header({str(number): "" for number in range(MAX_FIELDS + 1)})[4:])


@given(st.lists(st.binary(max_size=30)), st.lists(st.integers(1, 20)))
def test_every_split_gives_the_same_messages(payloads: list[bytes], cuts: list[int]) -> None:
    wire = b"".join(map(encode_message, payloads))
    stream = MessageStream(1000)
    found: list[bytes] = []
    for cut in [*cuts, len(wire)]:
        found += stream.feed(wire[:cut])
        wire = wire[cut:]
    assert found == payloads


@given(st.lists(st.integers(0, 40), max_size=12), st.integers(1, 64))
def test_a_message_that_is_too_large_is_passed_over_and_no_other(sizes: list[int], cut: int) -> None:
    wire = b"".join(encode_message(bytes([size]) * size) for size in sizes)
    stream = MessageStream(20)
    found = [len(each) for at in range(0, len(wire), cut) for each in stream.feed(wire[at : at + cut])]
    assert found == [size for size in sizes if size <= 20]
    assert stream.too_large == sum(size > 20 for size in sizes)
    assert stream.missing_bytes == 0


def test_a_length_of_four_gigabytes_keeps_nothing() -> None:
    stream = MessageStream(20)
    assert list(stream.feed(b"\xff\xff\xff\xff" + bytes(5000))) == []
    assert stream.missing_bytes == 0xFFFFFFFF - 5000
    assert len(stream._buffer) == 0


def test_the_bound_may_change_between_two_messages() -> None:
    stream = MessageStream(2)
    found = []
    for payload in stream.feed(encode_message(b"ab") + encode_message(b"abc")):
        found.append(payload)
        stream.max_bytes = 3
    assert found == [b"ab", b"abc"]


def test_the_missing_part_of_a_message_is_known() -> None:
    stream = MessageStream(100)
    assert stream.missing_bytes == 0
    assert list(stream.feed(encode_message(bytes(50))[:24])) == []
    assert stream.missing_bytes == 30


def test_the_answers_of_a_service() -> None:
    assert encode_answer(b"ab") == b"\x01\x02\x00\x00\x00ab"
    assert encode_failure("no") == b"\x00\x02\x00\x00\x00no"
