"""Acknowledger: what the guardian answers a board whose host is gone."""

import struct
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.core.protocol.xrce.acknowledging import STREAMS_MAX, Acknowledger
from tests.support.xrce_board import FRAGMENT, HEARTBEAT, WRITE, Datagrams, Lengths, Serial, ahead, sub

FRAMINGS = {"udp": Datagrams, "tcp": Lengths, "serial": Serial}


def message(number: int, *, session: int = 0x81, stream: int = 0x80, key: bytes = b"", body: bytes = b"") -> bytes:
    return struct.pack("<BBH", session, stream, number) + key + (body or sub(WRITE, bytes(8)))


def acknack(first: int, *, session: int = 0x81, stream: int = 0x80, key: bytes = b"") -> bytes:
    return struct.pack("<BBH", session, 0, 0) + key + sub(10, struct.pack("<HHB", first, 0, stream))


@pytest.mark.parametrize("framing", FRAMINGS)
def test_message_of_a_reliable_stream_is_acknowledged_in_the_framing_of_the_transport(framing: str) -> None:
    board = FRAMINGS[framing]()
    (answer,) = Acknowledger(framing).receive(board.encode(message(7)))
    assert board.decode(answer) == [acknack(8)]


def test_answer_has_the_session_the_key_and_the_stream_of_what_it_answers() -> None:
    ours = Acknowledger("udp")
    assert ours.receive(message(0xFFFF, session=0x01, key=b"abcd")) == [acknack(0, session=0x01, key=b"abcd")]
    assert ours.receive(message(3, stream=0x81)) == [acknack(4, stream=0x81)]


def test_heartbeat_is_answered_with_the_number_after_its_last() -> None:
    body = sub(HEARTBEAT, struct.pack("<HHB", 3, 5, 0x80))
    assert Acknowledger("udp").receive(message(0, stream=0, body=body)) == [acknack(6)]


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\x81\x80",
        message(1, stream=0x01),
        message(1, stream=0),
        message(0, stream=0, body=sub(HEARTBEAT, b"\0")),
        message(0, stream=0, body=sub(HEARTBEAT, bytes(5))),
    ],
)
def test_bytes_of_no_reliable_stream_are_not_answered(data: bytes) -> None:
    assert Acknowledger("udp").receive(data) == []


def test_late_message_is_answered_with_the_newest_number() -> None:
    """A client that reads an older ACKNACK after a newer one forgets what it keeps."""
    ours = Acknowledger("udp")
    numbers = [0xFFFE, 0, 0xFFFF, 1, 0xFFFE]
    assert [ours.receive(message(each)) for each in numbers] == [[acknack(each)] for each in (0xFFFF, 1, 1, 2, 2)]


def test_bytes_of_several_messages_have_one_answer_for_each_stream() -> None:
    board, ours = Lengths(), Acknowledger("tcp")
    parts = [message(each, body=sub(FRAGMENT, bytes(20))) for each in (4, 5)]
    answers = ours.receive(b"".join(map(board.encode, [*parts, message(9, stream=0x81)])))
    assert [board.decode(each) for each in answers] == [[acknack(6)], [acknack(10, stream=0x81)]]


def test_streams_that_it_keeps_are_limited() -> None:
    ours = Acknowledger("udp")
    for session in range(0x80, 0x80 + STREAMS_MAX):
        assert len(ours.receive(message(1, session=session))) == 1
    assert ours.receive(message(1, session=0xFF)) == []
    assert ours.receive(message(2, session=0x80)) == [acknack(3, session=0x80)]


@given(st.sampled_from(sorted(FRAMINGS)), st.lists(st.binary(max_size=60) | st.builds(message, st.integers(0, 0xFFFF))))
def test_any_bytes_raise_nothing_and_no_answer_is_older_than_the_one_before(framing: str, parts: list[bytes]) -> None:
    board, ours, before = FRAMINGS[framing](), Acknowledger(framing), dict[bytes, int]()
    random = Random(len(parts))
    for part in parts:
        for answer in ours.receive(part if random.random() < 0.5 else board.encode(part)):
            (decoded,) = board.decode(answer)
            place, first = decoded[:1] + decoded[-1:], int.from_bytes(decoded[-5:-3], "little")
            if decoded[0] >= 0x80:
                assert ahead(before.get(place, first), first) >= 0
                before[place] = first
