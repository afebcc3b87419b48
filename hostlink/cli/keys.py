"""Keys: what a terminal sends when one is pressed, repeated or (where it sends that) released. Pure."""

import re
from enum import Enum
from typing import NamedTuple

ARROWS = {"A": "up", "B": "down", "C": "right", "D": "left"}
CONTROL = 4  # the bit of the modifiers in the kitty keyboard protocol, less 1
_SEQUENCE = re.compile(rb"\x1b\[(\??)([\d;:]*)([A-Za-z~])")
_UNFINISHED = re.compile(rb"\x1b(\[[\d;:?]*)?$")
_ENTER_KITTY, _LEAVE_KITTY = "\x1b[>11u", "\x1b[<u"  # keys apart, releases too, all keys as sequences


class Action(Enum):
    """What happened to a key."""

    PRESSED = "1"
    REPEATED = "2"
    RELEASED = "3"


class Key(NamedTuple):
    """A key by its letter, or by name: up, down, left, right, space, escape, ctrl-c."""

    name: str
    action: Action = Action.PRESSED


class KeyReader:
    """Bytes of a terminal in, keys out; a sequence may come in pieces."""

    ENTER = _ENTER_KITTY
    LEAVE = _LEAVE_KITTY

    def __init__(self) -> None:
        self._pending = b""

    def feed(self, data: bytes) -> list[Key]:
        """The keys in what has come."""
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
    return Key(names.get(data, data.decode("ascii", errors="replace").lower()))


def _from_sequence(question: str, numbers: str, final: str) -> Key | None:
    """`ESC [ 1 ; modifiers : action A` for arrows, `ESC [ code ; modifiers : action u` for other keys."""
    if question:  # the answer to a question about the terminal
        return None
    code, _, rest = numbers.partition(";")
    modifiers, _, action = rest.partition(":")
    happened = Action(action) if action in ("1", "2", "3") else Action.PRESSED
    if final in ARROWS:
        return Key(ARROWS[final], happened)
    if final != "u" or not code.split(":")[0].isdecimal():
        return Key(f"sequence {numbers}{final}", happened)
    letter = chr(min(int(code.split(":")[0]), 0x10FFFF)).lower()
    if modifiers.isdecimal() and (int(modifiers) - 1) & CONTROL:
        return Key(f"ctrl-{letter}", happened)
    return Key({" ": "space", "\x1b": "escape"}.get(letter, letter), happened)
