"""Guesses of the UART's baud rate: right if a rate is named, none if the bytes do not show it."""

import random
from pathlib import Path

import pytest

from hostlink.core.protocol.resampling import resample
from hostlink.core.protocol.rosserial.findings import guess_speed
from hostlink.core.protocol.rosserial.frame import Id, encode
from hostlink.core.runtime.capture_file import load_reads

CAPTURE = Path(__file__).parents[4] / "captures" / "services.jsonl"
TIME_REQUESTS = encode(Id.TIME, bytes(8)) * 60


def telemetry() -> bytes:
    """Bytes of a real device that are not part of the model."""
    return b"".join(bytes.fromhex(read.hex) for read in load_reads(CAPTURE) if read.dir == "device")[2000:4000]


@pytest.mark.slow
@pytest.mark.parametrize("error", [0.98, 1.0, 1.02])
@pytest.mark.parametrize("gap_bits", [0.0, 0.5, 3.0])
@pytest.mark.parametrize(("sent", "read"), [(57600, 115200), (9600, 57600), (38400, 57600), (19200, 115200)])
def test_slower_device_is_named_by_its_requests_for_the_time(
    sent: int, read: int, gap_bits: float, error: float
) -> None:
    observed = resample(TIME_REQUESTS, ratio=read / sent * error, gap_bits=gap_bits)[:512]
    guess = guess_speed(observed, read)
    assert guess.baud == sent
    assert str(guess) == f"read at {read} baud, most likely sent at {sent}"


@pytest.mark.parametrize(("sent", "read"), [(57600, 115200), (9600, 57600), (38400, 57600)])
def test_slower_device_is_named_by_its_telemetry(sent: int, read: int) -> None:
    guess = guess_speed(resample(telemetry(), ratio=read / sent, gap_bits=1.0)[:1024], read)
    assert guess.baud == sent


def test_faster_device_gets_no_rate() -> None:
    guess = guess_speed(resample(TIME_REQUESTS, ratio=57600 / 115200)[:512], 57600)
    assert (guess.baud, str(guess)) == (0, "the device's baud rate is higher than the reader's")


def test_reader_behind_a_network_gives_only_the_ratio() -> None:
    guess = guess_speed(resample(TIME_REQUESTS, ratio=2.0)[:512], None)
    assert str(guess) == "sent at about 0.5 times the reader's baud rate"


@pytest.mark.parametrize(
    "observed",
    [
        random.Random(1).randbytes(1024),
        b"x=12.5 y=3 theta=0.5\r\n" * 40,
        resample(TIME_REQUESTS, ratio=2.0)[:40],
        bytes(b ^ 0x10 if number % 7 == 0 else b for number, b in enumerate(TIME_REQUESTS)),
    ],
    ids=["noise", "text", "too few", "damage at the right speed"],
)
def test_sample_without_a_visible_rate_gives_no_guess(observed: bytes) -> None:
    assert guess_speed(observed, 57600) is None


def test_boot_message_of_another_version_is_recognised() -> None:
    text = b" ets Jan  8 2013,rst cause:1, boot mode:(3,7)\n\nload 0x40100000, len 1384, room 16 \ntail 8\n~ld\n"
    guess = guess_speed(resample(text, ratio=115200 / 74880), 115200)
    assert guess.is_of_boot


def test_resampling_at_the_same_rate_changes_nothing() -> None:
    assert resample(telemetry(), ratio=1.02, gap_bits=0.7) == telemetry()
    assert resample(telemetry(), ratio=0.97, gap_bits=0.7) == telemetry()
