"""Causes by name: each changes one thing."""

import pytest

from hostlink.workbench.lab.experiment import PAPER_WORLD, Setup, Software
from hostlink.workbench.lab.robots import Mistakes, names
from hostlink.workbench.lab.tables import CAUSES, MISTAKES, Cause

USUAL = Setup(software=Software.FIRMWARE)


@pytest.mark.parametrize("cause", CAUSES[1:], ids=lambda cause: cause.name)
def test_each_cause_changes_the_world_or_the_operator(cause: Cause) -> None:
    setup = cause.setup(Software.FIRMWARE)
    assert (setup.world != PAPER_WORLD) != (setup.habits != USUAL.habits)
    assert cause.setup(Software.PAPER).mistakes == Mistakes()


def test_a_mistake_is_made_alone_and_left_out_alone() -> None:
    assert [cause.name for cause in MISTAKES] == names()
    alone, without = MISTAKES[0].setup(Software.FIRMWARE), MISTAKES[0].setup(Software.PAPER)
    assert alone.mistakes == Mistakes.none().changed(names()[0], is_made=True)
    assert without.mistakes == Mistakes().changed(names()[0], is_made=False)


def test_names_and_titles_are_there_once() -> None:
    listed = [*CAUSES, *MISTAKES]
    assert len({cause.name for cause in listed}) == len({cause.title for cause in listed}) == len(listed)
