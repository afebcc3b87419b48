"""Losses of the policies of NodeHandle under gaps, as in firmware/README.md. The best of them is the default."""

import pytest

from tests.firmware.due import Retry, node
from tools.measure_retry import POLICIES, lost, lost_of_bursts

FRAMES, SEED = 100, 1
ORIGINAL, PAPER, KEEP, KEEP_EACH_PASS = POLICIES


@pytest.mark.parametrize("gap_s", [0.0, 0.009, 0.025, 0.2])
@pytest.mark.parametrize("policy", [KEEP, KEEP_EACH_PASS], ids=lambda policy: policy.name)
def test_the_default_loses_nothing_at_any_gap_up_to_a_fifth_of_a_second(policy: object, gap_s: float) -> None:
    assert lost(policy, gap_s, FRAMES, SEED) == (0, 0)  # type: ignore[arg-type]


def test_the_clause_of_the_paper_bridges_short_gaps_and_no_long_ones() -> None:
    assert lost(PAPER, 0.009, FRAMES, SEED) == (0, 0)
    assert lost(PAPER, 0.05, FRAMES, SEED)[0] == FRAMES


def test_the_original_loses_what_straddles_two_turns_of_its_loop() -> None:
    frames, _ = lost(ORIGINAL, 0.0, FRAMES, SEED)
    assert 0.15 * FRAMES < frames < 0.45 * FRAMES
    assert lost(ORIGINAL, 0.025, FRAMES, SEED)[0] > 0.8 * FRAMES


def test_only_a_loop_that_drains_the_ring_on_each_pass_survives_a_burst() -> None:
    assert lost_of_bursts(KEEP, 2, FRAMES, SEED) == (0, 0)  # 112 of the ring's 127 bytes
    assert lost_of_bursts(KEEP, 10, FRAMES, SEED)[0] > 0
    assert lost_of_bursts(KEEP_EACH_PASS, 10, FRAMES, SEED) == (0, 0)


def test_default_policy_is_the_best_one() -> None:
    with node() as default:
        default.feed(b"\xff\xfe\x01\x00\xfe")
        assert default.spin(1.0) is None
        default.feed(b"\x65\x00\x01\x99")
        assert default.spin(1.2) is None
        assert default.received() == [b"\x01"]
    assert max(Retry) is Retry.KEEP_STATE
