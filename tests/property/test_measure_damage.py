"""Damaged frames that are delivered: no more than an 8-bit checksum lets through. `make soak` tries ten million."""

import pytest

from tools.measure_damage import KINDS, Damage, measure, one_bit

FRAMES = 10_000


@pytest.mark.slow
@pytest.mark.parametrize("damage", KINDS, ids=lambda damage: damage.__name__)
def test_few_damaged_frames_pass_and_none_with_a_single_bit(damage: Damage) -> None:
    found = measure(damage, FRAMES)
    assert found["hostlink"] <= found["checksums_alone"]
    assert found["hostlink"] <= FRAMES / 256 * 1.3  # four standard deviations of chance
    assert found["intact_lost"] <= found["hostlink"]
    assert damage is not one_bit or found["hostlink"] == 0
