"""Faults of a line, decided by a script and a seed: bytes and a time in, bytes and a time out. Pure.

`FaultyLine` is one direction of one connection, `Schedule` has the faults that are due. `chaos.py` moves the bytes.
"""

import random
from collections import deque
from dataclasses import dataclass, field
from enum import Enum
from typing import NamedTuple

SPLIT_GAP_S = 0.001  # between two pieces, so that they arrive as two
BOOT_NOISE_BYTES = 400  # docs/protocol.md#what-real-devices-do-wrong: an ESP8266's boot message at 74880 baud


class Direction(Enum):
    """Direction of bytes."""

    TO_DEVICE = "to-device"
    FROM_DEVICE = "from-device"


class Span(NamedTuple):
    """A number, or any between two."""

    low: float
    high: float

    def draw(self, dice: random.Random) -> float:
        """One of it."""
        return self.low if self.low == self.high else dice.uniform(self.low, self.high)

    def draw_int(self, dice: random.Random) -> int:
        """A whole one of it."""
        return dice.randint(round(self.low), round(self.high))


class Kind(Enum):
    """A fault that happens at a time."""

    LOSE = "lose"  # a segment is lost: TCP sends it again after so many seconds, and all that came since with it
    BLACKOUT = "blackout"  # the same for every connection and both directions, new ones too
    DROP = "drop"  # so many bytes vanish, as from a full ring
    DAMAGE = "damage"  # so many bytes become others, as on a bad wire
    DUPLICATE = "duplicate"  # so many bytes come twice
    CUT = "cut"  # every connection is reset at both ends
    CLOSE = "close"  # every connection is closed in good order
    HALF_OPEN = "half-open"  # the device's end is reset, the host never learns of it
    REBOOT = "reboot"  # the device is away for so many seconds, and returns with boot noise


NO_DELAY_S = Span(0.0, 0.0)
OF_BYTES = (Kind.DROP, Kind.DAMAGE, Kind.DUPLICATE)
AMOUNTS = {  # what a fault is without a number: bytes, or seconds
    Kind.LOSE: Span(0.2, 1.2),  # the time-outs after which TCP sends again, first and second
    Kind.BLACKOUT: Span(10.0, 10.0),
    Kind.DROP: Span(1, 8),
    Kind.DAMAGE: Span(1, 1),
    Kind.DUPLICATE: Span(1, 8),
    Kind.REBOOT: Span(3.0, 3.0),
}


@dataclass(frozen=True, slots=True)
class Rule:
    """A fault and when: `at` from the start, or after the one before if it `repeats`."""

    at_s: Span
    repeats: bool
    kind: Kind
    amount: Span
    direction: Direction | None = None  # None: both


@dataclass(frozen=True, slots=True)
class Habits:
    """Properties of a line that affect all bytes."""

    split_bytes: Span | None = None
    merge_s: float = 0.0
    delay_s: Span = NO_DELAY_S
    rate_bytes_s: float | None = None


@dataclass(frozen=True, slots=True)
class Script:
    """All that a relay needs to know; the same seed and the same bytes at the same times give the same faults."""

    seed: int = 0
    habits: Habits = field(default_factory=Habits)
    rules: tuple[Rule, ...] = ()
    length_s: float | None = None


class Fault(NamedTuple):
    """A fault that is due."""

    kind: Kind
    amount: float
    direction: Direction | None


class Schedule:
    """The faults of a script, each once its time has come."""

    def __init__(self, script: Script) -> None:
        self._dice = [random.Random(f"{script.seed} rule {number}") for number in range(len(script.rules))]  # noqa: S311
        self._rules = script.rules
        self._due_s: list[float | None] = [
            rule.at_s.draw(dice) for rule, dice in zip(script.rules, self._dice, strict=True)
        ]

    def next_s(self) -> float | None:
        """Time of the next fault; None if no fault follows."""
        return min((due_s for due_s in self._due_s if due_s is not None), default=None)

    def pop_due(self, now_s: float) -> list[Fault]:
        """Remove and return the faults that are due, in order of time."""
        found: list[tuple[float, Fault]] = []
        for number, (rule, dice) in enumerate(zip(self._rules, self._dice, strict=True)):
            while (due_s := self._due_s[number]) is not None and due_s <= now_s:
                amount = rule.amount.draw_int(dice) if rule.kind in OF_BYTES else rule.amount.draw(dice)
                found.append((due_s, Fault(rule.kind, amount, rule.direction)))
                self._due_s[number] = due_s + rule.at_s.draw(dice) if rule.repeats else None
        return [fault for _, fault in sorted(found, key=lambda pair: pair[0])]


class FaultyLine:
    """One direction of a connection. Bytes arrive in order, later, in other pieces, and possibly damaged."""

    def __init__(self, habits: Habits, seed: str) -> None:
        self.waiting_bytes = 0
        self.harmed: dict[Kind, int] = dict.fromkeys(OF_BYTES, 0)  # bytes
        self._habits = habits
        self._dice = random.Random(seed)  # noqa: S311 - a fault that can be repeated
        self._waiting: deque[tuple[float, bytes]] = deque()
        self._last_due_s = self._free_at_s = self._still_until_s = float("-inf")
        self._harm: dict[Kind, int] = dict.fromkeys(OF_BYTES, 0)  # ordered, for the next bytes

    def send(self, data: bytes, now_s: float) -> None:
        """Put bytes on the line."""
        for piece_number, piece in enumerate(self._split(self._harm_some(data))):
            due_s = now_s + max(0.0, self._habits.delay_s.draw(self._dice))
            gap_s = SPLIT_GAP_S if piece_number else 0.0
            due_s = max(due_s, self._last_due_s + gap_s)  # TCP keeps the order
            if self._habits.rate_bytes_s is not None:
                self._free_at_s = max(self._free_at_s, now_s) + len(piece) / self._habits.rate_bytes_s
                due_s = max(due_s, self._free_at_s)
            if self._habits.merge_s:
                due_s = -(-due_s // self._habits.merge_s) * self._habits.merge_s
            self._last_due_s = due_s
            self._waiting.append((due_s, piece))
            self.waiting_bytes += len(piece)

    def pop_due(self, now_s: float) -> list[bytes]:
        """Remove and return the pieces that arrive by now. Pieces that were held together arrive as one."""
        if now_s < self._still_until_s:
            return []
        pieces: list[bytes] = []
        last_due_s = None
        while self._waiting and self._waiting[0][0] <= now_s:
            due_s, piece = self._waiting.popleft()
            due_s = max(due_s, self._still_until_s)
            if due_s == last_due_s:
                pieces[-1] += piece
            else:
                pieces.append(piece)
            last_due_s = due_s
        self.waiting_bytes -= sum(map(len, pieces))
        return pieces

    def next_s(self) -> float | None:
        """Time at which the next piece arrives; None if the line is empty."""
        return max(self._waiting[0][0], self._still_until_s) if self._waiting else None

    def stand_still(self, until_s: float) -> None:
        """Hold all pieces until then, without loss."""
        self._still_until_s = max(self._still_until_s, until_s)

    def harm(self, kind: Kind, count: int) -> None:
        """Drop, damage or duplicate so many of the next bytes."""
        self._harm[kind] += count

    def heal(self) -> None:
        """No harm that was not done yet will be."""
        self._harm = dict.fromkeys(OF_BYTES, 0)

    def cut(self) -> None:
        """Drop the pieces on the line."""
        self._waiting.clear()
        self.waiting_bytes = 0

    def _split(self, data: bytes) -> list[bytes]:
        span = self._habits.split_bytes
        if span is None:
            return [data] if data else []
        pieces = []
        while data:
            size = max(1, span.draw_int(self._dice))
            pieces.append(data[:size])
            data = data[size:]
        return pieces

    def _harm_some(self, data: bytes) -> bytes:
        """Somewhere in these bytes, as far as they reach; the rest waits for the next."""
        line = bytearray(data)
        for kind, wanted in self._harm.items():
            count = min(wanted, len(line))
            if count:
                at = self._dice.randint(0, len(line) - count)
                self._harm_at(line, kind, at, count)
                self._harm[kind] -= count
                self.harmed[kind] += count
        return bytes(line)

    def _harm_at(self, line: bytearray, kind: Kind, at: int, count: int) -> None:
        if kind is Kind.DROP:
            del line[at : at + count]
        elif kind is Kind.DUPLICATE:
            line[at:at] = line[at : at + count]
        else:
            for place in range(at, at + count):
                line[place] ^= self._dice.randint(1, 255)


def boot_noise(dice: random.Random) -> bytes:
    """Return the bytes that a host reads while an ESP8266 prints its boot message: garbage with many FF."""
    return bytes(0xFF if dice.random() < 1 / 4 else dice.randrange(256) for _ in range(BOOT_NOISE_BYTES))
