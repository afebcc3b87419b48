"""Read and write the settings of a board over its serial port. Requests are repeated until they are answered."""

import asyncio
import re
import time
import urllib.parse
import zlib
from collections.abc import Iterator, Mapping
from typing import Final, NamedTuple

from hostlink.core.transport.base import Transport
from hostlink.errors import BadRequest, HostlinkError

# -- settings port ----------------------------------------------------------------------------------------------------

TRY_S: Final = 1.0  # long enough for a slow loop of the sketch
EXCHANGE_BITS: Final = 10_000  # the longest request with its answer: 1,000 bytes of 10 bits
STORE_TRIES: Final = 3
LOST: Final = "error lost"  # the board restarted after settings were sent, and has not all of them
NUMBERS: Final = 65536  # requests are numbered modulo this
_ERRORS: Final = {
    "unknown": "the sketch does not know this setting; flash a sketch with the current library",
    "short": "too short",
    "long": "too long",
    "value": "not a value for it",
    "stored": "the value could not be stored; check that the sketch's EEPROM is large enough",
}

MARK: Final = b"#hl "
LINE_BYTES_MAX: Final = 256
PORTS: Final = range(1, 65536)


class BoardSettings:
    """Settings of the board on one port."""

    def __init__(self, transport: Transport, *, patience_s: float, baud: int) -> None:
        """`patience_s` includes the start of the sketch, because opening the port may reset the board."""
        self._transport = transport
        self._patience_s = patience_s
        self._try_s = max(TRY_S, EXCHANGE_BITS / baud)
        self._baud = baud
        self._number = time.monotonic_ns() % NUMBERS  # answers to another program may still arrive
        self._reader = AnswerReader()

    async def read(self) -> dict[str, str]:
        """Read the settings by name. A secret is only "set" or "unset".

        Raises:
            HostlinkError: the board does not answer.
        """
        return dict(found for words in await self._request("info", "info") if (found := value_of(words)))

    async def write(self, values: Mapping[str, str]) -> None:
        """Store all settings, or none.

        Raises:
            BadRequest: a value is not valid for its setting.
            HostlinkError: the board does not answer, or refuses.
        """
        for name, value in values.items():
            check_value(SETTINGS[name], value)
        try:
            for _ in range(STORE_TRIES):
                if await self._store(values):
                    return
        except BaseException:
            self._transport.write(request_line(self._next_number(), "forget"))
            raise
        raise HostlinkError(
            f"{self._transport.peer}: the board restarts before it stores the settings; check its power supply"
        )

    async def _store(self, values: Mapping[str, str]) -> bool:
        """Store all settings. False: the board restarted meanwhile and has dropped them."""
        await self._request("forget", "forget")
        for name, value in values.items():
            await self._request(assignment(name, value), name)
        return (await self._request(f"save {len(values)}", "save"))[-1] != LOST

    async def _request(self, words: str, what: str) -> list[str]:
        """Request an answer and return the text of each of its lines. `what` is named in the error.

        Raises:
            HostlinkError: the board refuses, or has not answered in time.
        """
        number = self._next_number()
        answers: list[str] = []
        loop = asyncio.get_running_loop()
        deadline_s = loop.time() + self._patience_s
        while (now_s := loop.time()) < deadline_s:
            self._transport.write(request_line(number, words))
            await self._collect(answers, number, min(now_s + self._try_s, deadline_s))
            if not _is_complete(answers):
                continue
            kind, _, reason = answers[-1].partition(" ")
            if kind == "error" and answers[-1] != LOST:
                raise HostlinkError(f"{self._transport.peer}: {what}: {_ERRORS.get(reason, reason)}")
            return answers
        raise HostlinkError(self._silence())

    async def _collect(self, answers: list[str], number: int, deadline_s: float) -> None:
        """Add answers to the request, until its last line or the deadline.

        Raises:
            HostlinkError: the port was removed.
        """
        loop = asyncio.get_running_loop()
        while not _is_complete(answers) and (left_s := deadline_s - loop.time()) > 0:
            try:
                async with asyncio.timeout(left_s):
                    data = await self._transport.receive()
            except TimeoutError:
                return
            if not data:
                raise HostlinkError(f"{self._transport.peer}: the port was removed; plug the board in again")
            answers += [answer.words for answer in self._reader.feed(data) if answer.number == number]

    def _next_number(self) -> int:
        self._number = (self._number + 1) % NUMBERS
        return self._number

    def _silence(self) -> str:
        start = f"{self._transport.peer}: no answer within {self._patience_s:g} s at {self._baud} baud"
        if self._reader.has_rosserial:
            return (
                f"{start}: the board sends rosserial frames; add a SettingsLine to the sketch that reads the port first"
            )
        if self._reader.received_bytes:
            return f"{start}, only other bytes; set the baud rate of the sketch's Serial.begin() with --baud"
        return f"{start}; the sketch needs a hostlink::SettingsLine (docs/arduino.md) and this baud rate (--baud)"


def _is_complete(answers: list[str]) -> bool:
    return bool(answers) and (answers[-1] == "ok" or answers[-1].startswith("error"))


# -- settings ---------------------------------------------------------------------------------------------------------

_ANSWER: Final = re.compile(rb"#hl (\d{1,5}) ([ -~]*) ([0-9A-F]{8})")
_NAME: Final = re.compile(rb"(?!.*//)[A-Za-z][A-Za-z0-9_/]*(?<!/)")
_NAME_RULE: Final = "a letter, then letters, digits, _ and single /"
_PRINTABLE: Final = re.compile(rb"[!-~\x80-\xff]*")
_WITH_SPACES: Final = re.compile(rb"[ -~\x80-\xff]*")
_SAFE: Final = "!\"$&'()*+,-./:;<=>?@[\\]^_`{|}~"  # characters that are not quoted, besides letters and digits


class Setting(NamedTuple):
    """One setting of a board. `least` and `most` are the sizes in bytes of a value that is not empty."""

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
        Setting("port", "The host's port", 1, 5, False, re.compile(rb"\d*"), "1 to 65535"),
        Setting("name", "The robot's name, before its topics", 1, 32, False, _NAME, _NAME_RULE),
        Setting("wifi_name", "The WiFi's name", 1, 32, False, _WITH_SPACES, "no control characters"),
        Setting("wifi_password", "The WiFi's password", 8, 64, True, _WITH_SPACES, "no control characters"),
        Setting("key", "The key that it shares with the host", 16, 64, True, _PRINTABLE, "no spaces"),
        Setting("update_password", "The password for updates over the air", 1, 64, True, _PRINTABLE, "no spaces"),
    )
}  # fmt: skip


class BoardAnswer(NamedTuple):
    """Line with which the board answers a request. `words` is the text between number and checksum."""

    number: int
    words: str


def check_value(setting: Setting, value: str) -> None:
    """Check a value. An empty one unsets the setting. The error text does not contain the value.

    Raises:
        BadRequest: a board would refuse it.
    """
    try:
        encoded = value.encode()
    except UnicodeEncodeError:  # input of a terminal with another encoding
        raise BadRequest(f"{setting.name}: not UTF-8") from None
    if not encoded:
        return
    if not setting.least <= len(encoded) <= setting.most:
        sizes = f"{setting.least} to {setting.most}" if setting.least > 1 else f"at most {setting.most}"
        raise BadRequest(f"{setting.name}: {sizes} bytes, this has {len(encoded)}")
    if not setting.pattern.fullmatch(encoded) or (setting.name == "port" and int(value) not in PORTS):
        raise BadRequest(f"{setting.name}: {setting.rule}")


def assignment(name: str, value: str) -> str:
    """Text of the request that sets a value."""
    return f"set {name}={urllib.parse.quote(value, safe=_SAFE)}"


def request_line(number: int, words: str) -> bytes:
    """Encode a request line for the board."""
    line = MARK + f"{number} {words}".encode()
    return line + b" %08X\n" % zlib.crc32(line)


def parse_answer(line: bytes) -> BoardAnswer | None:
    """Decode the answer at the end of a line; None if it is the sketch's own text or damaged."""
    found = _ANSWER.fullmatch(line, max(line.rfind(MARK), 0))
    if found is None or zlib.crc32(line[found.start() : found.start(3) - 1]) != int(found[3], 16):
        return None
    return BoardAnswer(int(found[1]), found[2].decode("ascii"))


def value_of(words: str) -> tuple[str, str] | None:
    """Parse `value NAME=VALUE` or `secret NAME=set` to name and value; None for another answer.

    A secret's value is always "set" or "unset", even if the board sent the secret.
    """
    kind, _, rest = words.partition(" ")
    name, equals, value = rest.partition("=")
    if kind not in {"value", "secret"} or not equals:
        return None
    if kind == "secret" or (name in SETTINGS and SETTINGS[name].is_secret):
        return name, "unset" if value in {"", "unset"} else "set"
    return name, urllib.parse.unquote(value, errors="replace")


class AnswerReader:
    """Finds answers in the bytes of a port, on which the sketch may print too."""

    def __init__(self) -> None:
        self.received_bytes = 0
        self.has_rosserial = False  # the start of a frame was received
        self._rest = b""

    def feed(self, data: bytes) -> Iterator[BoardAnswer]:
        """Add bytes and yield the complete answers."""
        self.received_bytes += len(data)
        self._rest += data
        self.has_rosserial = self.has_rosserial or b"\xff\xfe" in self._rest
        *lines, rest = self._rest.split(b"\n")
        self._rest = rest[-LINE_BYTES_MAX:]
        for line in lines:
            answer = parse_answer(line.rstrip(b"\r"))
            if answer is not None:
                yield answer
