"""Evidence: whether the client at an address is the one of a stored state. Decided by its numbers and messages.

Session 0x81, that of the stock libraries, sends no client key. Another board may have taken the address or the serial
port. So each contrary message ends the client, and a velocity waits until something of the client's own fits.
"""

from typing import Final

from hostlink.core.protocol.xrce.resume import ClientState
from hostlink.core.protocol.xrce.streams import WINDOW
from hostlink.core.protocol.xrce.wire import distance

ACKNOWLEDGING_S: Final = 0.5  # a client with a reliable stream acknowledges something until then
MESSAGES: Final = 3  # of a client without one, that fit the state
SETTLING_S: Final = 1.0  # a client that publishes seldom may be silent for longer; most others are not
LISTENER_SETTLING_S: Final = 0.4  # of one that publishes nothing, where only a wrong one speaks
DOUBT_S: Final = 10.0  # what contradicts a confirmed client until then ends it
STORED_PAUSE_S: Final = 5.0  # a state is stored again when nothing was sent for so long, or as many as `sent_step`
UNSTORED_SENT: Final = 32  # messages that were sent until the state was on the disk
STORED_BITS: Final = 12  # a state is stored again when 4,096 numbers of the client have passed
UNSTORED_TAKEN: Final = (1 << STORED_BITS) + 2048  # with those that the guardian has acknowledged


def sent_step(number: int) -> int:
    """Return how many messages may be sent behind a number before the state is stored again."""
    return 16 + (number >> 3)


class Evidence:
    """Numbers and messages of a resumed client, weighed against the stored state."""

    __slots__ = (
        "_has_told", "_is_sure", "_late_messages", "_messages", "_publishes", "doubted_until_s", "settled_s", "stored",
    )  # fmt: skip

    def __init__(self, stored: ClientState, *, publishes: bool) -> None:
        """`publishes`: its messages may be expected."""
        self.stored, self._publishes = stored, publishes
        self.settled_s = float("inf")  # an acknowledgement that fits is enough from then on, or never is
        self.doubted_until_s = float("inf")
        self._has_told = False  # its number is one that the host can have reached
        self._is_sure = False  # the host had reached it for sure
        self._messages = self._late_messages = 0  # that fit the state

    def fits_acknack(self, first: int, now_s: float) -> bool:
        """Note the number that the client expects. Return whether the host can have sent all before it.

        A number that the host had surely reached when the state was stored is better: it needs no message with it.
        With another number a client that never publishes shows nothing more, and is given up.
        """
        stored = self.stored
        passed, sent = distance(stored.number, first), distance(stored.number, stored.sent)
        if not 0 <= passed <= sent + sent_step(stored.sent) + UNSTORED_SENT:
            return False
        self._has_told, self._is_sure = True, passed <= sent
        if self._is_sure:
            self.settled_s = now_s + (SETTLING_S if self._publishes else LISTENER_SETTLING_S)
        elif not self._publishes:
            self.settled_s = now_s + DOUBT_S
        return True

    def fits_input(self, stream: int, number: int) -> bool:
        """Whether the client can have reached a number of its reliable stream: few pass without a host."""
        return -WINDOW <= distance(self.stored.inputs.get(stream, 0), number) + 1 <= UNSTORED_TAKEN

    def note_message(self, passed_s: float) -> None:
        """Note a message of an object that the client created, and of its type. `passed_s`: of the connection."""
        self._messages += 1
        self._late_messages += passed_s >= ACKNOWLEDGING_S

    def is_enough(self, now_s: float) -> bool:
        """Whether the client is the one of the state. One that has acknowledged messages will do so again."""
        if self._has_told:
            return self._messages > 0 or (self._is_sure and now_s >= self.settled_s)
        return self.stored.number == 0 and self._late_messages >= MESSAGES
