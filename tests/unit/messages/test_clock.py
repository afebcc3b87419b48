"""Messages of /clock: valid and invalid payloads."""

import pytest

from hostlink.messages.catalog import decode_clock, to_time


def test_clock_message_is_its_time_in_nanoseconds() -> None:
    assert decode_clock(bytes.fromhex("02000000 03000000")) == 2_000_000_003


@pytest.mark.parametrize("payload", [b"", bytes(7), bytes(9)])
def test_payload_of_another_length_decodes_to_none(payload: bytes) -> None:
    assert decode_clock(payload) is None


def test_time_of_a_message_has_seconds_and_nanoseconds() -> None:
    assert to_time(2_000_000_003) == {"secs": 2, "nsecs": 3}
