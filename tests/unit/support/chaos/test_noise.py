"""Noise: cost of the machine itself, measured in the judged time, and bounded."""

import pytest

from hostlink.core.hub.stall_watch import GRACE_S
from tests.support.chaos.noise import Noise


@pytest.fixture
def noise() -> Noise:
    made = Noise(stretch_most=3.0)
    for second in range(11):
        made.add_turn(float(second), ran_s=0.5 * second, waited_s=0.0 if second < 5 else 0.25 * (second - 5))
    return made


def test_a_daemon_that_had_its_core_is_given_no_longer(noise: Noise) -> None:
    assert noise.stretch(0.0, 4.0) == 1.0
    assert noise.waited_s(0.0, 4.0) == 0.0


def test_a_daemon_that_waited_for_its_core_is_given_as_much_longer(noise: Noise) -> None:
    assert noise.stretch(6.0, 10.0) == pytest.approx(1.5)
    assert noise.waited_s(5.0, 10.0) == pytest.approx(1.25)


def test_a_time_between_two_samples_is_judged_by_those_around_it(noise: Noise) -> None:
    assert noise.waited_s(6.2, 6.4) == pytest.approx(0.25)
    assert noise.stretch(6.2, 6.4) == pytest.approx(1.5)


def test_no_machine_is_so_busy_that_everything_is_forgiven() -> None:
    made = Noise(stretch_most=3.0)
    made.add_turn(0.0, 0.0, 0.0)
    made.add_turn(1.0, 0.01, 0.99)
    assert made.stretch(0.0, 1.0) == 3.0


def test_without_samples_nothing_is_forgiven() -> None:
    assert Noise(stretch_most=3.0).stretch(0.0, 1.0) == 1.0
    assert Noise(stretch_most=3.0).lag_s(0.0, 1.0) == 0.0


def test_the_longest_lateness_of_a_time_counts(noise: Noise) -> None:
    for at_s, lag_s in ((1.0, 0.5), (3.0, 0.1), (4.0, 0.2), (9.0, 0.9)):
        noise.add_lag(at_s, lag_s)
    assert noise.lag_s(2.0, 5.0) == 0.2


def test_noise_with_a_pause_that_lasts_counts_the_part_inside_the_time(noise: Noise) -> None:
    noise.pause(3.0)
    assert noise.paused_s(2.0, 5.0) == 2.0
    noise.pause(3.0, 4.0)
    assert noise.paused_s(2.0, 5.0) == 1.0
    assert noise.paused_s(4.5, 5.0) == 0.0
    assert noise.absent_s(0.0, 10.0) == 0.0
    noise.absence(6.0, 7.5)
    assert noise.absent_s(0.0, 7.0) == 1.0


def test_the_time_after_a_long_pause_in_which_velocities_are_refused_is_counted_once() -> None:
    made = Noise(stretch_most=3.0)
    made.pause(1.0, 2.0)
    made.pause(2.1, 2.2)
    assert made.refusing_s(0.0, 10.0) == pytest.approx(1.0 + GRACE_S)
    assert made.refusing_s(1.5, 2.0) == pytest.approx(0.5)
    assert made.refusing_s(2.5, 3.0) == 0.0
