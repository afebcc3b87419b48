"""Encoding of frames, with the examples of the protocol's documentation."""

import pytest

from hostlink.core.protocol.rosserial.frame import (
    STOP_REQUEST,
    TOPICS_REQUEST,
    Id,
    byte_sum,
    contains_protocol_1,
    encode,
)


@pytest.mark.parametrize(
    ("topic_id", "payload", "wire"),
    [
        (Id.PUBLISHER, b"", "ff fe 00 00 ff 00 00 ff"),
        (Id.STOP, b"", "ff fe 00 00 ff 0b 00 f4"),
        (Id.TIME, bytes(8), "ff fe 08 00 f7 0a 00 00 00 00 00 00 00 00 00 f5"),
        (125, b"\x01\x02", "ff fe 02 00 fd 7d 00 01 02 7f"),
        (0x0180, b"\xff" * 300, "ff fe 2c 01 d2 80 01 " + "ff " * 300 + "aa"),
    ],
)
def test_known_frames_are_encoded(topic_id: int, payload: bytes, wire: str) -> None:
    assert encode(topic_id, payload) == bytes.fromhex(wire)


def test_two_requests_of_a_host() -> None:
    assert bytes.fromhex("fffe0000ff0000ff") == TOPICS_REQUEST
    assert bytes.fromhex("fffe0000ff0b00f4") == STOP_REQUEST


def test_payload_longer_than_the_length_field_is_refused() -> None:
    with pytest.raises(ValueError, match="payload of 65536 bytes, a frame holds at most 65535"):
        encode(125, bytes(65536))


@pytest.mark.parametrize("size", [0, 1, 255, 256, 257, 5000])
def test_short_and_long_sums_agree(size: int) -> None:
    data = bytes(number * 7 % 256 for number in range(size))
    assert byte_sum(data) % 256 == sum(data) % 256


def protocol_1(topic_id: int, payload: bytes) -> bytes:
    body = topic_id.to_bytes(2, "little") + len(payload).to_bytes(2, "little") + payload
    return b"\xff\xff" + body + bytes([255 - sum(body) % 256])


@pytest.mark.parametrize(
    ("data", "is_there"),
    [
        (protocol_1(10, bytes(8)), True),
        (b"junk\xff" + protocol_1(125, b"hello") + b"more", True),
        (protocol_1(10, bytes(8))[:-1], False),
        (b"\xff\xff\x0a\x00\x08\x00" + bytes(8) + b"\x00", False),
        (b"\xff" * 64, False),
        (b"", False),
    ],
)
def test_protocol_version_1_is_recognised(data: bytes, is_there: bool) -> None:
    assert contains_protocol_1(data) is is_there
