"""The demo's robot goes to a new speed at once; the paper's takes its time."""

import pytest

from hostlink.messages.catalog import Catalog
from hostlink.sim.controller import LOOP_S, NIMBLE, PAPER, RobotKind, Temper
from hostlink.sim.robot import SimulatedRobot

CATALOG = Catalog()
RUN_S = 4.0
TICKS_PER_M = 230.4 / (2 * 3.14159265 * 0.045)


def speeds(temper: Temper, wanted_m_s: float, *, from_m_s: float = 0.0) -> list[float]:
    """The true speed in each turn after the command of a new one, of a robot that had the other for a while."""
    robot = SimulatedRobot("robot_0", CATALOG, temper=temper)
    measured = []
    for target_m_s in (from_m_s, wanted_m_s):
        measured = []
        for _ in range(round(RUN_S / LOOP_S)):
            for control in robot.controllers:
                control.aim(target_m_s * TICKS_PER_M)
            edges = robot._pass_time()
            for control, count in zip(robot.controllers, edges, strict=True):
                control.step(count, LOOP_S)
                assert control.watch.fault is None
            measured.append(robot.speed_m_s)
    return measured


def rise_s(measured: list[float], begin_m_s: float, end_m_s: float) -> float:
    """Until nine tenths of the way."""
    way_m_s = abs(end_m_s - begin_m_s)
    return next(LOOP_S * at for at, speed in enumerate(measured) if abs(speed - begin_m_s) >= 0.9 * way_m_s)


@pytest.mark.parametrize(("begin_m_s", "end_m_s", "most_s"), [(0.0, 0.15, 0.36), (0.1, 0.2, 0.36), (0.15, -0.15, 0.75)])
def test_the_nimble_robot_is_at_a_new_speed_soon_and_reverses_after_a_standstill(
    begin_m_s: float, end_m_s: float, most_s: float
) -> None:
    measured = speeds(NIMBLE, end_m_s, from_m_s=begin_m_s)
    assert rise_s(measured, begin_m_s, end_m_s) < most_s
    assert max(abs(speed) for speed in measured) < 1.05 * max(abs(begin_m_s), abs(end_m_s))
    assert all(speed == pytest.approx(end_m_s, rel=0.03) for speed in measured[-60:])


def test_the_papers_robot_takes_its_time() -> None:
    assert rise_s(speeds(PAPER, 0.15), 0.0, 0.15) > 1.5


def test_a_kind_has_the_temper_of_its_name() -> None:
    assert (RobotKind("nimble").temper, RobotKind("paper").temper) == (NIMBLE, PAPER)
