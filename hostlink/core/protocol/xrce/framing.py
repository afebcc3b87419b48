"""Framings: messages of DDS-XRCE in the bytes of a transport.

| framing  | a message is                                                                             |
|----------|------------------------------------------------------------------------------------------|
| datagram | one datagram                                                                             |
| TCP      | its length in two bytes, then the message                                                |
| serial   | 7E, source, destination, length (2), message, CRC-16 (2); 7D escapes a byte by xor 20    |

On a serial line 7E begins a frame everywhere, also inside a broken one.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterable
from typing import ClassVar, Final

from hostlink.core.runtime.compiled import mypyc_attr

BEGIN: Final = 0x7E
ESCAPE: Final = 0x7D
FLIP: Final = 0x20
_BEGIN: Final = bytes((BEGIN,))
_ESCAPE: Final = bytes((ESCAPE,))
_LENGTH_BYTES: Final = 2
_MESSAGE_AT: Final = 4  # behind source, destination and length
_CRC_BYTES: Final = 2
_HOST: Final = 0x00  # addresses on a serial line
_DEVICE: Final = 0x01
LEAST_BYTES: Final = 4  # a header
JOINED: Final = b"\xff\xff\xff\xffjoined"  # before messages of a capture; no client has these numbers
SURE_MESSAGES: Final = 4


def _crc_table() -> tuple[int, ...]:
    """Return the table of the CRC-16 with the polynomial 8005, reflected."""
    table = []
    for byte in range(256):
        crc = byte
        for _ in range(8):
            crc = crc >> 1 ^ 0xA001 if crc & 1 else crc >> 1
        table.append(crc)
    return tuple(table)


_CRC_TABLE: Final = _crc_table()


def crc16(data: bytes) -> int:
    """Return the checksum of a serial frame's message."""
    crc = 0
    for byte in data:
        crc = crc >> 8 ^ _CRC_TABLE[(crc ^ byte) & 0xFF]
    return crc


@mypyc_attr(allow_interpreted_subclasses=True)
class Framing(ABC):
    """Framing of one connection: bytes in, whole messages out, and the other way round."""

    transport: ClassVar[str] = ""  # on which it is used: "udp", "tcp" or "serial"
    limit_bytes = 0xFFFF  # longest message

    def __init__(self) -> None:
        self.skipped: list[bytes] = []  # bytes in no message since the last `feed`
        self.bad_checksums = 0
        self.bad_lengths = 0

    @abstractmethod
    def feed(self, data: bytes) -> list[bytes]:
        """Return the messages that are whole with these bytes."""

    @abstractmethod
    def encode(self, message: bytes) -> bytes:
        """Return the bytes of a message on this transport."""

    @property
    def captured_as(self) -> str:
        """Transport of the framing that reads a capture."""
        return self.transport

    def joined(self, messages: Iterable[bytes]) -> bytes:
        """Return the bytes of several messages at the beginning of a capture."""
        return b"".join(map(self.encode, messages))

    @abstractmethod
    def rest_bytes(self, pieces: Iterable[bytes]) -> int:
        """Number of bytes before the first whole message of captured pieces whose beginning is lost."""

    def _skip(self, data: bytes) -> None:
        if data:
            self.skipped.append(data)


class DatagramFraming(Framing):
    """One message in each datagram."""

    transport: ClassVar[str] = "udp"
    limit_bytes = 65507  # of UDP

    def feed(self, data: bytes) -> list[bytes]:
        self.skipped = []
        return [data]

    def encode(self, message: bytes) -> bytes:
        return message

    @property
    def captured_as(self) -> str:
        return CapturedDatagramFraming.transport

    def joined(self, messages: Iterable[bytes]) -> bytes:
        """Return the messages with their lengths, because nothing else divides them: CapturedDatagramFraming."""
        parts = b"".join(len(each).to_bytes(_LENGTH_BYTES, "little") + each for each in messages)
        return JOINED + parts + bytes(_LENGTH_BYTES) if parts else b""

    def rest_bytes(self, pieces: Iterable[bytes]) -> int:
        return len(next(iter(pieces), b""))  # it may be the end of a datagram


class CapturedDatagramFraming(DatagramFraming):
    """The framing of a capture of datagrams. The first one may have joined messages before it."""

    transport: ClassVar[str] = "datagrams"

    def feed(self, data: bytes) -> list[bytes]:
        self.skipped = []
        if not data.startswith(JOINED):
            return [data]
        found, at = list[bytes](), len(JOINED)
        while size := int.from_bytes(data[at : at + _LENGTH_BYTES], "little"):
            at += _LENGTH_BYTES
            found.append(data[at : at + size])
            at += size
        rest = data[at + _LENGTH_BYTES :]
        return [*found, rest] if rest else found


class LengthFraming(Framing):
    """The length of each message in front of it, on TCP. Nothing can be damaged there, and nothing is found again."""

    transport: ClassVar[str] = "tcp"

    def __init__(self) -> None:
        super().__init__()
        self._pending = b""

    def feed(self, data: bytes) -> list[bytes]:
        self.skipped = []
        pending, found, at = self._pending + data, list[bytes](), 0
        while len(pending) - at >= _LENGTH_BYTES:
            start = at + _LENGTH_BYTES
            end = start + int.from_bytes(pending[at:start], "little")
            if end > len(pending):
                break
            found.append(pending[start:end])
            at = end
        self._pending = pending[at:]
        return found

    def rest_bytes(self, pieces: Iterable[bytes]) -> int:
        data = b"".join(pieces)
        starts = (at for at in range(min(len(data), self.limit_bytes)) if self._is_start(data, at))
        return next(starts, len(data))

    def _is_start(self, data: bytes, at: int) -> bool:
        """Whether SURE_MESSAGES of one session begin there, one behind the other."""
        session = data[at + _LENGTH_BYTES : at + _LENGTH_BYTES + 1]
        for _ in range(SURE_MESSAGES):
            size = int.from_bytes(data[at : at + _LENGTH_BYTES], "little")
            start = at + _LENGTH_BYTES
            if size < LEAST_BYTES or len(data) < start + size or data[start : start + 1] != session:
                return False
            at = start + size
        return True

    def encode(self, message: bytes) -> bytes:
        return len(message).to_bytes(_LENGTH_BYTES, "little") + message


class SerialFraming(Framing):
    """Frames with escapes and a checksum, on a serial line. A 7E interrupts the frame before it, which is skipped."""

    transport: ClassVar[str] = "serial"

    def __init__(self) -> None:
        super().__init__()
        self._is_inside = False  # a frame has begun
        self._is_escaped = False  # the last byte was an escape
        self._raw = bytearray()  # the frame so far, as it came
        self._plain = bytearray()  # the same without 7E and escapes

    def feed(self, data: bytes) -> list[bytes]:
        """Return the messages that are whole with these bytes."""
        self.skipped = []
        found: list[bytes] = []
        first, *chunks = data.split(_BEGIN)
        self._add(first, found)
        for chunk in chunks:
            self._skip(bytes(self._raw))
            self._is_inside, self._is_escaped = True, False
            self._raw, self._plain = bytearray(_BEGIN), bytearray()
            self._add(chunk, found)
        return found

    def _add(self, chunk: bytes, found: list[bytes]) -> None:
        """Add bytes without 7E."""
        if not self._is_inside:
            self._skip(chunk)
            return
        before = len(self._plain)
        self._unescape(chunk)
        plain = self._plain
        if len(plain) < _MESSAGE_AT:
            self._raw += chunk
            return
        length = int.from_bytes(plain[2:_MESSAGE_AT], "little")
        whole = _MESSAGE_AT + length + _CRC_BYTES
        if len(plain) < whole:
            self._raw += chunk
            return
        end = _raw_end(chunk, whole - before)
        message = bytes(plain[_MESSAGE_AT : whole - _CRC_BYTES])
        if length < LEAST_BYTES:
            self.bad_lengths += 1
        elif crc16(message) != int.from_bytes(plain[whole - _CRC_BYTES : whole], "little"):
            self.bad_checksums += 1
        else:
            found.append(message)
            self._raw.clear()
            chunk = chunk[end:]
        self._skip(bytes(self._raw) + chunk)
        self._is_inside = False
        self._raw.clear()

    def _unescape(self, chunk: bytes) -> None:
        is_escaped = self._is_escaped
        for place, piece in enumerate(chunk.split(_ESCAPE)):
            is_escaped = is_escaped or place > 0
            if piece and is_escaped:
                self._plain.append(piece[0] ^ FLIP)
                self._plain += piece[1:]
                is_escaped = False
            else:
                self._plain += piece
        self._is_escaped = is_escaped

    def rest_bytes(self, pieces: Iterable[bytes]) -> int:
        data = b"".join(pieces)
        at = data.find(_BEGIN)
        return len(data) if at < 0 else at

    def encode(self, message: bytes) -> bytes:
        """Return a frame from the host to the device."""
        return _frame(_HOST, _DEVICE, message)


def device_frame(message: bytes) -> bytes:
    """Return a frame from a device to the host, on a serial line."""
    return _frame(_DEVICE, _HOST, message)


def _frame(source: int, destination: int, message: bytes) -> bytes:
    head = bytes((source, destination)) + len(message).to_bytes(2, "little")
    content = head + message + crc16(message).to_bytes(_CRC_BYTES, "little")
    escaped = content.replace(_ESCAPE, bytes((ESCAPE, ESCAPE ^ FLIP)))
    return _BEGIN + escaped.replace(_BEGIN, bytes((ESCAPE, BEGIN ^ FLIP)))


FRAMINGS: Final[tuple[type[Framing], ...]] = (
    DatagramFraming,
    LengthFraming,
    SerialFraming,
    CapturedDatagramFraming,
)


def framing_on(transport: str) -> type[Framing]:
    """Return the framing on a transport, as `Framing.transport` names it; that of UDP if it is not known."""
    return next((each for each in FRAMINGS if each.transport == transport), DatagramFraming)


def _raw_end(chunk: bytes, count: int) -> int:
    """Return how many bytes of a chunk have its first `count` plain ones."""
    at = 0
    while count:
        count -= chunk[at] != ESCAPE
        at += 1
    return at
