"""Age of the velocities that a device receives while the API's port is under load.

    python tools/late_commands.py uploads --connections 200
    python tools/late_commands.py metrics --connections 6 --part 0.25

The driver publishes at 20 Hz over rosbridge, each velocity with the time at which it was sent, and is killed. `--part`:
of a core, by a control group, for the daemon.
"""

import argparse
import asyncio
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.support.late_commands import DRIVE_S, measure


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("load", nargs="*", choices=("uploads", "bodies", "metrics", "latched", []))
    parser.add_argument("--connections", type=int, default=60)
    parser.add_argument("--part", type=float, help="of a core")
    parser.add_argument("--seconds", type=float, default=DRIVE_S)
    parser.add_argument("--stops", action="store_true", help="stop by REST and by WebSocket meanwhile")
    wanted = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        print(
            asyncio.run(
                measure(
                    wanted.load,
                    folder=Path(folder),
                    connections=wanted.connections,
                    part=wanted.part,
                    drive_s=wanted.seconds,
                    has_stops=wanted.stops,
                )
            )
        )


if __name__ == "__main__":
    main()
