"""The paper's software, rebuilt: each mistake does what the paper's robot did, and can be mended."""

import pytest

from hostlink.workbench.lab.experiment import PAPER_WORLD
from hostlink.workbench.lab.robots import LEFT_GAINS, LOOP_S, Mistakes, PaperRobot, PaperWheel, names

METRES_PER_TICK = 0.0012272


def steady_speed_ticks_s(mistakes: Mistakes) -> float:
    robot = PaperRobot(PAPER_WORLD, mistakes)
    robot.command(200 * METRES_PER_TICK, 0.0)
    robot.advance(15.0)
    before_m = robot.world.rolled_m
    robot.advance(5.0)
    return (robot.world.rolled_m - before_m) / 5.0 / METRES_PER_TICK


def seconds_to_zero(mistakes: Mistakes) -> float:
    wheel = PaperWheel(LEFT_GAINS, mistakes)
    wheel.speed_ticks_s = 200.0
    wheel.aim(0.0, 0.0)
    now_s = 0.0
    while now_s < 10.0:
        now_s += LOOP_S
        wheel.step(0, 1, now_s)
        if wheel.set_point_ticks_s == 0.0:
            return now_s
    return now_s


def test_the_feedback_term_makes_every_speed_five_per_cent_low() -> None:
    assert steady_speed_ticks_s(Mistakes()) == pytest.approx(190.0, abs=2.0)
    assert steady_speed_ticks_s(Mistakes().changed("steady_feedback", is_made=False)) == pytest.approx(200.0, abs=1.0)


def test_a_stop_from_200_ticks_takes_3_6_seconds() -> None:
    assert seconds_to_zero(Mistakes()) == pytest.approx(3.6, abs=0.04)
    assert seconds_to_zero(Mistakes.none()) == pytest.approx(LOOP_S)


def test_the_direction_pin_gives_edges_the_wrong_sign_while_a_wheel_is_driven_back() -> None:
    wheel = PaperWheel(LEFT_GAINS, Mistakes(filtered_odometry=False))
    wheel.speed_ticks_s = 200.0
    wheel.aim(0.0, 0.0)
    for turn in range(1, 200):
        wheel.step(0 if wheel.pwm < 0 else 14, 1, turn * LOOP_S)
        if wheel.pwm < 0:
            break
    assert wheel.pwm < 0
    assert wheel.step(14, 1, 8.0) < 0.0


@pytest.mark.parametrize("name", names())
def test_each_mistake_is_made_or_mended_alone(name: str) -> None:
    assert getattr(Mistakes(), name)
    assert not getattr(Mistakes.none(), name)
    mended = Mistakes().changed(name, is_made=False)
    assert [each for each in names() if not getattr(mended, each)] == [name]
