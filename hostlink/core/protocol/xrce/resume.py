"""SessionState: what a session needs to go on after a restart of the host. Small, and written as JSON.

A board without code to reconnect never creates its objects again. The state has the objects as the board created them,
what it wants to read, and a number that its reliable stream has passed. It has no number of the board's: the board's
next message tells it.
"""

import json
from typing import Final, NamedTuple

from hostlink.core.protocol.xrce.wire import KEY_BYTES, NUMBERS, ClientInfo

FORMAT_VERSION: Final = 1
TEXT_CHARS_MAX: Final = 1024 * 1024
ITEMS_MAX: Final = 4096


class ClientState(NamedTuple):
    """One client. `number`: of the next reliable message to it, when the state was stored."""

    info: ClientInfo
    number: int
    objects: tuple[bytes, ...]  # payloads of CREATE without the request id
    reads: tuple[bytes, ...]  # payloads of READ_DATA


class SessionState(NamedTuple):
    """The clients behind one address."""

    clients: tuple[ClientState, ...]

    def to_json(self) -> str:
        """Return the state as text."""
        clients = [
            {
                "version": info.version.hex(),
                "vendor": info.vendor.hex(),
                "key": info.key.hex(),
                "session": info.session,
                "mtu": info.mtu,
                "number": number,
                "objects": [each.hex() for each in objects],
                "reads": [each.hex() for each in reads],
            }
            for info, number, objects, reads in self.clients
        ]
        return json.dumps({"format": FORMAT_VERSION, "clients": clients})


def read_state(text: str) -> SessionState | None:
    """Read a state; None if the text is not one, as after a crash while it was written."""
    if len(text) > TEXT_CHARS_MAX:
        return None
    try:
        whole = json.loads(text)
        if whole["format"] != FORMAT_VERSION:
            return None
        return SessionState(tuple(_read_client(each) for each in whole["clients"]))
    except (ValueError, LookupError, TypeError, RecursionError):
        return None


def _read_client(found: dict[str, object]) -> ClientState:
    version, vendor, key = _bytes(found["version"]), _bytes(found["vendor"]), _bytes(found["key"])
    if len(key) != KEY_BYTES:
        raise ValueError("a key has four bytes")
    session, mtu, number = _number(found["session"], 0x100), _number(found["mtu"], NUMBERS), found["number"]
    info = ClientInfo(version, vendor, key, session, (), mtu)
    return ClientState(info, _number(number, NUMBERS), _list(found["objects"]), _list(found["reads"]))


def _bytes(value: object) -> bytes:
    if not isinstance(value, str):
        raise TypeError("not a text")
    return bytes.fromhex(value)


def _number(value: object, limit: int) -> int:
    if type(value) is not int or not 0 <= value < limit:
        raise ValueError("not such a number")
    return value


def _list(value: object) -> tuple[bytes, ...]:
    if not isinstance(value, list) or len(value) > ITEMS_MAX:
        raise TypeError("not such a list")
    return tuple(_bytes(each) for each in value)
