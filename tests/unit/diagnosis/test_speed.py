"""The guess at a UART's speed: right where it names one, silent where the bytes do not tell."""

import random
from pathlib import Path

import pytest

from hostlink.diagnosis.speed import guess_speed
from hostlink.inspection import load_reads
from hostlink.protocol.frame import Id, encode
from hostlink.protocol.resampling import resample

CAPTURE = Path(__file__).parent.parent.parent / "captures" / "services.jsonl"
TIME_REQUESTS = encode(Id.TIME, bytes(8)) * 60


def telemetry() -> bytes:
    """What a real device sent, which the guess was not made from."""
    return b"".join(bytes.fromhex(read.hex) for read in load_reads(CAPTURE) if read.dir == "device")[2000:4000]


@pytest.mark.parametrize("error", [0.98, 1.0, 1.02])
@pytest.mark.parametrize("gap_bits", [0.0, 0.5, 3.0])
@pytest.mark.parametrize(("sent", "read"), [(57600, 115200), (9600, 57600), (38400, 57600), (19200, 115200)])
def test_a_slower_device_is_named_by_its_requests_for_the_time(
    sent: int, read: int, gap_bits: float, error: float
) -> None:
    observed = resample(TIME_REQUESTS, ratio=read / sent * error, gap_bits=gap_bits)[:512]
    guess = guess_speed(observed, read)
    assert guess is not None
    assert guess.baud == sent
    assert str(guess) == f"read at {read} baud, most likely sent at {sent}"


@pytest.mark.parametrize(("sent", "read"), [(57600, 115200), (9600, 57600), (38400, 57600)])
def test_a_slower_device_is_named_by_its_telemetry(sent: int, read: int) -> None:
    guess = guess_speed(resample(telemetry(), ratio=read / sent, gap_bits=1.0)[:1024], read)
    assert guess is not None
    assert guess.baud == sent


def test_a_faster_device_is_only_called_faster() -> None:
    guess = guess_speed(resample(TIME_REQUESTS, ratio=57600 / 115200)[:512], 57600)
    assert guess is not None
    assert (guess.baud, str(guess)) == (0, "the device is faster than its reader")


def test_behind_a_network_only_the_ratio_is_known() -> None:
    guess = guess_speed(resample(TIME_REQUESTS, ratio=2.0)[:512], None)
    assert str(guess) == "sent at about 0.5 times the speed at which they are read"


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
def test_a_sample_that_shows_no_speed_gives_no_guess(observed: bytes) -> None:
    assert guess_speed(observed, 57600) is None


def test_a_boot_message_of_another_version_is_recognised() -> None:
    text = b" ets Jan  8 2013,rst cause:1, boot mode:(3,7)\n\nload 0x40100000, len 1384, room 16 \ntail 8\n~ld\n"
    guess = guess_speed(resample(text, ratio=115200 / 74880), 115200)
    assert guess is not None
    assert guess.is_of_boot


def test_at_one_speed_nothing_changes() -> None:
    assert resample(telemetry(), ratio=1.02, gap_bits=0.7) == telemetry()
    assert resample(telemetry(), ratio=0.97, gap_bits=0.7) == telemetry()
