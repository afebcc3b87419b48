"""Messages shortened to the receiver's buffer."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.core.messages.catalog import Catalog
from hostlink.core.messages.fitting import encode_within
from hostlink.core.messages.message_type import MessageType
from hostlink.errors import BadRequest


@pytest.fixture(scope="module")
def trigger() -> MessageType:
    service = Catalog().service("std_srvs/Trigger")
    return service.response


@pytest.fixture(scope="module")
def parameter() -> MessageType:
    """Return a message with three lists and no text."""
    service = Catalog().service("rosserial_msgs/RequestParam")
    return service.response


def test_message_within_the_limit_is_unchanged(trigger: MessageType) -> None:
    message = {"success": True, "message": "on"}
    assert encode_within(trigger, message, 7) == trigger.encode(message)


def test_text_is_cut_to_the_byte_and_everything_else_stays(trigger: MessageType) -> None:
    payload = encode_within(trigger, {"success": True, "message": "x" * 100}, 25)
    assert payload is not None
    assert (len(payload), trigger.decode(payload)) == (25, {"success": True, "message": "x" * 20})


def test_shortened_text_ends_at_a_character(trigger: MessageType) -> None:
    payload = encode_within(trigger, {"message": "é" * 100}, 10)
    assert payload is not None
    assert trigger.decode(payload)["message"] == "é" * 2


def test_longest_text_is_cut_first() -> None:
    header = Catalog().message("rosgraph_msgs/Log")
    payload = encode_within(header, {"name": "n" * 10, "msg": "m" * 50, "function": "f" * 20}, 72)
    assert payload is not None
    found = header.decode(payload)
    assert (found["name"], found["function"]) == ("n" * 10, "f" * 20)
    assert found["msg"] == "m" * (72 - header.layout.minimum_bytes - 30)


def test_lists_are_not_cut(parameter: MessageType) -> None:
    assert encode_within(parameter, {"ints": [1, 2, 3]}, 20) is None
    assert encode_within(parameter, {"ints": [1, 2]}, 20) == parameter.encode({"ints": [1, 2]})


def test_message_above_the_limit_without_text_gives_none(trigger: MessageType) -> None:
    assert encode_within(trigger, {"message": "x"}, 4) is None


def test_message_of_another_type_is_refused(trigger: MessageType) -> None:
    with pytest.raises(BadRequest, match="no field 'sucess'"):
        encode_within(trigger, {"sucess": True}, 100)


@given(st.text(max_size=60), st.integers(0, 80))
def test_shortened_message_uses_the_limit_and_never_exceeds_it(text: str, limit_bytes: int) -> None:
    service = Catalog().service("std_srvs/Trigger")
    payload = encode_within(service.response, {"message": text}, limit_bytes)
    if limit_bytes < 5:
        assert payload is None
        return
    assert payload is not None
    kept = str(service.response.decode(payload)["message"])
    assert text.startswith(kept)
    assert len(payload) <= limit_bytes
    assert kept == text or len(payload) + len(text[len(kept)].encode()) > limit_bytes
