"""The figures of a step, of curves whose figures are known."""

import math

import numpy as np
import pytest

from hostlink.errors import HostlinkError
from hostlink.workbench.step_response import Record, Sample, crossing_s, make_record, regular_times, step_figures


def step(*, constant_s: float = 0.5, dead_s: float = 0.2, target: float = 100.0, reached: float = 1.0) -> Record:
    """A first-order step at 10 Hz, from half a second before it; the set-point jumps."""
    t_s = np.arange(-5, 60) / 10
    wanted = np.where(t_s >= 0, target, 0.0)
    measured = reached * target * (1 - np.exp(-np.maximum(t_s - dead_s, 0.0) / constant_s))
    return Record("ticks/s", t_s, wanted, measured, wanted * 10)


def test_the_figures_of_a_first_order_step_are_those_of_the_textbook() -> None:
    figures = step_figures(step(constant_s=1.0))
    assert figures.target == 100.0
    assert figures.rise_s == pytest.approx(math.log(9), abs=0.01)
    assert figures.dead_s == pytest.approx(0.2 - math.log(0.98), abs=0.01)
    assert figures.settling_s == pytest.approx(0.2 - math.log(0.05), abs=0.1)
    assert figures.lag_s == pytest.approx(0.2 + math.log(2), abs=0.06)
    assert figures.set_point_rise_s == pytest.approx(0.08)
    assert figures.overshoot_percent == 0.0
    assert figures.steady_error_percent == pytest.approx(-0.5, abs=0.1)
    assert figures.saturated_percent == 0.0


def test_an_overshoot_is_in_percent_of_the_target() -> None:
    observed = step()
    observed.measured[20] = 117.0
    assert step_figures(observed).overshoot_percent == pytest.approx(17.0)


def test_a_step_backwards_has_the_figures_of_one_forwards() -> None:
    back, forth = step_figures(step(target=-100.0)), step_figures(step())
    assert back.target == -100.0
    assert (back.rise_s, back.settling_s, back.saturated_percent) == (forth.rise_s, forth.settling_s, 0.0)
    assert back.steady_error_percent == pytest.approx(forth.steady_error_percent)


def test_a_robot_that_stays_slow_never_rises_nor_settles() -> None:
    figures = step_figures(step(reached=0.4))
    assert (figures.rise_s, figures.settling_s, figures.lag_s) == (None, None, None)
    assert figures.steady_error_percent == pytest.approx(-60.0, abs=0.1)


def test_one_that_never_leaves_the_target_has_settled_at_once() -> None:
    t_s = np.arange(20) / 10
    figures = step_figures(Record("m/s", t_s, np.full(20, 0.2), np.full(20, 0.2)))
    assert (figures.settling_s, figures.saturated_percent, figures.dead_s) == (0.0, None, 0.0)


def test_full_pwm_is_a_saturation_from_the_first_command_on() -> None:
    observed = step()
    assert step_figures(observed, full_pwm=1000.0).saturated_percent == 100.0
    observed.pwm[35:] = 500.0
    assert step_figures(observed, full_pwm=1000.0).saturated_percent == 50.0


@pytest.mark.parametrize("when", [slice(-1, None), slice(20, 23), slice(None)])
def test_set_point_that_falls_to_zero_does_not_count_as_a_step(when: slice) -> None:
    observed = step()
    observed.set_point[when] = 0.0
    with pytest.raises(HostlinkError, match="fell to 0 during the step"):
        step_figures(observed)


def test_a_level_is_crossed_between_two_samples() -> None:
    t_s, values = np.array([0.0, 0.1, 0.2]), np.array([0.0, 1.0, 5.0])
    assert crossing_s(t_s, values, 2.0) == pytest.approx(0.125)
    assert crossing_s(t_s, values, 0.0) == 0.0
    assert crossing_s(t_s, values, 6.0) is None


def test_messages_that_a_network_delays_are_a_tenth_of_a_second_apart() -> None:
    sent_s = np.arange(80) / 10
    burst_s = np.array([0.3, 0.2, 0.1, 0.0] * 20)  # four come together
    times_s = regular_times(list(sent_s + burst_s))
    assert np.diff(times_s) == pytest.approx(np.full(79, 0.1), abs=0.001)
    assert times_s == pytest.approx(sent_s + 0.15, abs=0.01)


def test_a_record_needs_messages() -> None:
    with pytest.raises(HostlinkError, match="only 14 messages"):
        make_record("m/s", [number / 10 for number in range(14)], [Sample(0.2, 0.1)] * 14)


def test_a_record_has_the_pwm_only_where_each_message_has_it() -> None:
    times_s = [number / 10 for number in range(16)]
    whole, partly = [Sample(2.0, 1.0, 700.0)] * 16, [Sample(2.0, 1.0), *[Sample(2.0, 1.0, 700.0)] * 15]
    assert make_record("ticks/s", times_s, partly).pwm is None
    pwm = make_record("ticks/s", times_s, whole).pwm
    assert pwm is not None
    assert list(pwm) == [700.0] * 16


def test_a_set_point_that_still_moves_at_the_end_is_noticed() -> None:
    observed = step()
    assert not observed.is_set_point_changing
    observed.set_point[-1] += 1.0
    assert observed.is_set_point_changing
