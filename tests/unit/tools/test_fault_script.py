"""Fault script: the lines that a person types for the relay."""

import pytest

from tools.fault_script import BadScript, parse
from tools.faults import AMOUNTS, Direction, Habits, Kind, Rule, Script, Span


def test_a_whole_script() -> None:
    lines = [
        "# the paper's link",
        "",
        "seed 7",
        "split 1-7",
        "delay 50±20ms",
        "merge 40ms",
        "rate 3840",
        "for 10min",
        "at 10 cut   # once",
        "every 120 lose 1s",
        "every 2+-0.5 damage 3 from-device",
    ]
    assert parse(lines) == Script(
        seed=7,
        habits=Habits(
            split_bytes=Span(1, 7),
            delay_s=Span(pytest.approx(0.03), pytest.approx(0.07)),
            merge_s=0.04,
            rate_bytes_s=3840,
        ),
        rules=(
            Rule(Span(10, 10), repeats=False, kind=Kind.CUT, amount=Span(0, 0)),
            Rule(Span(120, 120), repeats=True, kind=Kind.LOSE, amount=Span(1, 1)),
            Rule(Span(1.5, 2.5), True, Kind.DAMAGE, Span(3, 3), Direction.FROM_DEVICE),
        ),
        length_s=600,
    )


@pytest.mark.parametrize("kind", list(Kind))
def test_each_fault_has_an_amount_of_its_own(kind: Kind) -> None:
    rule = parse([f"at 1min {kind.value}"]).rules[0]
    assert (rule.at_s, rule.kind, rule.amount) == (Span(60, 60), kind, AMOUNTS.get(kind, Span(0, 0)))


@pytest.mark.parametrize(
    ("line", "complaint"),
    [
        ("at 10", "at 10: a time, a fault and perhaps a number"),
        ("at soon cut", "soon: a number like 5, 1-7 or 50±20, in s, ms, min or h"),
        ("at 10 explode", "no fault explode; known: lose, blackout, drop"),
        ("at 10 cut 5", "cut takes no number"),
        ("at 10 cut to-device", "cut has no direction"),
        ("every 0 cut", "every 0 cut: too often"),
        ("every 5 drop 3s", "3s: a number like 5, 1-7 or 50±20"),
        ("split 0", "split 0: a piece has at least one byte"),
        ("split 7-1", "7-1: the smaller number first"),
        ("rate 0", "rate 0: bytes a second, more than none"),
        ("delay", "delay: one value after delay"),
        ("seed x", "seed x: known are at, every"),
        ("slow 3", "slow 3: known are at, every"),
    ],
)
def test_a_line_that_means_nothing_is_refused_with_what_is_known(line: str, complaint: str) -> None:
    with pytest.raises(BadScript) as caught:
        parse([line])
    assert str(caught.value).startswith(complaint)
