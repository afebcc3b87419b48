"""Acknowledger: lets a board go on whose host is gone, so that it reads the zeros. For the guardian.

A client waits for up to a second until a reliable message is acknowledged, and its program takes no velocity meanwhile.
"""

from typing import Final

from hostlink.core.protocol.xrce.framing import framing_on
from hostlink.core.protocol.xrce.wire import (
    NO_STREAM,
    RELIABLE,
    Kind,
    Message,
    decode_heartbeat,
    decode_message,
    decode_submessages,
    distance,
    encode_acknack,
    encode_message,
    number_after,
)

STREAMS_MAX: Final = 16  # of all clients behind one address


class Acknowledger:
    """Acknowledges the newest message that a board is known to have sent, also when one before it was lost.

    It needs no session: the header of a message has what the header of its answer needs. It asks for nothing again,
    because its messages are not read.
    """

    def __init__(self, transport: str) -> None:
        """`transport`: as in `framing_on`."""
        self._framing = framing_on(transport)()
        self._newest: dict[tuple[int, bytes, int], int] = {}  # number, by session, key and stream

    def receive(self, data: bytes) -> list[bytes]:
        """Return the writes that answer these bytes: one for each stream."""
        answers: dict[tuple[int, bytes, int], bytes] = {}
        for each in self._framing.feed(data):
            message = decode_message(each)
            if message is None:
                continue
            for stream, number in _announced(message):
                place = (message.session, message.key, stream)
                newest = self._newest.get(place, number)
                if place not in self._newest and len(self._newest) >= STREAMS_MAX:
                    continue
                # An older ACKNACK makes a client forget what it keeps.
                newest = self._newest[place] = number if distance(newest, number) > 0 else newest
                acknack = encode_acknack(number_after(newest), 0, stream)
                answers[place] = encode_message(message.session, message.key, NO_STREAM, 0, acknack)
        return [self._framing.encode(each) for each in answers.values()]


def _announced(message: Message) -> list[tuple[int, int]]:
    """Return reliable streams and the newest number that the client has sent on each, as a message tells."""
    if message.stream >= RELIABLE:
        return [(message.stream, message.number)]
    if message.stream != NO_STREAM:
        return []
    heartbeats = [each for each in decode_submessages(message.body)[0] if each.kind == Kind.HEARTBEAT]
    told = [range_ for range_ in map(decode_heartbeat, heartbeats) if range_ is not None]
    return [(range_.stream, range_.second) for range_ in told if range_.stream >= RELIABLE]
