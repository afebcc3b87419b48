"""The firmware in virtual time, from Python: repeatable, independent of each other, and true to its parameters."""

import gc
import math
import re
import struct
from pathlib import Path

import numpy as np
import pytest

from hostlink.workbench.sim.firmware_module import WorldParameters, columns
from hostlink.workbench.sim.firmware_world import Feedback, FirmwareWorld, Retry

SLIPPERY = WorldParameters(
    {
        "seed": 3,
        "caster_twist_rad": 0.055,
        "caster_random": 0.4,
        "left.slip_noise_m": 0.003,
        "right.slip_noise_m": 0.003,
    }
)
SQUARE = ((0.25, 0.0, 4.0), (0.0, 0.0, 0.5), (0.0, 0.6, 2.6), (0.0, 0.0, 0.5)) * 2


def connected(parameters: WorldParameters | None = None, name: str = "robot_0") -> FirmwareWorld:
    made = FirmwareWorld(parameters, name=name)
    made.connect()
    return made


def unseen_rad(made: FirmwareWorld) -> float:
    """Angle by which the robot turned unnoticed by its odometry."""
    return math.remainder(made.world.pose.theta_rad - made.world.odometry.theta_rad, math.tau)


def drive(made: FirmwareWorld, sample_s: float = 0.0) -> FirmwareWorld:
    for linear, angular, seconds in SQUARE:
        made.drive(linear, angular, seconds, sample_s=sample_s)
    return made


def test_firmware_world_connects_and_drives_as_commanded() -> None:
    made = connected()
    assert set(made.topics) >= {"odometry", "plot_data", "velocity_commands", "reset_odometry"}
    assert "robot is ready" in [log.text for log in made.logs]
    made.drive(0.2, 0.0, 10.0)
    made.drive(0.0, 0.0, 1.0)
    assert made.world.pose.x_m > 1.5
    assert made.world.odometry.x_m == pytest.approx(made.world.pose.x_m, rel=0.002)
    assert made.world.row["left_ticks_s"] == 0.0


def test_the_same_seed_repeats_and_another_does_not() -> None:
    first, again = drive(connected(SLIPPERY)), drive(connected(SLIPPERY))
    other = drive(connected(SLIPPERY.changed({"seed": 4})))
    assert first.world.row == again.world.row
    assert math.hypot(first.world.pose.x_m - other.world.pose.x_m, first.world.pose.y_m - other.world.pose.y_m) > 0.001
    assert first.world.odometry != first.world.pose


def test_samples_do_not_change_what_happens() -> None:
    plain, sampled = drive(connected(SLIPPERY)), drive(connected(SLIPPERY), sample_s=0.03)
    assert plain.world.row == sampled.world.row
    assert np.allclose(np.diff(sampled.trace["t_s"]), 0.03)
    assert sampled.trace.rows.shape[1] == len(columns())
    sampled.forget()
    assert len(sampled.trace) == len(sampled.frames) == 0


def test_two_robots_do_not_know_of_each_other() -> None:
    alone = drive(connected(SLIPPERY))
    left, right = connected(SLIPPERY), connected(WorldParameters(), name="robot_1")
    for linear, angular, seconds in SQUARE:
        left.drive(linear, angular, seconds)
        right.drive(-linear, angular, seconds)
    assert left.world.row == alone.world.row
    assert right.world.pose.x_m < -0.5


def test_the_host_s_parameters_reach_the_firmware() -> None:
    made = FirmwareWorld(device_parameters={"wheel_radius": (0.09,)})
    made.connect()
    made.drive(0.2, 0.0, 5.0)
    made.drive(0.0, 0.0, 1.0)
    assert made.world.odometry.x_m == pytest.approx(2 * made.world.pose.x_m, rel=0.01)


@pytest.mark.parametrize(("feedback", "share"), [(Feedback.WASHED_OUT, 1.0), (Feedback.PAPER, 0.952)])
def test_the_paper_s_feedback_makes_every_speed_low(feedback: Feedback, share: float) -> None:
    made = FirmwareWorld(feedback=feedback)
    made.connect()
    made.drive(0.2, 0.0, 8.0)
    made.drive(0.2, 0.0, 5.0, sample_s=0.01)
    wanted = made.world.row["left_set_ticks_s"]
    assert float(np.mean(made.trace["left_ticks_s"])) == pytest.approx(share * wanted, rel=0.005)


def test_the_firmware_publishes_the_world_s_battery() -> None:
    made = connected(WorldParameters({"battery_v": 11.25}))
    made.run(3.0)
    battery = [frame.payload for frame in made.frames if frame.topic_id == made.topics["battery"]]
    header_bytes = 12 + struct.unpack_from("<I", battery[-1], 12)[0] + 4
    assert struct.unpack_from("<f", battery[-1], header_bytes)[0] == 11.25


def test_without_commands_it_stands_within_0_6_s() -> None:
    made = connected()
    made.drive(0.3, 0.0, 5.0)
    made.run(0.6)
    assert made.world.row["left_ticks_s"] == pytest.approx(0.0, abs=2.0)
    assert made.world.row["left_pwm"] == made.world.row["right_pwm"] == 0.0


@pytest.mark.parametrize("retry", [Retry.PAPER, Retry.KEEP_STATE])
def test_at_the_paper_s_baud_rate_nothing_is_lost(retry: Retry) -> None:
    made = FirmwareWorld(baud=38400, retry=retry)
    made.connect()
    made.drive(0.2, 0.3, 20.0)
    assert made.firmware.lost_bytes == 0
    assert made.world.pose.theta_rad > 3.0


@pytest.mark.parametrize(("turn", "onwards"), [(0.8, 0.2), (-0.8, 0.2), (0.8, -0.2), (-0.8, -0.2)])
def test_caster_that_returns_from_a_turn_turns_the_robot_further(turn: float, onwards: float) -> None:
    """The paper's overturning, which its odometry does not count; the way that it drives on does not matter."""
    made = connected(WorldParameters({"caster_twist_rad": 0.055}))
    for linear, angular, seconds in ((0.2, 0.0, 4.0), (0.0, 0.0, 0.7), (0.0, turn, 4.0), (0.0, 0.0, 0.7)):
        made.drive(linear, angular, seconds)
    assert unseen_rad(made) == pytest.approx(0.0, abs=0.005)
    made.drive(onwards, 0.0, 6.0)
    assert unseen_rad(made) == pytest.approx(math.copysign(0.055, turn), abs=0.008)


def test_a_straight_reversal_leaves_only_the_caster_s_random_share() -> None:
    found = {}
    for random in (0.0, 0.4):
        turned = []
        for seed in range(8):
            made = connected(WorldParameters({"seed": seed, "caster_twist_rad": 0.055, "caster_random": random}))
            made.drive(0.2, 0.0, 4.0)
            made.drive(0.0, 0.0, 1.0)
            before_rad = unseen_rad(made)
            made.drive(-0.2, 0.0, 4.0)
            turned.append(unseen_rad(made) - before_rad)
        found[random] = float(np.std(turned))
    assert found[0.0] < 0.006  # it starts with one wheel before the other
    assert 0.01 < found[0.4] < 0.06  # 0.055 times the difference of two numbers of 0.4: 0.031


def test_a_hand_at_the_wheels_and_at_the_robot() -> None:
    made = connected()
    made.world.left.grip(100.0)
    made.run(1.0)
    assert made.world.left.rolled_ticks == pytest.approx(100.0, rel=0.01)
    assert made.world.left.edges == pytest.approx(200, abs=1)
    made.world.left.release()
    made.run(1.0)
    before = made.world.pose
    made.world.shove(0.1, 0.0, 0.5)
    assert made.world.pose.theta_rad == pytest.approx(before.theta_rad + 0.5)
    assert math.hypot(made.world.pose.x_m - before.x_m, made.world.pose.y_m - before.y_m) == pytest.approx(0.1)


def test_world_is_valid_as_long_as_it_is_referenced() -> None:
    world = connected(WorldParameters({"battery_v": 11.0})).world
    gc.collect()
    assert world.now("battery_v") == 11.0


def test_the_example_of_the_document_runs(capsys: pytest.CaptureFixture[str]) -> None:
    text = (Path(__file__).parents[4] / "docs" / "simulated-world.md").read_text()
    (example,) = re.findall(r"^```python\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    exec(compile(example, "docs/simulated-world.md", "exec"), {})  # noqa: S102 - of our own document
    assert capsys.readouterr().out.count("Pose(") == 2
