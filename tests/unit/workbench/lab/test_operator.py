"""The operator stops at the true marks, with either software, and each seed repeats."""

import math

import pytest

from hostlink.workbench.lab.experiment import (
    BACK,
    LINE,
    PATTERNS,
    SQUARE_LEFT,
    Experiment,
    Habits,
    Pattern,
    Setup,
    Software,
    conduct,
    errors_of,
)
from hostlink.workbench.lab.robots import Mistakes

EXACT = Habits(mark_noise_m=0.0, aim_noise_rad=0.0)
PAPER = Setup(software=Software.PAPER, habits=EXACT)
MENDED = Setup(software=Software.PAPER, mistakes=Mistakes.none(), habits=EXACT)


@pytest.mark.parametrize("pattern", PATTERNS, ids=lambda pattern: pattern.name)
def test_he_ends_at_the_last_mark(pattern: Pattern) -> None:
    (run,) = conduct(Experiment(MENDED, pattern, 1))
    truth = run.samples[-1].truth
    assert math.dist(pattern.marks_of(0)[-1], truth[:2]) < 0.12


def test_software_without_mistakes_knows_where_it_is() -> None:
    errors = errors_of(conduct(Experiment(MENDED, SQUARE_LEFT, 1)))
    assert errors.means_cm.max() < 0.002 * 800  # 0.2 % of the way


def test_the_paper_s_software_does_not() -> None:
    errors = errors_of(conduct(Experiment(PAPER, SQUARE_LEFT, 1)))
    assert 0.5 < errors.means_cm.max() < 20.0


@pytest.mark.slow
def test_equal_seeds_repeat_and_others_differ() -> None:
    noisy = Setup(software=Software.PAPER, mistakes=Mistakes.none())
    first, second = (conduct(Experiment(noisy, BACK, 2)) for _ in range(2))
    assert [run.samples for run in first] == [run.samples for run in second]
    assert first[0].error_cm != first[1].error_cm


def test_lines_have_the_lengths_of_table_4() -> None:
    assert [LINE.marks_of(run)[0][0] for run in range(6)] == [3.84, 3.52, 3.47, 3.96, 3.95, 3.84]


def test_a_push_by_hand_is_not_noticed() -> None:
    pushed = Setup(software=Software.PAPER, mistakes=Mistakes.none(), habits=Habits(push_m=0.05))
    errors = errors_of(conduct(Experiment(pushed, LINE, 1)))
    assert abs(errors.xy_cm[0, 1]) == pytest.approx(5.0, abs=0.2)
