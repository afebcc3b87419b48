"""Inputs that fuzzers have found, tested again."""

from pathlib import Path

import pytest

from tests.support.fuzz_targets import TARGETS

CORPUS = Path(__file__).parent.parent / "corpus"


@pytest.mark.parametrize("target", TARGETS)
def test_inputs_of_the_corpus_keep_the_invariants(target: str) -> None:
    inputs = sorted((CORPUS / target).iterdir())
    assert len(inputs) >= 5
    for found in inputs:
        TARGETS[target](found.read_bytes())
