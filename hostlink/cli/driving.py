"""Velocity of the pressed keys, from the bytes of a terminal and the time. Pure.

When keys stop arriving, the velocity becomes zero.
"""

import re
from enum import Enum
from typing import Literal, NamedTuple

# -- keys -------------------------------------------------------------------------------------------------------------

ARROWS = {"A": "up", "B": "down", "C": "right", "D": "left"}
SHIFT, CONTROL = 1, 4  # bits of the modifiers of the kitty keyboard protocol, less 1
_SEQUENCE = re.compile(rb"\x1b\[(\??)([\d;:]*)([A-Za-z~])")
_UNFINISHED = re.compile(rb"\x1b(\[[\d;:?]*)?$")

GRACE_S = 0.6  # from the first press of a key to its first repeat: half a second on usual systems
HOLD_S = 0.2  # between repeats: a little more than three periods
STEP = 1.1  # a speed key changes by a tenth
SEND_INTERVAL_S = 0.1
ZEROS = 3  # one may be lost on a radio link

Direction = tuple[int, int]  # forward, counter-clockwise
Velocity = tuple[float, float, float]  # m/s forward, rad/s counter-clockwise, m/s to the left
STANDING: Velocity = (0.0, 0.0, 0.0)

_ORIGINAL: dict[str, Direction] = {
    "w": (1, 0), "e": (1, -1),
    "a": (0, 1), "d": (0, -1),
    "z": (-1, -1), "x": (-1, 0), "c": (-1, 1),
}  # fmt: skip
_FIELD: dict[str, Direction] = {
    "u": (1, 1), "i": (1, 0), "o": (1, -1),
    "j": (0, 1), "l": (0, -1),
    "m": (-1, -1), ",": (-1, 0), ".": (-1, 1),
    "up": (1, 0), "down": (-1, 0), "left": (0, 1), "right": (0, -1),
}  # fmt: skip
_ORIGINAL_SPEEDS: dict[str, tuple[float, float]] = {
    "t": (STEP, STEP), "b": (1 / STEP, 1 / STEP),
    "y": (STEP, 1), "n": (1 / STEP, 1),
    "u": (1, STEP), "m": (1, 1 / STEP),
}  # fmt: skip
_FIELD_SPEEDS: dict[str, tuple[float, float]] = {
    "q": (STEP, STEP), "z": (1 / STEP, 1 / STEP),
    "w": (STEP, 1), "x": (1 / STEP, 1),
    "e": (1, STEP), "c": (1, 1 / STEP),
}  # fmt: skip

LAYOUTS: dict[str, tuple[dict[str, Direction], dict[str, tuple[float, float]]]] = {
    # u and m change the turning speed, as in the original; the other keys of the field drive, and q ends the command.
    "original": ({**_FIELD, **_ORIGINAL}, _ORIGINAL_SPEEDS),
    "twist": (_FIELD, _FIELD_SPEEDS),
}

CONFIRM_S = 4.0  # as on the page


class Action(Enum):
    """Event of a key."""

    PRESSED = "1"
    REPEATED = "2"
    RELEASED = "3"


class Key(NamedTuple):
    """Key by its letter, or by name: up, down, left, right, space, escape, ctrl-c."""

    name: str
    action: Action = Action.PRESSED
    is_shifted: bool = False


class KeyReader:
    """Parser of a terminal's bytes into keys; a sequence may arrive in pieces."""

    ENTER, LEAVE = "\x1b[>11u", "\x1b[<u"  # distinct keys, also releases, all keys as sequences

    def __init__(self) -> None:
        self._pending = b""

    def feed(self, data: bytes) -> list[Key]:
        """Return the keys that the bytes complete."""
        data = self._pending + data
        self._pending = b""
        keys = []
        while data:
            if sequence := _SEQUENCE.match(data):
                data = data[sequence.end() :]
                key = _from_sequence(*(part.decode() for part in sequence.groups()))
                if key is not None:
                    keys.append(key)
            elif data != b"\x1b" and _UNFINISHED.match(data):
                self._pending = data
                break
            else:
                keys.append(_from_byte(data[:1]))
                data = data[1:]
        return keys


def _from_byte(data: bytes) -> Key:
    names = {b" ": "space", b"\x03": "ctrl-c", b"\x04": "ctrl-d", b"\x1b": "escape"}
    text = data.decode("ascii", errors="replace")
    return Key(names.get(data, text.lower()), is_shifted=text.isupper())


def _from_sequence(question: str, numbers: str, final: str) -> Key | None:
    """Read `ESC [ 1 ; modifiers : action A` of arrows, and `ESC [ code ; modifiers : action u` of other keys."""
    if question:  # an answer of the terminal to a query
        return None
    code, _, rest = numbers.partition(";")
    modifiers, _, action = rest.partition(":")
    happened = Action(action) if action in ("1", "2", "3") else Action.PRESSED
    held = int(modifiers) - 1 if modifiers.isdecimal() else 0
    is_shifted = bool(held & SHIFT)
    if final in ARROWS:
        return Key(ARROWS[final], happened, is_shifted)
    if final != "u" or not code.split(":")[0].isdecimal():
        return Key(f"sequence {numbers}{final}", happened)
    letter = chr(min(int(code.split(":")[0]), 0x10FFFF)).lower()
    if held & CONTROL:
        return Key(f"ctrl-{letter}", happened)
    return Key({" ": "space", "\x1b": "escape"}.get(letter, letter), happened, is_shifted)


# -- velocity ---------------------------------------------------------------------------------------------------------


_SHIFTED = {"<": ",", ">": "."}  # keys of the field with shift, as teleop_twist_keyboard has them


Layout = Literal["original", "twist"]


class Driving:
    """Keys that are held, and the velocity that they add up to.

    A terminal sends presses and repeats, and few send releases: a key counts as held for GRACE_S after its first press
    and for HOLD_S after each repeat. A key without a meaning stops the robot. Keys that are held at that moment have no
    effect until they are released and pressed again.

    With shift, a key that turns moves the robot sideways instead, if its drive can: set `has_y`. A drive that cannot
    turn in place is not asked to: set `turns_in_place`.
    """

    def __init__(self, *, layout: str, linear_m_s: float, angular_rad_s: float) -> None:
        directions, self._speed_keys = LAYOUTS[layout]
        self._directions = {key: way for key, way in directions.items() if key not in self._speed_keys}
        self.linear_m_s, self.angular_rad_s = linear_m_s, angular_rad_s
        self.has_y, self.turns_in_place = False, True
        self._shifted: set[str] = set()  # keys whose newest press or repeat came with shift
        self._held: dict[str, float] = {}  # key -> time at which it counts as released
        self._barred: dict[str, float] = {}  # key without effect -> time at which it counts as released
        self._zeros = 0
        self._send_at_s = float("-inf")

    def has_meaning(self, name: str) -> bool:
        """Whether the key drives or changes a speed in this layout."""
        return name in self._directions or name in self._speed_keys

    def receive(self, key: Key, now_s: float) -> None:
        """Apply the press, repeat or release of a key."""
        if self.has_y and key.name in _SHIFTED:
            key = Key(_SHIFTED[key.name], key.action, is_shifted=True)
        if self._is_barred(key, now_s):
            return
        if key.name in self._speed_keys:
            if key.action is not Action.RELEASED:
                self._change_speed(*self._speed_keys[key.name])
        elif key.action is Action.RELEASED:
            self._held.pop(key.name, None)
        elif key.name in self._directions:
            is_repeat = self._held.get(key.name, float("-inf")) > now_s
            self._held[key.name] = now_s + (HOLD_S if is_repeat else GRACE_S)
            (self._shifted.add if key.is_shifted else self._shifted.discard)(key.name)
        else:
            self.bar(now_s)

    def bar(self, now_s: float) -> None:
        """Release all keys. Keys that are held have no effect until they are released and pressed again."""
        self._barred |= dict.fromkeys(self._held, now_s + GRACE_S)
        self.stop()

    def _is_barred(self, key: Key, now_s: float) -> bool:
        """Whether a key has no effect. Without a repeat for longer than HOLD_S it counts as released."""
        if self._barred.get(key.name, float("-inf")) <= now_s or key.action is Action.RELEASED:
            self._barred.pop(key.name, None)
            return False
        self._barred[key.name] = max(self._barred[key.name], now_s + HOLD_S)
        return True

    def stop(self) -> None:
        """Release all keys."""
        self._held.clear()
        self._send_at_s = float("-inf")

    def velocity(self, now_s: float) -> Velocity:
        """Return the velocity of the keys that are held now."""
        self._held = {key: until_s for key, until_s in self._held.items() if until_s > now_s}
        ways = [self._way(key) for key in self._held]
        forward, turn, left = (max(-1, min(1, sum(way))) for way in zip(*ways, strict=True)) if ways else (0, 0, 0)
        if not (forward or left or self.turns_in_place):
            turn = 0
        return forward * self.linear_m_s, turn * self.angular_rad_s, left * self.linear_m_s

    def _way(self, key: str) -> tuple[int, int, int]:
        """Forward, counter-clockwise and to the left, of a held key. Back to the left is a clockwise curve."""
        forward, turn = self._directions[key]
        if self.has_y and key in self._shifted:
            return forward, 0, -turn if forward < 0 else turn
        return forward, turn, 0

    @property
    def is_ending(self) -> bool:
        """Whether zeros remain to be sent."""
        return self._zeros > 0

    def due(self, now_s: float) -> Velocity | None:
        """Return the velocity to send now: while driving, then ZEROS zeros; None if none is due."""
        velocity = self.velocity(now_s)
        is_moving = velocity != STANDING
        if is_moving:
            self._zeros = ZEROS
        elif self._zeros == ZEROS:
            self._send_at_s = float("-inf")  # the first zero does not wait
        if now_s < self._send_at_s or (not is_moving and self._zeros == 0):
            return None
        if not is_moving:
            self._zeros -= 1
        self._send_at_s = now_s + SEND_INTERVAL_S
        return velocity

    def _change_speed(self, linear: float, angular: float) -> None:
        """Change the speeds within limits; a speed key alone moves no robot."""
        self.linear_m_s = min(max(self.linear_m_s * linear, 0.01), 1.0)
        self.angular_rad_s = min(max(self.angular_rad_s * angular, 0.05), 4.0)


# -- confirmation -----------------------------------------------------------------------------------------------------


class Confirmation:
    """Key that acts only when it is pressed twice, with no other key in between. Repeats of a held key do not count.

    | event                                              | effect                                   |
    |----------------------------------------------------|------------------------------------------|
    | press of the key, nothing asked                    | asks, for CONFIRM_S                      |
    | press of the key, asked about the same subject     | confirmed; nothing is asked              |
    | press of the key, asked about another subject      | asks, for CONFIRM_S                      |
    | repeat of the key, also one that looks like a press | none                                    |
    | press of another key                               | nothing is asked                         |
    """

    def __init__(self, key: str) -> None:
        self._key = key
        self._subject: object = None  # of the question; None: nothing is asked
        self._asked_until_s = self._held_until_s = float("-inf")

    def is_asking(self, subject: object, now_s: float) -> bool:
        """Whether the next press confirms this subject."""
        return subject is not None and subject == self._subject and now_s < self._asked_until_s

    def receive(self, key: Key, now_s: float, subject: object) -> bool:
        """Return whether a key confirms the subject. Without one, None, nothing is asked."""
        if key.action is Action.RELEASED:
            self._held_until_s = float("-inf") if key.name == self._key else self._held_until_s
            return False
        if key.name != self._key:
            self._subject = None
            return False
        is_repeat = key.action is Action.REPEATED or now_s < self._held_until_s
        self._held_until_s = now_s + (HOLD_S if is_repeat else GRACE_S)
        if is_repeat:
            return False
        is_confirmed = self.is_asking(subject, now_s)
        self._subject = None if is_confirmed else subject
        self._asked_until_s = now_s + CONFIRM_S
        return is_confirmed
