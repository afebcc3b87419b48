"""The documents use the texts of the findings."""

from pathlib import Path

import pytest

from hostlink.core.diagnosis.finding import words
from hostlink.workbench.sim.robot import FAULTS

DOCUMENT = (Path(__file__).parents[4] / "docs" / "troubleshooting.md").read_text()


@pytest.mark.parametrize("code", words())
def test_document_row_has_the_texts_of_the_finding(code: str) -> None:
    texts = words()[code]
    assert f"\n| {texts['symptom']} | `{code}` | {texts['cause']} | {texts['next_step']} |\n" in DOCUMENT


def test_document_rows_are_exactly_the_findings_in_order() -> None:
    rows = [line.split(" | `")[1].split("`")[0] for line in DOCUMENT.splitlines() if " | `" in line]
    assert rows == list(words())


def test_every_fault_of_the_simulation_is_named() -> None:
    listed = DOCUMENT.split("one of these troubles: ")[1].split(".")[0]
    assert [name.strip() for name in listed.split(",")] == list(FAULTS)
