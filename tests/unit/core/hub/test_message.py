"""Message: decoded once, and made once in each form."""

import pytest

from hostlink.core.hub.message import PROGRAM_PRIORITY, Message
from hostlink.errors import BadPayload
from tests.support.fake_device import CATALOG


def message(payload: bytes, type_name: str = "std_msgs/Bool") -> Message:
    return Message("/t", type_name, CATALOG.message(type_name), payload, source="ann", stamp_ns=1, at_s=2.0)


def test_message_is_decoded_once() -> None:
    one = message(b"\1")
    assert one.decoded == {"data": True}
    assert one.decoded is one.decoded
    assert (one.priority, one.epoch, one.source, one.stamp_ns, one.at_s) == (PROGRAM_PRIORITY, None, "ann", 1, 2.0)


def test_message_without_definition_or_of_another_size_cannot_be_decoded() -> None:
    with pytest.raises(BadPayload, match="no definition"):
        _ = message(b"\1", "my/Unknown").decoded
    with pytest.raises(BadPayload):
        _ = message(b"").decoded


def test_each_form_is_made_once() -> None:
    made: list[str] = []
    one = message(b"\1")

    def make(form: str) -> bytes:
        made.append(form)
        return form.encode()

    assert one.made("json", lambda _: make("json")) == b"json"
    assert one.made("json", lambda _: make("json")) == b"json"
    assert one.made("cbor", lambda _: make("cbor")) == b"cbor"
    assert made == ["json", "cbor"]
