"""Every input that a fuzzer has found worth keeping, tried again."""

from pathlib import Path

import pytest

from tests.support.fuzz_targets import TARGETS

CORPUS = Path(__file__).parent.parent / "corpus"


@pytest.mark.parametrize("target", TARGETS)
def test_the_corpus_breaks_no_law(target: str) -> None:
    inputs = sorted((CORPUS / target).iterdir())
    assert len(inputs) >= 5
    for found in inputs:
        TARGETS[target](found.read_bytes())
