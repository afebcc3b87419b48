"""World of the firmware: its numbers stay finite for any parameters and steps."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.workbench.sim.firmware_module import WorldParameters, bounds
from hostlink.workbench.sim.firmware_world import Firmware, World

LEFT = 0
WHOLE = {"seed", "pwm_bits"}
pwms = st.one_of(st.just(0), st.integers(-4095, 4095))
pieces = st.tuples(pwms, pwms, st.sampled_from([0.001, 0.002, 0.01, 1 / 30]), st.integers(1, 10))


def world_of(numbers: dict[str, float] | None = None) -> World:
    """One whose motors the test drives."""
    return Firmware(WorldParameters(numbers)).world


@st.composite
def extremes(draw: st.DrawFn) -> dict[str, float]:
    """Any number of its range, its ends most of all."""
    chosen = draw(st.lists(st.sampled_from(list(bounds())), unique=True, max_size=8))
    ends = {name: bounds()[name][1:] for name in chosen}
    drawn = {name: draw(st.one_of(st.sampled_from(pair), st.floats(*pair))) for name, pair in ends.items()}
    return {name: float(int(value)) if name in WHOLE else value for name, value in drawn.items()}


@given(drawn=extremes(), later=extremes(), story=st.lists(pieces, min_size=1, max_size=4))
def test_numbers_of_any_world_stay_numbers(
    drawn: dict[str, float], later: dict[str, float], story: list[tuple[int, int, float, int]]
) -> None:
    world = world_of(drawn)
    for left, right, step_s, steps in story:
        world.turn_motors(left, right, step_s, steps)
        assert all(map(math.isfinite, world.row.values()))
    world.change(WorldParameters(later))
    world.turn_motors(4095, -4095, 0.01, 3)
    assert all(map(math.isfinite, world.row.values()))


def test_minute_in_coarse_steps_is_a_minute_in_fine_ones() -> None:
    """Within 1 mm and 1 mrad."""
    fine, coarse = world_of(), world_of()
    for piece in range(12):
        for world, steps in ((fine, 5000), (coarse, 150)):
            world.turn_motors(2000 + 150 * piece, 3800 - 120 * piece, 5.0 / steps, steps)
    assert math.hypot(fine.x_m - coarse.x_m, fine.y_m - coarse.y_m) <= 0.001
    assert fine.theta_rad == pytest.approx(coarse.theta_rad, abs=0.001)
    assert fine.rolled_m > 8.0


@pytest.mark.parametrize("ticks_s", [-5e-324, -5e-244, -1e-30, -1e-18, 1e-18, 5e-324])
def test_wheel_that_creeps_less_than_a_digit_passes_an_edge_once(ticks_s: float) -> None:
    world = world_of()
    world.left.grip(ticks_s)
    world.turn_motors(0, 0, 0.001, 1000)
    assert world.left.edges <= 1


def test_pwm_below_the_dead_zone_turns_no_wheel() -> None:
    world = world_of({"left.dead_zone_pwm": 350.0})
    world.turn_motors(300, 400, 0.01, 100)
    assert world.left.edges == 0
    assert world.right.edges > 0


def test_deaf_encoder_counts_nothing_while_its_wheel_rolls() -> None:
    world = world_of()
    world.instance.call("deafen", LEFT, 1)
    world.turn_motors(2000, 2000, 0.01, 100)
    assert (world.left.edges, world.left.rolled_ticks > 50) == (0, True)
    world.instance.call("deafen", LEFT, 0)
    world.turn_motors(2000, 2000, 0.01, 100)
    assert world.left.edges > 50
