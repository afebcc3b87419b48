"""Compile the programs that several tests run: `python -m tests.firmware.build_all`.

`make test-all` calls it first, so that no test waits for a compiler within its time limit. A failure is printed
here, and fails the tests of the program.
"""

import os
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

from tests.firmware import boards, due, esp8266, sketches, worlds
from tests.firmware.examples import EXAMPLES
from tests.firmware.families import UNO, image

BUILDERS: tuple[Callable[[], object], ...] = (
    lambda: sketches.build("pubsub"),
    boards.build_m3,
    lambda: image(UNO, EXAMPLES / "pubsub" / "pubsub.ino"),
    esp8266.build,
    worlds.library,
    due.library,
    boards.build_native,
)


def build_all(builders: Sequence[Callable[[], object]] = BUILDERS) -> list[BaseException]:
    """Call all builders, one on each core; return their failures."""
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        failures = [each.exception() for each in [pool.submit(builder) for builder in builders]]
    return [failure for failure in failures if failure is not None]


if __name__ == "__main__":
    for failure in build_all():
        print(failure, file=sys.stderr)  # noqa: T201
