"""Losses of NodeHandle's three policies when the network pauses inside a frame: the table of firmware/README.md.

Each frame (a Twist, 56 bytes) arrives in two pieces with a gap between, through a 38400 baud UART with the Due's ring.
The paper's loop turns 30 times a second; the default drains the UART on each pass, so it is measured in both.
"""

import argparse
import random
import sys
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from hostlink.core.protocol.rosserial.frame import encode
from tests.firmware.due import Retry, node
from tests.support.uart import Uart

GAPS_MS = (0, 5, 9, 15, 25, 50, 100, 200)
BURSTS = (1, 2, 3, 4, 6, 10)
FRAME = encode(100, b"\x22" * 48)
INTERVAL_S = 0.4  # longer than any gap and what follows it


@dataclass
class Policy:
    """Policy of reading, and the period of the device's loop."""

    name: str
    retry: Retry
    loop_s: float


POLICIES = (
    Policy("original", Retry.NONE, 1 / 30),
    Policy("paper's clause", Retry.PAPER, 1 / 30),
    Policy("keep state, 30 Hz", Retry.KEEP_STATE, 1 / 30),
    Policy("keep state, each pass", Retry.KEEP_STATE, 0.001),
)


def lost(policy: Policy, gap_s: float, frames: int, seed: int) -> tuple[int, int]:
    """(frames, bytes) lost of so many, each cut in two pieces with a gap between."""
    dice = random.Random(seed)  # noqa: S311 - a measurement that can be repeated
    cuts = [dice.randrange(1, len(FRAME)) for _ in range(frames)]
    return measure(policy, [[(0.0, FRAME[:cut]), (gap_s, FRAME[cut:])] for cut in cuts], dice)


def lost_of_bursts(policy: Policy, burst: int, frames: int, seed: int) -> tuple[int, int]:
    """(frames, bytes) lost of about so many that come several at once."""
    dice = random.Random(seed)  # noqa: S311
    return measure(policy, [[(0.0, FRAME * burst)] for _ in range(frames // burst)], dice)


def measure(policy: Policy, deliveries: list[list[tuple[float, bytes]]], dice: random.Random) -> tuple[int, int]:
    """(frames, bytes) lost; a frame's bytes are lost with it, whether the ring had room for them or not."""
    uart = Uart(baud=38400)
    sent = received = 0
    with node(policy.retry) as device:
        now_s = dice.random()
        for delivery in deliveries:
            first_s = now_s + dice.random() * 0.05
            pieces = [(first_s + after_s, piece) for after_s, piece in delivery]
            until_s = now_s + INTERVAL_S
            while now_s < until_s:
                wait_s = turn(uart, pieces, device, now_s)
                now_s += policy.loop_s if wait_s is None else wait_s
            sent += sum(len(piece) for _, piece in delivery)
            received += len(device.received())
    return sent // len(FRAME) - received, sent - received * len(FRAME)


def turn(uart: Uart, pieces: list[tuple[float, bytes]], device: object, now_s: float) -> float | None:
    """One call of spin(), with what has arrived by then."""
    while pieces and pieces[0][0] <= now_s:
        at_s, piece = pieces.pop(0)
        uart.send(piece, at_s)
    device.feed(uart.pop(now_s))  # type: ignore[attr-defined]
    return device.spin(now_s)  # type: ignore[attr-defined, no-any-return]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=500)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    frames, seed = arguments.frames, arguments.seed
    for title, columns, measured in (
        ("gap inside a frame, ms", GAPS_MS, lambda policy, gap: lost(policy, gap / 1000, frames, seed)),
        ("frames at once", BURSTS, lambda policy, burst: lost_of_bursts(policy, burst, frames, seed)),
    ):
        print(f"frames lost (bytes lost) of {frames}\n\n| {title} | " + " | ".join(map(str, columns)) + " |")
        print("|---" * (len(columns) + 1) + "|")
        for policy in POLICIES:
            row = [measured(policy, column) for column in columns]
            print(f"| {policy.name} | " + " | ".join(f"{count} ({octets})" for count, octets in row) + " |")
        print()


if __name__ == "__main__":
    main()
