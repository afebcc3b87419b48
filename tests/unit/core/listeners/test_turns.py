"""Turns of two protocols at one port: which of them has it, in virtual time."""

import asyncio

from hostlink.core.listeners.turns import OWN_S, Turn
from hostlink.core.protocol.registry import find_protocol
from hostlink.core.protocol.rosserial.frame import Id, encode
from hostlink.core.protocol.xrce.framing import SerialFraming
from tests.support.memory_transport import MemoryTransport, memory_pair
from tests.support.virtual_loop import virtual

PING = SerialFraming().encode(bytes.fromhex("80000000 02010800 000AFFFD 02000000"))
TIME_REQUEST = encode(Id.TIME, bytes(8))


def turn_of(own: str) -> tuple[Turn, MemoryTransport, list[str]]:
    """The turn of one protocol, the device's end, and a list of what ended it."""
    transport, device = memory_pair()
    other = "micro-ros" if own == "rosserial" else "rosserial"
    turn, ends = Turn(transport, find_protocol(other, "serial")), list[str]()
    turn.on_other = lambda: ends.append(other)
    return turn, device, ends


@virtual
async def test_first_message_of_the_other_protocol_ends_the_turn_and_is_the_next_one_s() -> None:
    for own, message in (("rosserial", PING), ("micro-ros", TIME_REQUEST)):
        turn, device, ends = turn_of(own)
        await device.send(b"boot text\r\n")
        assert turn.read(4096) == b"boot text\r\n"
        await device.send(message[:5])
        assert turn.read(4096) == message[:5]
        await device.send(message[5:])
        assert turn.read(4096) == b""
        assert len(ends) == 1
        following = Turn(turn, find_protocol(own, "serial"), first=turn.taken)
        assert following.unread_bytes == len(turn.taken)
        assert message in following.read(4096)


@virtual
async def test_bytes_that_look_like_the_other_protocol_do_not_end_a_turn_at_work() -> None:
    turn, device, ends = turn_of("rosserial")
    count = 0
    turn.count_own = lambda: count
    for _ in range(20):
        await device.send(TIME_REQUEST)
        turn.read(4096)
        count += 1
        await device.send(PING)  # as a part of a message
        assert turn.read(4096) == PING
        await asyncio.sleep(OWN_S / 2)
    await asyncio.sleep(OWN_S)
    await device.send(PING)
    assert turn.read(4096) == b""
    assert ends == ["micro-ros"]


@virtual
async def test_noise_and_text_end_no_turn() -> None:
    for own in ("rosserial", "micro-ros"):
        turn, device, ends = turn_of(own)
        for data in (b"~~~~~~~~ hello ~\r\n", bytes(range(256)) * 8, b"\xff" * 500, b"\x7e\x00\x01\x04\x00" * 100):
            await device.send(data)
            assert turn.read(4096) == data
        assert not ends


@virtual
async def test_port_stays_open_only_for_the_next_turn() -> None:
    turn, device, _ = turn_of("rosserial")
    await device.send(PING)
    turn.read(4096)
    await turn.aclose()
    assert not turn.is_ended
    turn, _, _ = turn_of("rosserial")
    await turn.aclose()
    assert turn.is_ended
