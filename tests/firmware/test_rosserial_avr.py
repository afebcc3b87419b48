"""The library on an ATmega328P with a genuine Arduino core (Debian's arduino-core-avr): it links, and fits."""

import re

import pytest

from tests.firmware.due import ROOT
from tests.firmware.examples import EXAMPLES
from tests.firmware.families import UNO, image_bytes

DOCUMENT = ROOT / "docs" / "board-sizes.md"
FLASH_BYTES = 32256  # without the boot loader
# RAM limits: the rest of the 2,048 bytes is stack. Measured, with a little room for changes.
RAM_BYTES = {
    "pubsub": 1060,
    "blink": 1010,
    "motors_l298": 1080,
    "service_server": 1080,
    "service_client": 1110,
    "sonar": 1080,
}
PUBSUB_FLASH_BYTES = 11600  # 230 bytes are for slow loops, 280 for telling of a message that is too large


def sizes(name: str) -> tuple[int, int]:
    """Flash and static RAM of an example, in bytes."""
    return image_bytes(UNO, EXAMPLES / name / f"{name}.ino")


@pytest.mark.parametrize("name", RAM_BYTES)
def test_an_example_fits_into_an_uno(name: str) -> None:
    flash, ram = sizes(name)
    assert flash <= FLASH_BYTES
    assert ram <= RAM_BYTES[name]


def test_pubsub_leaves_most_of_the_flash() -> None:
    assert sizes("pubsub")[0] <= PUBSUB_FLASH_BYTES


def test_the_document_has_the_size_of_pubsub() -> None:
    """`tools/board_sizes.py --write` updates it."""
    first, *_ = re.findall(r"^\| `pubsub` \| ([\d,]+) / ([\d,]+) \|", DOCUMENT.read_text(), re.MULTILINE)
    documented = tuple(int(number.replace(",", "")) for number in first)
    assert sizes("pubsub") == pytest.approx(documented, rel=0.02)
