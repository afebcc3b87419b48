"""Calibration of the real firmware in its world: the wheels are measured, their numbers are set, and its squares close.

Three seeds in make test-all, 30 in `make soak` (HOSTLINK_SEEDS). tools/measure_calibration.py prints what it asserts.
"""

import os

import pytest

from tools.measure_calibration import WORLD, errors_in, gain, noisy

SEEDS = int(os.environ.get("HOSTLINK_SEEDS", "3"))


def test_without_noise_the_square_s_error_falls_a_hundredfold() -> None:
    errors = errors_in(WORLD)
    assert errors.before_m > 0.3
    assert errors.umbmark_m < errors.before_m / 100
    assert errors.least_squares_m < errors.before_m / 100


@pytest.mark.long
@pytest.mark.timeout(300 + 30 * SEEDS)
def test_with_slip_and_a_random_caster_the_square_s_error_falls_fivefold() -> None:
    """The mean of all seeds counts; with thirty seeds the lower end of its confidence interval counts too."""
    errors = [errors_in(noisy(seed)) for seed in range(1, SEEDS + 1)]
    for found in (gain(errors, lambda each: each.umbmark_m), gain(errors, lambda each: each.least_squares_m)):
        assert (found.low if SEEDS >= 30 else found.middle) > 5.0
