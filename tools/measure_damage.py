"""Share of damaged frames that are delivered as frames that were never sent: hostlink and the checksums alone.

Each damaged frame is between two intact ones. Hostlink knows the ids and the sizes of what the device announced;
the yardstick is the same reader that knows neither. `make soak` does ten million.
"""

import argparse
import json
import random
import struct
import sys
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from hostlink.core.protocol.rosserial.frame import Frame, encode
from hostlink.core.protocol.rosserial.stream import FrameStream

ODOMETRY_ID = 125
KNOWN = {ODOMETRY_ID: 24, 126: 48}  # the paper's robot: id -> size
BATCH = 1000
Damage = Callable[[bytearray, random.Random], None]


def one_bit(line: bytearray, dice: random.Random) -> None:
    line[dice.randrange(len(line))] ^= 1 << dice.randrange(8)


def two_bytes(line: bytearray, dice: random.Random) -> None:
    for at in dice.sample(range(len(line)), 2):
        line[at] ^= dice.randrange(1, 256)


def burst(line: bytearray, dice: random.Random) -> None:
    at, size = dice.randrange(len(line) - 8), dice.randrange(2, 9)
    line[at : at + size] = dice.randbytes(size)


def lost_bytes(line: bytearray, dice: random.Random) -> None:
    at, size = dice.randrange(len(line) - 8), dice.randrange(1, 9)
    del line[at : at + size]


def more_bytes(line: bytearray, dice: random.Random) -> None:
    at, size = dice.randrange(len(line)), dice.randrange(1, 9)
    line[at:at] = dice.randbytes(size)


KINDS: tuple[Damage, ...] = (one_bit, two_bytes, burst, lost_bytes, more_bytes)


def measure(damage: Damage, count: int, seed: int = 1) -> dict[str, int]:
    """Count damaged frames that were delivered as frames that were never sent, and intact frames that were lost."""
    dice = random.Random(f"{seed} {damage.__name__}")  # noqa: S311 - a measurement that can be repeated
    found = {"frames": count, "hostlink": 0, "intact_lost": 0, "checksums_alone": 0}
    for begin in range(0, count, BATCH):
        size = min(BATCH, count - begin)
        wire, intact, damaged = batch(damage, size, dice)
        known = [item for item in FrameStream(fixed_bytes=KNOWN).feed(wire) if isinstance(item, Frame)]
        alone = [item for item in FrameStream().feed(wire) if isinstance(item, Frame)]
        delivered = [item for item in known if item.topic_id in KNOWN]
        found["hostlink"] += sum(item not in intact and item not in damaged for item in delivered)
        found["intact_lost"] += len(intact - set(delivered))
        found["checksums_alone"] += sum(item not in intact and item not in damaged for item in alone)
    return found


def batch(damage: Damage, size: int, dice: random.Random) -> tuple[bytes, set[Frame], set[Frame]]:
    """Intact and damaged frames in turn; the second set is what the damaged ones were (a burst may change nothing)."""
    wire = bytearray()
    intact, damaged = set(), set()
    for number in range(size):
        good = Frame(ODOMETRY_ID, struct.pack("<3d", number, dice.random(), dice.random()))
        hurt = Frame(ODOMETRY_ID, struct.pack("<3d", number, dice.random(), dice.random()))
        intact.add(good)
        damaged.add(hurt)
        line = bytearray(encode(*hurt))
        damage(line, dice)
        wire += line + encode(*good)
    return bytes(wire), intact, damaged


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=10_000_000, help="of all kinds of damage together")
    arguments = parser.parse_args()
    for damage in KINDS:
        found = measure(damage, arguments.frames // len(KINDS))
        shares = {name: found[name] / found["frames"] for name in ("hostlink", "intact_lost", "checksums_alone")}
        print(json.dumps({"damage": damage.__name__, **found, "shares": shares}), flush=True)


if __name__ == "__main__":
    main()
