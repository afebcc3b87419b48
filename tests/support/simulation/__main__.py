"""Play seeds: python -m tests.support.simulation 7, or 0-999 with several processes. Prints what they broke."""

import argparse
import concurrent.futures
import sys
from functools import partial

from tests.support.simulation.run import play


def main() -> int:
    """Play the seeds of the arguments; a single one prints its log, too."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("seeds", help="7, or 0-999")
    parser.add_argument("--seconds", type=float, default=60.0, help="of simulated time, before all end (%(default)g)")
    parser.add_argument("--processes", type=int, default=1)
    arguments = parser.parse_args()
    first, _, last = arguments.seeds.partition("-")
    if not last:
        found = play(int(first), arguments.seconds)
        sys.stdout.write(found.log + (f"{found}\n" if found.broken else ""))
        return int(bool(found.broken))
    seeds = range(int(first), int(last) + 1)
    failed = 0
    with concurrent.futures.ProcessPoolExecutor(arguments.processes) as pool:
        for found in pool.map(partial(play, seconds=arguments.seconds), seeds):
            failed += bool(found.broken)
            if found.broken:
                sys.stdout.write(f"{found}\n")
                sys.stdout.flush()
    sys.stdout.write(f"{len(seeds)} seeds, {failed} failed\n")
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
