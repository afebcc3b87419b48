"""Motors that are drawn, driven by a loop around them that is drawn too: identification finds their numbers again."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from hostlink.errors import HostlinkError
from hostlink.workbench.motor_model import MotorModel, driven_part, identify_motor, simc_gains
from hostlink.workbench.step_response import Record, Sample, make_record
from tests.support.strategies import fewer_examples

LOOP_S = 1 / 30
SETTLE_S = 1.5
LEVELS = (70.0, 95.0, 120.0, 145.0, 165.0)


def drive(
    *,
    gain: float = 0.07,
    offset_pwm: float = 0.0,
    constant_s: float = 0.4,
    dead_turns: int = 3,
    kp: float = 23.0,
    ki: float = 36.0,
    noise: float = 0.0,
    seed: int = 0,
    sign: float = 1.0,
    levels: tuple[float, ...] = LEVELS,
) -> Record:
    """A PI loop of 30 Hz along rising speeds with ramps, of which every third turn is recorded."""
    random = np.random.default_rng(seed)
    decay = np.exp(-LOOP_S / constant_s)
    speed = integral = wanted = 0.0
    waiting = [0.0] * (dead_turns + 1)
    rows = []
    for turn in range(round(SETTLE_S / LOOP_S) * len(levels)):
        target = levels[int(turn * LOOP_S / SETTLE_S)]
        wanted += float(np.clip(target - wanted, -2.0, 2.0))
        speed = speed * decay + gain * max(waiting[0] - offset_pwm, 0.0) * (1 - decay)
        measured = speed + noise * random.normal()
        integral += (wanted - measured) * LOOP_S
        pwm = float(np.clip(kp * (wanted - measured) + ki * integral, 0.0, 4095.0))
        waiting = [*waiting[1:], pwm]
        if turn % 3 == 2:
            rows.append((turn * LOOP_S, wanted, measured, pwm))
    t_s, set_point, measured_, pwm_ = np.array(rows).T
    return Record("ticks/s", t_s, sign * set_point, sign * measured_, sign * pwm_)


@pytest.mark.slow
@fewer_examples(2)
@given(
    st.floats(0.05, 0.09),
    st.floats(0.0, 600.0),
    st.floats(0.2, 0.6),
    st.integers(1, 5),
    st.sampled_from([-1.0, 1.0]),
    st.integers(0, 1000),
)
@example(0.0684, 0.0, 0.37, 2, 1.0, 1)
def test_drawn_motors_are_found_again(
    gain: float, offset_pwm: float, constant_s: float, dead_turns: int, sign: float, seed: int
) -> None:
    motor = drive(
        gain=gain, offset_pwm=offset_pwm, constant_s=constant_s, dead_turns=dead_turns, noise=0.3, seed=seed, sign=sign
    )
    dead_s = (dead_turns + 0.5) * LOOP_S  # a PWM lasts for a turn of the loop: half of it late
    model = identify_motor(motor)
    assert model.gain == pytest.approx(gain, rel=0.05)
    assert model.offset_pwm == pytest.approx(offset_pwm, abs=120)
    assert model.time_constant_s == pytest.approx(constant_s, rel=0.2, abs=0.03)
    assert model.dead_time_s == pytest.approx(dead_s, abs=0.05)
    assert model.explained > 0.99


def test_without_noise_every_number_is_exact_but_for_the_rate_of_the_messages() -> None:
    model = identify_motor(drive(offset_pwm=300.0))
    assert model.gain == pytest.approx(0.07, rel=0.003)
    assert model.offset_pwm == pytest.approx(300.0, abs=10)
    assert model.time_constant_s == pytest.approx(0.4, rel=0.03)
    assert model.dead_time_s == pytest.approx(3.5 * LOOP_S, abs=0.015)
    assert model.explained > 0.9999


def test_the_gains_are_those_of_the_paper_that_is_named() -> None:
    """Skogestad's rule for k = 2, tau1 = 8, theta = 0.5, tau_c = 0.5: Kc = 4, tauI = min(8, 4)."""
    model = MotorModel(gain=2.0, offset_pwm=0, time_constant_s=8.0, dead_time_s=0.5, explained=1)
    assert simc_gains(model).kp == pytest.approx(4.0)
    assert simc_gains(model).ki == pytest.approx(1.0)
    assert simc_gains(model).kd == 0


def test_a_motor_without_dead_time_gets_no_endless_gains() -> None:
    model = MotorModel(gain=0.07, offset_pwm=0, time_constant_s=0.35, dead_time_s=0.0, explained=1)
    assert simc_gains(model).kp == pytest.approx(50.0)


def test_a_loop_with_the_new_gains_follows_better_and_does_not_swing() -> None:
    before = drive()
    gains = simc_gains(identify_motor(before))
    after = drive(kp=gains.kp, ki=gains.ki, levels=(165.0,) * 5)
    old = drive(levels=(165.0,) * 5)
    assert np.abs(after.set_point - after.measured).mean() < 0.8 * np.abs(old.set_point - old.measured).mean()
    assert after.measured.max() < 1.08 * 165


def test_only_the_part_that_is_driven_counts() -> None:
    observed = drive()
    observed.pwm[:10] = np.where(np.arange(10) % 2, 700.0, 0.0)  # below its least PWM a robot drives and brakes in turn
    observed.pwm[10:] = np.maximum(observed.pwm[10:], 710.0)
    assert len(driven_part(observed).t_s) == len(observed.t_s) - 10


@pytest.mark.parametrize("pwm", [np.zeros(75), np.where(np.arange(75) < 20, 900.0, 0.0)])
def test_a_robot_that_was_hardly_driven_is_refused(pwm: np.ndarray) -> None:
    t_s = np.arange(75) / 10
    with pytest.raises(HostlinkError, match="request a higher --speed"):
        identify_motor(Record("ticks/s", t_s, t_s, t_s, pwm))


def test_a_robot_without_pwm_is_refused() -> None:
    t_s = np.arange(75) / 10
    with pytest.raises(HostlinkError, match="sends no PWM"):
        identify_motor(Record("m/s", t_s, t_s, t_s))


def noise_alone(random: np.random.Generator) -> np.ndarray:
    return 100 + random.normal(size=75)


def against_the_pwm(_: np.random.Generator) -> np.ndarray:
    return 200 - np.arange(75) * 1.5


def constant(_: np.random.Generator) -> np.ndarray:
    return np.full(75, 100.0)


@pytest.mark.parametrize("speeds", [noise_alone, against_the_pwm, constant])
def test_record_that_does_not_fit_a_motor_is_refused(speeds: object) -> None:
    random = np.random.default_rng(3)
    t_s = np.arange(75) / 10
    pwm = 1000 + 20 * np.arange(75) + 50 * random.normal(size=75)
    assert callable(speeds)
    with pytest.raises(HostlinkError, match="do not belong together"):
        identify_motor(Record("ticks/s", t_s, np.full(75, 100.0), speeds(random), pwm))


def test_model_and_gains_are_readable() -> None:
    model = identify_motor(drive())
    assert str(model).startswith("K 0.07")
    assert str(simc_gains(model)).startswith("Kp ")


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(10))
def test_messages_that_come_late_or_never_cost_digits_and_no_more(seed: int) -> None:
    """A mean delay of half the time between two messages, and one of 25 lost."""
    random = np.random.default_rng(seed)
    sent = drive(noise=0.3, seed=seed)
    assert sent.pwm is not None
    arrivals_s = np.maximum.accumulate(sent.t_s + random.exponential(0.05, len(sent.t_s)))  # none overtakes another
    rows = zip(arrivals_s, sent.set_point, sent.measured, sent.pwm, strict=True)
    received = [(float(at_s), Sample(*row)) for at_s, *row in rows if random.random() > 0.04]
    model = identify_motor(make_record("ticks/s", *zip(*received, strict=True)))
    assert model.gain == pytest.approx(0.07, rel=0.05)
    assert model.time_constant_s == pytest.approx(0.4, rel=0.2)
    assert model.dead_time_s == pytest.approx(3.5 * LOOP_S, abs=0.04)
