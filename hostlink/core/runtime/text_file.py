"""Text files that a user writes: settings, tokens, keys, parameters, definitions of messages.

Editors of Windows may begin a file with a byte order mark, which does not belong to its text.
"""

import codecs
from pathlib import Path

_UTF_16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


def read_text(path: Path) -> str:
    """Read a file of UTF-8.

    Raises:
        OSError: the file cannot be read.
        UnicodeDecodeError: it is not UTF-8; the reason says what to do.
    """
    return decoded(read_bytes(path))


def decoded(data: bytes) -> str:
    """Decode the bytes of a file.

    Raises:
        UnicodeDecodeError: they are not UTF-8; the reason says what to do.
    """
    try:
        return data.decode()
    except UnicodeDecodeError as error:
        advice = "it is UTF-16; save it as UTF-8" if data.startswith(_UTF_16) else f"{error.reason}; save it as UTF-8"
        raise UnicodeDecodeError(error.encoding, error.object, error.start, error.end, advice) from None


def read_bytes(path: Path, max_bytes: int = -1) -> bytes:
    """Read a file without its byte order mark of UTF-8, at most `max_bytes` and one more.

    Raises:
        OSError: the file cannot be read.
    """
    with path.open("rb") as file:
        return file.read(max_bytes + 1 if max_bytes >= 0 else -1).removeprefix(codecs.BOM_UTF8)
