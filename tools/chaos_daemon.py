"""Chaos against a real daemon: hostile devices and programs from a seed, while one honest robot is driven.

    python tools/chaos_daemon.py                          # a minute from a new seed
    python tools/chaos_daemon.py --seed 7 --seconds 600   # the same steps again, for longer
    python tools/chaos_daemon.py --seed 7 --quota 0.25    # with a quarter of a core for the daemon
    python tools/chaos_daemon.py --seeds 1-20 --seconds 12 --keep-going --out build/chaos.json

Not tools/chaos.py, which harms the line between an honest device and a host. Ends with status 1 when a promise did not
hold: prints the seed, the step, what was under way, and the command that repeats it.
"""

import argparse
import asyncio
import dataclasses
import json
import secrets
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.support.chaos import limits
from tests.support.chaos.plan import KINDS
from tests.support.chaos.report import describe
from tests.support.chaos.run import Outcome, Wanted, run


def main() -> int:
    arguments = command_line().parse_args()
    outcomes = []
    for seed in arguments.seeds or [secrets.randbelow(1_000_000)]:
        print(f"seed {seed}", flush=True)
        outcome = asyncio.run(run(wanted_of(arguments, seed), lambda line: print(line, flush=True)))
        print(describe(outcome), flush=True)
        outcomes.append(outcome)
    if arguments.out:
        arguments.out.parent.mkdir(parents=True, exist_ok=True)
        arguments.out.write_text(json.dumps([as_data(outcome) for outcome in outcomes], indent=1) + "\n")
    return 1 if any(outcome.violations for outcome in outcomes) else 0


def wanted_of(arguments: argparse.Namespace, seed: int) -> Wanted:
    return Wanted(
        seed=seed,
        seconds=arguments.seconds,
        limits=limits.from_flags(arguments),
        kinds=tuple(arguments.kind),
        steps=arguments.steps,
        first_step=arguments.first_step,
        keeps_going=arguments.keep_going,
        has_udp=arguments.udp,
        quota=arguments.quota,
        log=arguments.log,
    )


def as_data(outcome: Outcome) -> dict[str, object]:
    wanted = dataclasses.asdict(outcome.wanted) | {"log": str(outcome.wanted.log)}
    return dataclasses.asdict(outcome) | {"command": outcome.wanted.command(), "wanted": wanted}


def command_line() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", "--seeds", dest="seeds", type=seeds, help="a number, or 1-20: a daemon for each")
    parser.add_argument("--seconds", type=float, default=60.0, help="of hostile steps for each seed (%(default)s)")
    parser.add_argument("--steps", type=int, help="instead: so many steps")
    parser.add_argument("--first-step", type=int, default=0, help="begin with this step of the seed's (%(default)s)")
    parser.add_argument("--kind", action="append", default=[], choices=tuple(KINDS), help="only this kind of action")
    parser.add_argument("--keep-going", action="store_true", help="collect violations; else the first ends the run")
    parser.add_argument(
        "--udp",
        action=argparse.BooleanOptionalAction,
        default=True,
        help="some devices, and at times the honest robot, send datagrams; without, a seed gives its steps of before",
    )
    parser.add_argument(
        "--quota",
        type=float,
        help="of a core, as 0.12, for the daemon and its guardian, by a control group or by stopping them in turn",
    )
    parser.add_argument("--log", type=Path, help="keep the daemon's log in this file")
    parser.add_argument("--out", type=Path, help="all findings and figures as JSON")
    limits.add_flags(parser)
    return parser


def seeds(text: str) -> list[int]:
    first, _, last = text.partition("-")
    return list(range(int(first), int(last or first) + 1))


if __name__ == "__main__":
    sys.exit(main())
