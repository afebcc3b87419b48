"""A failure is told with all that is needed to see it again."""

import argparse
import shlex

import pytest

from tests.support.chaos import limits
from tests.support.chaos.connection import Room
from tests.support.chaos.limits import Limits
from tests.support.chaos.report import describe
from tests.support.chaos.run import Outcome, Wanted
from tests.support.chaos.violation import Violation
from tools.chaos_daemon import command_line, wanted_of

LATE = Violation("command p99", 0.25, 0.1, "median 0.001 s", step=3, under_way=("flood: of logs", "idle: 20"))


def test_a_failure_names_seed_step_figure_limit_what_was_under_way_and_the_command() -> None:
    text = describe(Outcome(Wanted(seed=7, seconds=20.0), [LATE], {"commands": 300, "end_s": 0.21234}, steps=3))
    assert "FAILED seed 7, step 3: command p99: 0.25, the limit is 0.1; median 0.001 s" in text
    assert "flood: of logs" in text
    assert "end_s 0.2123" in text
    assert "again: python tools/chaos_daemon.py --seed 7 --seconds 20" in text


def test_a_run_without_violations_names_no_failure() -> None:
    assert "FAILED" not in describe(Outcome(Wanted(seed=7, seconds=20.0), steps=12))


@pytest.mark.parametrize(
    "wanted",
    [
        Wanted(seed=7, seconds=20.0),
        Wanted(seed=3, seconds=5.5, kinds=("flood", "idle"), first_step=4, steps=2, keeps_going=True),
        Wanted(seed=1, seconds=60.0, limits=Limits(p99_s=0.02, robots=1000)),
    ],
)
def test_the_printed_command_plays_the_same_again(wanted: Wanted) -> None:
    _, _, *words = shlex.split(wanted.command())
    arguments = command_line().parse_args(words)
    assert wanted_of(arguments, arguments.seeds[0]) == wanted


def test_each_limit_has_a_flag() -> None:
    parser = argparse.ArgumentParser()
    limits.add_flags(parser)
    assert limits.from_flags(parser.parse_args([])) == Limits()
    assert limits.from_flags(parser.parse_args(["--limit-zero-s", "0.7"])) == Limits(zero_s=0.7)


def test_the_generator_opens_no_more_connections_than_it_may() -> None:
    room = Room(device=3)
    assert room.reserve("device", 2) == 2
    assert room.reserve("device", 2) == 1
    assert room.reserve("device", 1) == 0
    room.give_back("device", 1)
    assert room.reserve("device", 5) == 1
