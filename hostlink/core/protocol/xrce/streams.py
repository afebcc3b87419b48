"""Streams of DDS-XRCE: numbers, loss, order, acknowledgements, fragments. One client's, host side.

A client's ACKNACK and HEARTBEAT tell where its numbers are. A restart of either side shows as numbers that do not fit.
They are accepted after REPEATS messages in a row: one late datagram of an earlier session must not move a stream,
because a client that gets a wrong acknowledgement loses its own numbers.
"""

from collections import deque
from collections.abc import Callable
from typing import Final

from hostlink.core.protocol.xrce.wire import LAST_FRAGMENT, NUMBERS, RELIABLE, Kind, Range, distance, number_after

WINDOW: Final = 16  # messages that an ACKNACK's bitmap can name
HISTORY: Final = 4  # messages that a client takes out of order: micro-ROS keeps four, other clients at least as many
REPEATS: Final = 3
ASKED_MAX: Final = 6  # at a loss of 20 % each way, one answer in 460 is lost as often
GIVEN_UP_S: Final = 0.25
LATE_S: Final = 0.5  # ACKNACKs that newer ones have overtaken arrive until then
MESSAGE_BYTES_MAX: Final = 1024 * 1024  # one message from fragments; the limit of messages between programs
HELD_BYTES_MAX: Final = 4 * 65536  # messages that wait for one before them: a client's history of the largest MTU


class FragmentBuffer:
    """Joins the fragments of a message."""

    __slots__ = ("_is_dropped", "_parts", "_size_bytes", "dropped")

    def __init__(self) -> None:
        self.dropped = 0  # messages that were too long
        self._parts: list[bytes] = []
        self._size_bytes = 0
        self._is_dropped = False

    @property
    def size_bytes(self) -> int:
        """Size of the fragments so far."""
        return self._size_bytes

    def skip_message(self) -> None:
        """Drop fragments up to the last one of a message, whose beginning is not known."""
        self._parts.clear()
        self._size_bytes = 0
        self._is_dropped = True

    def end_skipping(self) -> None:
        """Note that a message began behind the one that was skipped."""
        self._is_dropped = False

    def add(self, part: bytes, *, is_last: bool) -> bytes | None:
        """Add a fragment. Return the message if it is whole."""
        if not self._is_dropped:
            self._parts.append(part)
            self._size_bytes += len(part)
            if self._size_bytes > MESSAGE_BYTES_MAX:
                self.dropped += 1
                self.skip_message()
        if not is_last:
            return None
        whole = None if self._is_dropped else b"".join(self._parts)
        self._parts.clear()
        self._size_bytes = 0
        self._is_dropped = False
        return whole


class BestEffortInput:
    """Stream of messages from a client without acknowledgements. A late one is dropped."""

    __slots__ = ("_last",)

    def __init__(self, *, is_resumed: bool = False) -> None:
        self._last: int | None = None if is_resumed else NUMBERS - 1

    def lost_before(self, number: int) -> int:
        """Note the number of a message. Return how many were lost before it; -1 if it is late itself."""
        if self._last is None:
            self._last = number
            return 0
        ahead = distance(self._last, number)
        if ahead > 0:
            self._last = number
        return max(ahead - 1, -1)


class ReliableInput:
    """Stream of messages that a client repeats until they are acknowledged. They are delivered in order.

    `next` is the number that is expected. After a restart of the host it is unknown until the client tells it.
    """

    __slots__ = (
        "_announced",
        "_asked",
        "_asked_for",
        "_asked_since_s",
        "_far",
        "_far_at",
        "_held",
        "_held_bytes",
        "_resumed_at",
        "duplicates",
        "fragments",
        "is_known",
        "next",
        "skipped",
        "stream",
    )

    def __init__(self, stream: int, *, is_resumed: bool = False) -> None:
        self.stream = stream
        self.next = 0
        self.is_known = not is_resumed
        self._announced = NUMBERS - 1  # the last number that the client is known to have sent
        self.fragments = FragmentBuffer()
        self.duplicates = 0
        self.skipped = 0  # numbers that were given up
        self._held: dict[int, bytes] = {}
        self._held_bytes = 0
        self._far = 0  # messages in a row that do not fit
        self._far_at = 0
        self._asked_for = -1  # the number that the client is asked for
        self._asked_since_s = 0.0
        self._asked = 0  # ACKNACKs since then
        self._resumed_at = -1  # the first number after a restart of the host
        if is_resumed:
            self.fragments.skip_message()

    def receive(self, number: int, body: bytes) -> list[bytes]:
        """Return the bodies that can be read now, in order."""
        if self.is_known and number == self.next:  # nearly always
            self._far = 0
            if distance(self._announced, number) > 0:
                self._announced = number
            self.next = number_after(number)
            return [body, *self._in_order()] if self._held else [body]
        if not self.is_known:
            self.next, self._announced, self._resumed_at, self.is_known = number, number, number, True
        ahead = distance(self.next, number)
        if not -WINDOW <= ahead < WINDOW and not self._is_moved(number, number):
            return []
        ahead = distance(self.next, number)
        self._far = 0
        if distance(self._announced, number) > 0:
            self._announced = number
        if ahead < 0 or number in self._held:
            self.duplicates += 1
            return []
        if ahead > 0:
            if self._held_bytes + len(body) <= HELD_BYTES_MAX:
                self._held[number] = body
                self._held_bytes += len(body)
            return []
        self.next = number_after(number)
        return [body, *self._in_order()]

    def heartbeat(self, first: int, last: int) -> list[bytes]:
        """Note which messages the client keeps. Return the bodies that can be read now: what it lost is given up."""
        if not self.is_known:
            self.next, self._announced, self._resumed_at, self.is_known = first, last, first, True
        ahead = distance(self.next, first)
        # It keeps at most what was not acknowledged: a first number behind `next` is of a lost acknowledgement.
        is_odd = ahead > 0 or distance(self.next, last) < -1 - WINDOW
        if not is_odd:
            self._far = 0
            if distance(self._announced, last) > 0:
                self._announced = last
        elif self._is_moved(first, last):
            return self._in_order()
        return []

    def note_asked(self, now_s: float) -> bool:
        """Note that the client is asked for what is missing. Return whether it is to be asked again."""
        if self._asked_for != self.next:
            self._asked_for, self._asked_since_s, self._asked = self.next, now_s, 0
        self._asked += 1
        return self._asked <= ASKED_MAX

    def give_up(self, now_s: float) -> list[bytes]:
        """Give up a number for which the client was asked too often. Return the bodies that can be read then.

        A client that reads an older ACKNACK after a newer one forgets what it keeps, and announces it all the same. It
        would wait for ever.
        """
        is_asked = self._asked_for == self.next and self._asked >= ASKED_MAX
        if not is_asked or not self.missing() or now_s - self._asked_since_s < GIVEN_UP_S:
            return []
        self.skipped += 1
        self.next = number_after(self.next)
        self.fragments.skip_message()
        return self._in_order()

    @property
    def kept_bytes(self) -> int:
        """Size of fragments, and of what waits for messages before it."""
        return self._held_bytes + self.fragments.size_bytes

    def drop_unfinished(self) -> None:
        """Drop them. The client sends again what was not acknowledged."""
        self._held.clear()
        self._held_bytes = 0
        if self.fragments.size_bytes:
            self.fragments.skip_message()

    @property
    def has_begun(self) -> bool:
        """Whether a message has come, or was announced."""
        return self.next != 0 or self._announced != NUMBERS - 1

    def missing(self) -> int:
        """Return the bitmap of the numbers from `next` on that are known to be missing."""
        known = distance(self.next, self._announced) + 1
        if known <= 0:
            return 0
        bitmap = 0
        for ahead in range(min(known, WINDOW)):
            if number_after(self.next, ahead) not in self._held:
                bitmap |= 1 << ahead
        return bitmap

    def is_judged(self, number: int) -> bool:
        """Whether a loss or a repetition of a number tells about the way to the client.

        What it sent while there was no host, and some messages more, does not: they were not acknowledged.
        """
        return self._resumed_at < 0 or not -WINDOW <= distance(self._resumed_at, number) < WINDOW

    @property
    def fits(self) -> bool:
        """Whether `next` may be acknowledged: the last messages fit it."""
        return self.is_known and not self._far

    def _is_moved(self, first: int, last: int) -> bool:
        """Note a number that does not fit. Return whether the stream continues there from now on."""
        is_near = abs(distance(self._far_at, last)) <= WINDOW
        self._far = self._far + 1 if is_near and self._far else 1
        self._far_at = last
        if self._far < REPEATS:
            return False
        self.skipped += max(distance(self.next, first), 0)
        self.next = first
        self._announced = last
        self._far = 0
        self._held = {number: body for number, body in self._held.items() if 0 <= distance(first, number) < WINDOW}
        self._held_bytes = sum(map(len, self._held.values()))
        self.fragments.skip_message()
        return True

    def _in_order(self) -> list[bytes]:
        found: list[bytes] = []
        while (body := self._held.pop(self.next, None)) is not None:
            self._held_bytes -= len(body)
            found.append(body)
            self.next = number_after(self.next)
        return found


class _Sent:
    """A message that waits for its acknowledgement."""

    __slots__ = ("at_s", "body", "is_repeated")

    def __init__(self, body: bytes, at_s: float) -> None:
        self.body, self.at_s, self.is_repeated = body, at_s, False


class ReliableOutput:
    """Stream of messages that the host repeats until the client acknowledges them. At most `window` wait for that."""

    __slots__ = (
        "_judged_s",
        "_odd",
        "_odd_at",
        "_odd_since_s",
        "_refused_to",
        "_tried",
        "_unacked",
        "announced",
        "first",
        "is_known",
        "is_new",
        "is_unanswered",
        "limit",
        "next",
        "passed",
        "proven",
        "refused",
        "resent",
        "stream",
        "window",
    )

    def __init__(self, stream: int = RELIABLE, *, first: int = 0, is_known: bool = True) -> None:
        """`is_known`: the client expects `first`. Otherwise it is an earlier number, and the client will tell."""
        self.stream, self.window = stream, HISTORY
        self.limit = WINDOW  # fragments of a message that the client may keep
        self.proven = 1  # fragments of a message that it keeps for sure
        self.passed: list[bytes] = []  # fragments that it keeps as a whole
        self.refused = 0  # messages that it cannot keep, or about which it did not tell
        self.is_unanswered = False  # the last one that was tried was dropped without an answer
        self._refused_to = -1  # behind the last number of a refused one, of which the client tells
        self._judged_s = float("-inf")  # when the answer to a trial counts
        self._tried: list[bytes] = []
        self.first = self.next = first
        # First fragment of the message that is not acknowledged as a whole. A client forgets the fragments that it
        # keeps when a HEARTBEAT begins behind them.
        self.announced = first
        self.is_known = is_known
        self.is_new = False  # of a new client, which expects 0: other numbers are of its session before
        self.resent = 0
        self._unacked: deque[_Sent] = deque()
        self._odd = 0
        self._odd_at = -1
        self._odd_since_s = 0.0

    @property
    def has_room(self) -> bool:
        """Whether one more message may be sent."""
        return self.is_known and not self._tried and len(self._unacked) < self.window

    @property
    def is_waiting(self) -> bool:
        """Whether the client has not acknowledged everything, or its number is unknown."""
        return bool(self._unacked or self._tried) or not self.is_known

    def put(self, body: bytes, now_s: float) -> int:
        """Add a message and return its number. Call it only if there is room."""
        number = self.next
        self._unacked.append(_Sent(body, now_s))
        self.next = number_after(number)
        return number

    def acknowledge(self, told: Range, now_s: float, *, older_than_s: float) -> list[tuple[int, bytes]]:
        """Note an ACKNACK. Return what to send again, by its number: what was last sent before `older_than_s`."""
        acked = distance(self.first, told.first)
        if not self.is_known or not 0 <= acked <= len(self._unacked):
            if self.is_new or not self._is_moved(told.first, now_s):
                return []
            self.end_trial(is_kept=False)
            again = [(number_after(self.first, place), sent) for place, sent in enumerate(self._unacked)]
            return [(number, self._repeat(sent, now_s)) for number, sent in again]
        self._odd, self._odd_at = 0, -1
        self.is_new = self.is_new and not acked
        for _ in range(acked):
            body = self._unacked.popleft().body
            self.first = number_after(self.first)
            if body[0] != Kind.FRAGMENT or body[1] & LAST_FRAGMENT:
                self.announced = self.first
        if self._tried and told.second and now_s >= self._judged_s:
            self.end_trial(is_kept=not told.second >> len(self._tried) - 1 & 1)
        missing = [place for place in range(len(self._unacked)) if told.second >> place & 1]
        due = [(place, self._unacked[place]) for place in missing if self._unacked[place].at_s <= now_s - older_than_s]
        return [(number_after(self.first, place), self._repeat(sent, now_s)) for place, sent in due]

    def blank(self, is_blanked: Callable[[bytes], bool], empty: bytes) -> int:
        """Replace bodies that may be sent again by an empty one: their numbers are given. Return how many."""
        found = [each for each in self._unacked if is_blanked(each.body)]
        for each in found:
            each.body = empty
        return len(found)

    # -- messages that may be longer than the client's history ---------------------------------------------------------

    def begin_trial(self, bodies: list[bytes], now_s: float = 0.0) -> None:
        """Try whether the client keeps as many messages as this one has fragments. Call it when nothing is waited for.

        A client whose history is shorter would never take the message, and no other one after it. So the last fragment
        is sent first: the ACKNACK says whether the client keeps it. If not, its number is free for another message.
        After an earlier trial the client tells of the numbers of that one, too: only a later ACKNACK answers this one.
        """
        self._tried = bodies
        is_clear = self._refused_to < 0 or distance(self.next, self._refused_to) < 0
        self._judged_s = float("-inf") if is_clear else now_s + LATE_S

    def trial(self) -> tuple[int, bytes] | None:
        """Return the number and the body of the fragment that is tried; None if there is none."""
        return (number_after(self.next, len(self._tried) - 1), self._tried[-1]) if self._tried else None

    def end_trial(self, *, is_kept: bool, is_told: bool = True) -> None:
        """End a trial. The fragments are `passed` if the client keeps the last one, and its limit is known if not.

        `is_told`: the client has told it. Otherwise the message is dropped, and the next one is tried again.
        """
        self.is_unanswered = bool(self._tried) and not is_kept and not is_told
        if is_kept:
            self.passed, self.proven = self._tried, len(self._tried)
            self.window = max(self.window, self.proven)
        elif self._tried:
            self.refused += 1
            self._refused_to = number_after(self.next, WINDOW)
            if is_told:
                self.limit = min(self.limit, len(self._tried) - 1)
        self._tried = []

    def _repeat(self, sent: _Sent, now_s: float) -> bytes:
        sent.at_s, sent.is_repeated = now_s, True
        self.resent += 1
        return sent.body

    def _is_moved(self, first: int, now_s: float) -> bool:
        """Note a number that does not fit. Return whether the stream continues there from now on.

        An earlier number that is told again and again may be that of late ACKNACKs. A message would arrive twice then.
        """
        if first != self._odd_at:
            self._odd, self._odd_since_s = 0, now_s
        self._odd, self._odd_at = self._odd + 1, first
        if self.is_known and (self._odd < REPEATS or now_s < self._odd_since_s + LATE_S):
            return False
        self._odd = 0
        self.is_known = True
        self.first = self.announced = first
        self.next = number_after(first, len(self._unacked))
        return True
