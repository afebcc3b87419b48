"""Reaction of the Due's firmware to a command of the other sign and to a slower one, by the true motion of its wheels.

docs/wheel-control.md#slower-and-the-other-way has these figures.
"""

from functools import cache

import numpy as np
import pytest

from hostlink.workbench.lab.robots import S_PER_TICK_S
from hostlink.workbench.sim.firmware_module import WorldParameters
from hostlink.workbench.sim.firmware_world import COMMAND_S, FirmwareWorld, Trace
from tests.firmware.scripts import CONNECT_MS, ROW_MS, Script, column, draw, draw_reversals, run_module
from tests.firmware.worlds import METRES_PER_TICK

SEEDS = range(40)
SAMPLE_S = 0.001
STANDS_M_S = 0.0025  # two ticks a second
ONE_EDGE_M = METRES_PER_TICK / 2
SIDES = ("left", "right")


def change(
    world: WorldParameters, first: tuple[float, float], second: tuple[float, float], seconds: float = 1.5
) -> Trace:
    """Rows since the second velocity of a robot that has driven with the first one for long."""
    robot = FirmwareWorld(world)
    robot.connect()
    robot.drive(*first, 6.0)
    robot.drive(*second, seconds, sample_s=SAMPLE_S)
    return robot.trace


def old_way(trace: Trace, side: str) -> tuple[float, float]:
    """Seconds and metres for which a wheel still rolls forwards."""
    speed_m_s = trace[f"{side}_ticks_s"] * METRES_PER_TICK
    rolled_m = trace[f"{side}_rolled_ticks"] * METRES_PER_TICK
    last = int(np.flatnonzero(speed_m_s > STANDS_M_S)[-1])
    return (last + 1) * SAMPLE_S, float(rolled_m[last] - rolled_m[0])


def reached_s(trace: Trace, side: str, wanted_m_s: float) -> float:
    """Time after which a wheel is within 5 % and two ticks a second of a lower speed."""
    speed_m_s = trace[f"{side}_ticks_s"] * METRES_PER_TICK
    reached = np.flatnonzero(speed_m_s <= 1.05 * wanted_m_s + STANDS_M_S)
    return float(reached[0]) * SAMPLE_S if len(reached) else np.inf


@cache
def after_zero(seed: int | None) -> dict[str, tuple[float, float]]:
    """Result of a zero at 0.3 m/s in the default world, or in a drawn one."""
    world = WorldParameters() if seed is None else draw(seed).world
    trace = change(world, (0.3, 0.0), (0.0, 0.0))
    return {side: old_way(trace, side) for side in SIDES}


@pytest.mark.parametrize("wanted_m_s", [-0.3, -0.05])
def test_reversal_in_the_default_world_rolls_on_for_a_tenth_of_a_second_and_a_centimetre(wanted_m_s: float) -> None:
    seconds, metres = old_way(change(WorldParameters(), (0.3, 0.0), (wanted_m_s, 0.0)), "left")
    assert seconds < 0.11
    assert metres < 0.011


@pytest.mark.parametrize("wanted_m_s", [-0.3, pytest.param(-0.05, marks=pytest.mark.long)])
def test_reversal_in_drawn_worlds_rolls_on_no_farther_than_after_a_zero(wanted_m_s: float) -> None:
    for seed in SEEDS:
        trace = change(draw(seed).world, (0.3, 0.0), (wanted_m_s, 0.0))
        for side in SIDES:
            seconds, metres = old_way(trace, side)
            zero_s, zero_m = after_zero(seed)[side]
            assert seconds <= zero_s + 2 * SAMPLE_S, seed
            assert metres <= zero_m + ONE_EDGE_M, seed


def test_turn_that_reverses_one_wheel_stops_that_one_at_once_and_not_the_other() -> None:
    """From straight ahead to a turn to the left: 0.3 and 0.3 m/s become -0.06 and 0.2."""
    trace = change(WorldParameters(), (0.3, 0.0), (0.07, 1.3))
    seconds, metres = old_way(trace, "left")
    assert (seconds, metres) <= (after_zero(None)["left"][0] + 2 * SAMPLE_S, after_zero(None)["left"][1] + ONE_EDGE_M)
    assert np.min(trace["right_ticks_s"]) * METRES_PER_TICK > 0.1


@pytest.mark.parametrize("slower_m_s", [0.05, 0.08, 0.1, 0.15, 0.2])
def test_slower_command_in_the_default_world_is_reached_in_a_fifth_of_the_paper_s_time(slower_m_s: float) -> None:
    """Time of the wheel itself, including command and loop: the set-point alone needs a twentieth."""
    paper_s = (0.3 - slower_m_s) / METRES_PER_TICK * S_PER_TICK_S
    assert reached_s(change(WorldParameters(), (0.3, 0.0), (slower_m_s, 0.0)), "left", slower_m_s) <= paper_s / 5.0


@pytest.mark.parametrize(
    ("first_m_s", "slower_m_s"),
    [(0.3, 0.1), *(pytest.param(*each, marks=pytest.mark.long) for each in ((0.3, 0.05), (0.3, 0.2), (0.2, 0.1)))],
)
def test_slower_command_in_nine_of_ten_drawn_worlds_is_reached_in_a_third_of_the_paper_s_time(
    first_m_s: float, slower_m_s: float
) -> None:
    """Half of them need a fifth; the others have motors that coast for long and brake slowly."""
    paper_s = (first_m_s - slower_m_s) / METRES_PER_TICK * S_PER_TICK_S
    found = [
        reached_s(trace, side, slower_m_s)
        for trace in (change(draw(seed).world, (first_m_s, 0.0), (slower_m_s, 0.0)) for seed in SEEDS)
        for side in SIDES
    ]
    assert np.median(found) <= paper_s / 5.0
    assert np.quantile(found, 0.9) <= paper_s / 3.0


@pytest.mark.parametrize(
    "slower_m_s", [0.1, *(pytest.param(each, marks=pytest.mark.long) for each in (0.25, 0.2, 0.15))]
)
def test_slower_command_in_drawn_worlds_makes_no_wheel_swing(slower_m_s: float) -> None:
    for seed in range(100):
        script = Script(draw(seed).world, ((0.3, 0.0, 6000), (slower_m_s, 0.0, 5000)))
        rows = run_module(script.text, script.rows)[-200:]
        for side in SIDES:
            error_ticks_s = np.abs(column(rows, f"{side}_ticks_s")) - np.abs(column(rows, f"{side}_set_ticks_s"))
            assert np.sqrt(np.mean(error_ticks_s**2)) < 0.125 * abs(column(rows, f"{side}_set_ticks_s")[-1]), seed


@pytest.mark.parametrize(
    "seeds", [pytest.param(range(100), id="some"), pytest.param(range(100, 300), marks=pytest.mark.long, id="more")]
)
def test_stick_pulled_through_zero_in_drawn_worlds_never_drives_a_wheel_the_old_way(seeds: range) -> None:
    """From the row after each command on: the first pass after a command obeys it."""
    for seed in seeds:
        script = draw_reversals(seed)
        rows = run_module(script.text, script.rows)[CONNECT_MS // ROW_MS :]
        commanded = script.commanded[CONNECT_MS // ROW_MS :]
        for at, side in enumerate(SIDES):
            is_obeyed = np.sign(commanded[1:, at]) == np.sign(commanded[:-1, at])
            for name in ("pwm", "set_ticks_s"):
                against = column(rows, f"{side}_{name}")[1:] * commanded[1:, at] < 0.0
                assert not np.any(against & is_obeyed), f"seed {seed}: {side} {name}"


def test_command_that_trembles_around_zero_neither_drives_the_robot_away_nor_is_a_fault() -> None:
    """A stick that does not rest in its middle, for ten seconds; the lowest PWM alone gives more than 2 mm/s."""
    for seed in SEEDS:
        robot = FirmwareWorld(draw(seed).world)
        robot.connect()
        for number in range(round(10.0 / COMMAND_S)):
            robot.command(0.002 * (-1) ** number, 0.0)
            robot.run(COMMAND_S / 2.0)
            robot.command(-0.002 * (-1) ** number, 0.0)
            robot.run(COMMAND_S / 2.0)
        assert not any(robot.world.row[f"{side}_fault"] for side in SIDES), seed
        assert abs(robot.world.x_m) < 0.05
