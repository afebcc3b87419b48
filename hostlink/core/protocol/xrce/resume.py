"""SessionState: what a session needs to go on after a restart of the host. Small, and written as JSON.

A board without code to reconnect never creates its objects again. The state has the objects as the board created them,
what it wants to read, and the numbers of its reliable streams in both directions. The board's next messages must fit.
"""

import json
from typing import Any, Final, NamedTuple

from hostlink.core.protocol.xrce.wire import KEY_BYTES, NUMBERS, ClientInfo

FORMAT_VERSION: Final = 2
TEXT_CHARS_MAX: Final = 1024 * 1024
ITEMS_MAX: Final = 4096


class ClientState(NamedTuple):
    """One client, as it was when the state was stored."""

    info: ClientInfo
    number: int  # of the first reliable message to it that it has not acknowledged
    sent: int  # number behind the last one that was sent to it
    inputs: dict[int, int]  # next number of each reliable stream from it
    unfit: tuple[int, ...]  # ids of objects whose messages were not of their type
    objects: tuple[bytes, ...]  # payloads of CREATE without the request id
    reads: tuple[bytes, ...]  # payloads of READ_DATA


class SessionState(NamedTuple):
    """The clients behind one address."""

    clients: tuple[ClientState, ...]

    def to_json(self) -> str:
        """Return the state as text."""
        clients = [
            {
                "version": client.info.version.hex(),
                "vendor": client.info.vendor.hex(),
                "key": client.info.key.hex(),
                "session": client.info.session,
                "mtu": client.info.mtu,
                "number": client.number,
                "sent": client.sent,
                "inputs": [*client.inputs.items()],
                "unfit": client.unfit,
                "objects": [each.hex() for each in client.objects],
                "reads": [each.hex() for each in client.reads],
            }
            for client in self.clients
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
    session, mtu = _number(found["session"], 0x100), _number(found["mtu"], NUMBERS)
    return ClientState(
        ClientInfo(version, vendor, key, session, (), mtu),
        _number(found["number"], NUMBERS),
        _number(found["sent"], NUMBERS),
        {_number(stream, 0x100): _number(number, NUMBERS) for stream, number in _items(found["inputs"])},
        tuple(_number(each, NUMBERS) for each in _items(found["unfit"])),
        tuple(map(_bytes, _items(found["objects"]))),
        tuple(map(_bytes, _items(found["reads"]))),
    )


def _bytes(value: object) -> bytes:
    if not isinstance(value, str):
        raise TypeError("not a text")
    return bytes.fromhex(value)


def _number(value: object, limit: int) -> int:
    if type(value) is not int or not 0 <= value < limit:
        raise ValueError("not such a number")
    return value


def _items(value: object) -> list[Any]:
    if not isinstance(value, list) or len(value) > ITEMS_MAX:
        raise TypeError("not such a list")
    return value
