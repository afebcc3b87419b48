"""Install what `make test-all` needs: `python tools/install_for_tests.py --lane TARGET TARGET ... --lane TARGET ...`.

A lane is a list of targets of make that are made in turn; lanes run side by side. Each target has a line when it
begins, with its usual size, and a line when it ends, with its time. pip, npm and apt keep what they have downloaded,
for other clones too. A target that fails does not end the others: the tests that need it are listed as not run. Only
the first target must succeed: it has what runs the tests.
"""

import argparse
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

# Purpose of each target, and the MB that it adds to an empty clone or machine (Debian 12, x86_64; by du).
USUAL = {
    ".venv/.dev": ("Python packages of the extra dev", 965),
    "test-packages": (
        "Debian packages: compilers, emulators, browsers, ROS 1",
        0,
    ),  # tools/require.sh prints what they add
    "tests/clients/node_modules/.package-lock.json": ("JavaScript clients", 36),
    "build/ros2-venv/.installed": ("rclpy and hostlink", 240),
    "build/ros-mcp-venv/.installed": ("ros-mcp, for tests/system/test_ros_mcp.py", 430),
    "build/promtool/usr/bin/promtool": ("promtool of Prometheus", 190),
}


@dataclass(slots=True)
class Made:
    """A target, whether it was made, and the seconds that it took."""

    target: str
    is_made: bool
    seconds: float


def make(target: str) -> bool:
    """Make a target; return whether it succeeded. It prints its own errors."""
    return subprocess.run(["make", "--no-print-directory", target], check=False).returncode == 0


def is_current(target: str) -> bool:
    """Return whether nothing is to be made. The packages of Debian are always asked for."""
    return subprocess.run(["make", "--question", target], capture_output=True, check=False).returncode == 0


def make_lane(targets: Sequence[str], made: Callable[[str], bool], say: Callable[[str], None]) -> list[Made]:
    """Make the targets of a lane in turn."""
    results = []
    for target in targets:
        what, size_mb = USUAL.get(target, (target, 0))
        say(f"  {what}: {f'about {size_mb} MB ...' if size_mb else '...'}")
        began_s = time.monotonic()
        is_made = made(target)
        results.append(Made(target, is_made, time.monotonic() - began_s))
        say(f"  {what}: {'ready' if is_made else 'FAILED'} after {results[-1].seconds:.0f} s")
    return results


def install(
    lanes: Sequence[Sequence[str]], made: Callable[[str], bool] = make, say: Callable[[str], None] = print
) -> list[Made]:
    """Make all lanes side by side; return the results in the order of the lanes."""
    with ThreadPoolExecutor(max(1, len(lanes))) as pool:
        return [each for lane in pool.map(lambda lane: make_lane(lane, made, say), lanes) for each in lane]


def main() -> int:
    """Install what is missing, and name what could not be installed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--lane", nargs="+", action="append", required=True, metavar="TARGET")
    wanted = parser.parse_args().lane
    lanes = [[each for each in lane if not is_current(each)] for lane in wanted]
    print("installing what the tests need; downloads are kept for other clones:", flush=True)
    began_s = time.monotonic()
    results = install([lane for lane in lanes if lane], say=lambda text: print(text, flush=True))
    failed = [each.target for each in results if not each.is_made]
    print(f"installed in {time.monotonic() - began_s:.0f} s", flush=True)
    for target in failed:
        print(f"{target} could not be made: the tests that need it are not run", flush=True)
    return int(wanted[0][0] in failed)


if __name__ == "__main__":
    sys.exit(main())
