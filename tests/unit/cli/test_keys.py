"""Bytes that terminals send for keys."""

import pytest

from hostlink.cli.driving import Action, Key, KeyReader


@pytest.mark.parametrize(
    ("data", "keys"),
    [
        (b"w", [Key("w")]),
        (b"W", [Key("w", is_shifted=True)]),
        (b"wa ", [Key("w"), Key("a"), Key("space")]),
        (b"\x03", [Key("ctrl-c")]),
        (b"\x1b[A\x1b[D", [Key("up"), Key("left")]),
        (b"\x1b", [Key("escape")]),
        (b"\x1b[119u", [Key("w")]),
        (b"\x1b[119;2u", [Key("w", is_shifted=True)]),
        (b"\x1b[1;2:3D", [Key("left", Action.RELEASED, is_shifted=True)]),
        (b"\x1b[119;65u", [Key("w")]),  # Caps Lock
        (b"\x1b[119;1:1u", [Key("w", Action.PRESSED)]),
        (b"\x1b[119;1:2u", [Key("w", Action.REPEATED)]),
        (b"\x1b[119;1:3u", [Key("w", Action.RELEASED)]),
        (b"\x1b[1;1:3A", [Key("up", Action.RELEASED)]),
        (b"\x1b[99;5u", [Key("ctrl-c")]),
        (b"\x1b[32;1:3u", [Key("space", Action.RELEASED)]),
        (b"\x1b[27u", [Key("escape")]),
        (b"\x1b[?11u", []),
        (b"\x1b[5~", [Key("sequence 5~")]),
        (b"\xff", [Key("\ufffd")]),
    ],
)
def test_keys(data: bytes, keys: list[Key]) -> None:
    assert KeyReader().feed(data) == keys


def test_a_sequence_may_come_in_pieces() -> None:
    reader = KeyReader()
    assert reader.feed(b"\x1b[1") == []
    assert reader.feed(b";1:3Aw") == [Key("up", Action.RELEASED), Key("w")]
