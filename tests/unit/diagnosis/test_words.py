"""The documents say what the findings say."""

from pathlib import Path

import pytest

from hostlink.diagnosis.finding import words
from hostlink.sim.faults import FAULTS

DOCUMENT = (Path(__file__).parents[3] / "docs" / "troubleshooting.md").read_text()


@pytest.mark.parametrize("code", words())
def test_the_row_of_a_finding_is_as_its_words(code: str) -> None:
    texts = words()[code]
    assert f"\n| {texts['symptom']} | `{code}` | {texts['cause']} | {texts['next_step']} |\n" in DOCUMENT


def test_the_rows_stand_in_order_and_there_are_no_others() -> None:
    rows = [line.split(" | `")[1].split("`")[0] for line in DOCUMENT.splitlines() if " | `" in line]
    assert rows == list(words())


def test_every_fault_of_the_simulation_is_named() -> None:
    listed = DOCUMENT.split("one of these troubles: ")[1].split(".")[0]
    assert [name.strip() for name in listed.split(",")] == list(FAULTS)
