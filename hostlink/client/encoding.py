"""Messages as JSON. Numbers and arrays of numpy are as good as Python's; numpy itself is not imported."""

from typing import Any

import msgspec

from hostlink.errors import HostlinkError


def encode(message: Any) -> bytes:
    """The JSON of a message.

    Raises:
        HostlinkError: something in it has no JSON.
    """
    try:
        return _ENCODER.encode(message)
    except TypeError as error:  # a key that is no text
        raise HostlinkError(f"a message cannot contain this: {error}") from error


def _plain(value: Any) -> Any:
    """What msgspec does not know: numpy's scalars and arrays turn themselves into Python's."""
    if hasattr(value, "tolist"):
        return value.tolist()
    raise HostlinkError(f"a message cannot contain a {type(value).__name__}: numbers, texts, lists and dicts are fine")


_ENCODER = msgspec.json.Encoder(enc_hook=_plain)
