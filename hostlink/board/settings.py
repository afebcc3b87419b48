"""The settings that a board keeps, and the lines of text by which they are read and set. Pure.

firmware/rosserial/src/hostlink/settings_line.h has the other side and the grammar.
"""

import re
import urllib.parse
import zlib
from collections.abc import Iterator
from typing import Final, NamedTuple

from hostlink.errors import BadRequest

MARK: Final = b"#hl "
LINE_BYTES_MAX: Final = 256
PORTS: Final = range(1, 65536)
_ANSWER: Final = re.compile(rb"#hl (\d{1,5}) ([ -~]*) ([0-9A-F]{8})")
_NAME: Final = re.compile(rb"(?!.*//)[A-Za-z][A-Za-z0-9_/]*(?<!/)")
_NAME_RULE: Final = "a letter, then letters, digits, _ and single /"
_PRINTABLE: Final = re.compile(rb"[!-~\x80-\xff]*")
_WITH_SPACES: Final = re.compile(rb"[ -~\x80-\xff]*")
_SAFE: Final = "!\"$&'()*+,-./:;<=>?@[\\]^_`{|}~"  # what is not quoted, besides letters and digits


class Setting(NamedTuple):
    """One setting of a board; `least` and `most` are the bytes of a value that is not empty."""

    name: str
    question: str
    least: int
    most: int
    is_secret: bool
    pattern: re.Pattern[bytes]
    rule: str


SETTINGS: Final = {
    setting.name: setting
    for setting in (
        Setting("host", "The host's name or address", 1, 63, False, _PRINTABLE, "no spaces"),
        Setting("port", "Its port", 1, 5, False, re.compile(rb"\d*"), "1 to 65535"),
        Setting("name", "The robot's name, before its topics", 1, 32, False, _NAME, _NAME_RULE),
        Setting("wifi_name", "The WiFi's name", 1, 32, False, _WITH_SPACES, "no control characters"),
        Setting("wifi_password", "The WiFi's password", 8, 64, True, _WITH_SPACES, "no control characters"),
        Setting("key", "The key that it shares with the host", 16, 64, True, _PRINTABLE, "no spaces"),
        Setting("update_password", "The password for updates over the air", 1, 64, True, _PRINTABLE, "no spaces"),
    )
}  # fmt: skip


class Answer(NamedTuple):
    """A line of the board; `words` is what stands between number and check."""

    number: int
    words: str


def check_value(setting: Setting, value: str) -> None:
    """Accept a value; an empty one means: not set. The text of the error does not have it.

    Raises:
        BadRequest: a board would refuse it.
    """
    try:
        encoded = value.encode()
    except UnicodeEncodeError:  # what a terminal in another encoding gave
        raise BadRequest(f"{setting.name}: not UTF-8") from None
    if not encoded:
        return
    if not setting.least <= len(encoded) <= setting.most:
        sizes = f"{setting.least} to {setting.most}" if setting.least > 1 else f"at most {setting.most}"
        raise BadRequest(f"{setting.name}: {sizes} bytes, this has {len(encoded)}")
    if not setting.pattern.fullmatch(encoded) or (setting.name == "port" and int(value) not in PORTS):
        raise BadRequest(f"{setting.name}: {setting.rule}")


def assignment(name: str, value: str) -> str:
    """The words that set it."""
    return f"set {name}={urllib.parse.quote(value, safe=_SAFE)}"


def request_line(number: int, words: str) -> bytes:
    """A line for the board."""
    line = MARK + f"{number} {words}".encode()
    return line + b" %08X\n" % zlib.crc32(line)


def parse_answer(line: bytes) -> Answer | None:
    """The answer at the end of a line; None: the sketch's own text, or damaged."""
    found = _ANSWER.fullmatch(line, max(line.rfind(MARK), 0))
    if found is None or zlib.crc32(line[found.start() : found.start(3) - 1]) != int(found[3], 16):
        return None
    return Answer(int(found[1]), found[2].decode("ascii"))


def value_of(words: str) -> tuple[str, str] | None:
    """Name and value of `value NAME=VALUE` or `secret NAME=set`; None: it is another answer.

    Of a secret only "set" or "unset", whatever the board sent.
    """
    kind, _, rest = words.partition(" ")
    name, equals, value = rest.partition("=")
    if kind not in {"value", "secret"} or not equals:
        return None
    if kind == "secret" or (name in SETTINGS and SETTINGS[name].is_secret):
        return name, "unset" if value in {"", "unset"} else "set"
    return name, urllib.parse.unquote(value, errors="replace")


class AnswerReader:
    """Finds the answers in what a port brings: the sketch may print there too."""

    def __init__(self) -> None:
        self.received_bytes = 0
        self.has_rosserial = False  # a frame's first bytes were there
        self._rest = b""

    def feed(self, data: bytes) -> Iterator[Answer]:
        """The answers that are complete now."""
        self.received_bytes += len(data)
        self._rest += data
        self.has_rosserial = self.has_rosserial or b"\xff\xfe" in self._rest
        *lines, rest = self._rest.split(b"\n")
        self._rest = rest[-LINE_BYTES_MAX:]
        for line in lines:
            answer = parse_answer(line.rstrip(b"\r"))
            if answer is not None:
                yield answer
