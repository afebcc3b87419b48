"""A robot that is driven through a step by a program, and what may come between. In virtual time."""

import asyncio
import json
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from hostlink.cli.demo import DemoDriver
from hostlink.cli.robots import free_robot, require_robot
from hostlink.cli.step import (
    FIRST_MESSAGE_S,
    PAPER_GAINS,
    SILENCE_S,
    STANDING_TIMEOUT_S,
    TICK_S,
    Stage,
    StepRecorder,
    StepRecording,
    Wheel,
    find_source,
    make_stage,
    separation_of,
    tune_motors,
    wheel_parameter,
)
from hostlink.client import PRIORITY, Host
from hostlink.core.config import Config, ParameterValue, RobotConfig
from hostlink.core.protocol.endpoint import EndpointKind
from hostlink.core.robot.velocity import PlanarVelocity
from hostlink.errors import CommandRefused, DeviceGone, HostlinkError
from hostlink.workbench.motor_model import PidGains, identify_motor, simc_gains
from hostlink.workbench.step_response import Record, step_figures
from tests.support.background import meanwhile
from tests.support.bench import Bench, bench, refused, with_robot
from tests.support.fake_device import robot_topics, topic
from tests.support.gates import drive_gate
from tests.support.memory_hub import velocities
from tests.support.participants import ODOMETRY_ID, POSE
from tests.support.scripted_device import ScriptedDevice
from tests.support.simulated import DisturbedRobot, simulated_in_memory
from tests.support.virtual_loop import virtual
from tests.support.waiting import expect

SLOW = make_stage(0.04, 1.5, None, 0.21)  # 33 ticks/s: a set-point that is there after 0.6 s
LONG = replace(SLOW, seconds=30.0)
PLOT = topic(EndpointKind.PUBLISHER, 126, "/robot_0/plot_data", "geometry_msgs/Twist")
PAUSE_S = 0.1  # in which the daemon answers, and a zero is sent


def stepping(here: Bench) -> asyncio.Task[str]:
    """Begin a long step that is to be refused."""
    return here.tasks.create_task(refused(record(here.me, [LONG])))


async def is_driven(here: Bench) -> None:
    """Wait until the step has begun."""
    await expect(lambda: here.robot.gate.current.x_m_s > 0.03)


async def record(me: Host, stages: Sequence[Stage] = (SLOW,), wheel: Wheel | None = None) -> StepRecording:
    robot = await require_robot(me, "robot_0")
    source = await find_source(me, await free_robot(me, "robot_0", below=PRIORITY), wheel, 0.21)
    return await StepRecorder(me, robot, source, show=lambda _: None).record(stages)


async def stands(robot: DisturbedRobot) -> None:
    await expect(lambda: robot.speed_m_s == 0 and all(wheel.speed_m_s == 0 for wheel in robot.world.wheels))


# -- a step -----------------------------------------------------------------------------------------------------------


@virtual
async def test_a_step_is_recorded_from_a_standstill_and_ends_in_one() -> None:
    async with with_robot() as (here, robot):
        recording = await record(here.me)
        assert here.robot.gate.owner_name is None
        await stands(robot)
    assert recording.source == "/robot_0/plot_data"
    assert recording.accepted == (0.04, 0.0)
    assert set(recording.records) == {"left", "right"}
    for each in recording.records.values():
        assert each.t_s[0] <= -0.3
        assert each.t_s[-1] == pytest.approx(1.5, abs=0.2)
        assert np.abs(each.measured[each.t_s < 0]).max() < 1.5
        assert each.target == pytest.approx(0.04 / 1.2272e-3, rel=0.001)
        assert each.pwm is not None
        assert step_figures(each).steady_error_percent > -30


@virtual
async def test_one_wheel_alone_is_driven_and_recorded() -> None:
    async with with_robot() as (here, robot):
        recording = await record(here.me, [make_stage(-0.04, 1.5, Wheel.RIGHT, 0.21)], Wheel.RIGHT)
        rolled_m = [wheel.rolled_rad * 0.045 for wheel in robot.world.wheels]
    assert set(recording.records) == {"right"}
    assert recording.records["right"].target < -30
    assert rolled_m[0] == pytest.approx(0.0, abs=0.0005)
    assert rolled_m[1] < -0.015


@virtual
async def test_driver_of_lower_priority_is_stopped_before_the_step_and_limits_are_noticed() -> None:
    async with with_robot(Config(robots={"robot_0": RobotConfig(max_linear_m_s=0.03)})) as (here, _):
        await here.other.robot("robot_0", priority=0).drive(0.1, 0.0)
        assert here.robot.gate.owner_name is not None
        recording = await record(here.me)
    left = recording.records["left"]
    assert np.abs(left.measured[left.t_s < 0]).max() < 1.5
    assert recording.accepted == (0.03, 0.0)


@virtual
async def test_driver_of_lower_priority_that_begins_meanwhile_does_not_disturb_the_step() -> None:
    """The demo is such a driver: it drives whenever the robot was idle for a while."""
    async with with_robot() as (here, _):
        idle = here.hub.join("demo", priority=0)
        step = here.tasks.create_task(record(here.me))
        await expect(lambda: here.robot.gate.counts.stops > 0)
        demo = here.tasks.create_task(DemoDriver(here.hub, idle, lambda _: True).run())
        recording = await step
        demo.cancel()
        idle.leave()
    assert recording.records["left"].target > 30


@virtual
async def test_a_cancelled_step_stops_the_robot_at_once() -> None:
    async with with_robot() as (here, robot):
        drive = here.tasks.create_task(record(here.me, [LONG]))
        await is_driven(here)
        drive.cancel()
        await asyncio.sleep(PAUSE_S)
        assert here.robot.gate.current.is_zero
        await stands(robot)


# -- interruptions ----------------------------------------------------------------------------------------------------


@virtual
async def test_a_person_who_takes_over_ends_the_step_and_keeps_the_robot() -> None:
    async with with_robot() as (here, _):
        step = stepping(here)
        await is_driven(here)
        stops = here.robot.gate.counts.stops
        drive_gate(here.robot, PlanarVelocity(x_m_s=0.1), owner="a person", priority=60)
        assert "a person drives it" in await step
        assert here.robot.gate.counts.stops == stops
        assert here.robot.gate.owner_name == "a person"


@virtual
async def test_a_program_that_begins_while_the_step_waits_keeps_the_robot() -> None:
    async with with_robot() as (here, _):
        step = here.tasks.create_task(refused(record(here.me)))
        await expect(lambda: here.robot.gate.counts.stops > 0)
        await here.other.robot("robot_0").drive(0.1, 0.0)
        assert "; end that program first" in await step
        assert here.robot.gate.counts.stops == 1
        assert here.robot.gate.owner_name is not None


@virtual
async def test_an_emergency_stop_ends_the_step() -> None:
    async with with_robot() as (here, robot):
        step = stepping(here)
        await is_driven(here)
        await here.other.robot("robot_0").lock("a cat")
        assert "a cat" in await step
        await stands(robot)
        assert "locked: a cat" in await refused(record(here.me))


@virtual
async def test_a_robot_that_leaves_ends_the_step() -> None:
    async with bench() as here:
        async with simulated_in_memory(here.hub):
            await expect(lambda: here.robot.link is not None)
            step = stepping(here)
            await is_driven(here)
        assert "robot_0" in await step
        with pytest.raises(DeviceGone):
            await free_robot(here.me, "robot_0", below=PRIORITY)


@virtual
async def test_plot_data_that_falls_silent_ends_the_step_within_a_second() -> None:
    async with with_robot() as (here, robot):
        step = stepping(here)
        await is_driven(here)
        robot.is_plot_silent = True
        await asyncio.sleep(SILENCE_S + 2 * TICK_S + PAUSE_S)
        assert here.robot.gate.current.is_zero
        assert await step == "/robot_0/plot_data had no message for 0.9 s; the robot was sent a stop"
        await stands(robot)


@virtual
async def test_robot_that_is_driven_locked_or_unknown_is_refused() -> None:
    async with bench() as here:
        await here.device(robot_topics())
        with pytest.raises(HostlinkError, match="no robot named robot_7; similar names: robot_0; `hostlink robots`"):
            await require_robot(here.me, "robot_7")
        await here.other.robot("robot_0").drive(0.1, 0.0)
        with pytest.raises(HostlinkError, match="; end that program first"):
            await free_robot(here.me, "robot_0", below=PRIORITY)
        await here.other.robot("robot_0").lock("a cat", wait_s=0)
        with pytest.raises(CommandRefused, match="a cat"):
            await free_robot(here.me, "robot_0", below=PRIORITY)


# -- robots of another make -------------------------------------------------------------------------------------------


async def roll(device: ScriptedDevice) -> None:
    """Ten poses a second, as commanded a tenth of a second ago."""
    x_m = 0.0
    while True:
        await asyncio.sleep(0.1)
        x_m += velocities(device)[-1][0] * 0.1
        await device.send(ODOMETRY_ID, POSE.pack(x_m, 0.0, 0.0))


@virtual
async def test_a_robot_without_plot_data_is_measured_by_its_odometry() -> None:
    async with bench() as here, meanwhile(roll(await here.device(robot_topics()))):
        recording = await record(here.me, [make_stage(0.2, 2.0, None, 0.21)])
    assert recording.source == "/robot_0/odom"
    robot = recording.records["robot"]
    assert (robot.unit, robot.target, robot.pwm) == ("m/s", 0.2, None)
    assert step_figures(robot).steady_error_percent == pytest.approx(0.0, abs=3.0)
    with pytest.raises(HostlinkError, match="sends no PWM"):
        identify_motor(robot)


@virtual
async def test_a_robot_that_sends_nothing_is_not_driven() -> None:
    async with bench() as here:
        device = await here.device([*robot_topics(), PLOT])
        reason = f"/robot_0/plot_data had no message in {FIRST_MESSAGE_S:g} s"
        assert reason in await refused(record(here.me))
        await asyncio.sleep(1.0)
        assert set(velocities(device)) == {(0.0, 0.0)}


async def run_away(device: ScriptedDevice) -> None:
    while True:
        await device.send(PLOT.id, np.array([50.0, 0, 0, 0, 0, 0]).tobytes())
        await asyncio.sleep(0.1)


@virtual
async def test_a_robot_that_does_not_come_to_rest_is_not_driven() -> None:
    async with bench() as here:
        device = await here.device([*robot_topics(), PLOT])
        async with meanwhile(run_away(device)):
            reason = f"still moves {STANDING_TIMEOUT_S:g} s after the stop"
            assert reason in await refused(record(here.me))
        assert set(velocities(device)) == {(0.0, 0.0)}


# -- parameters and gains ---------------------------------------------------------------------------------------------


def motor_record() -> Record:
    """Return the record of a motor with K 0.07, T 0.4 s and no dead time, along a ramp."""
    t_s = np.arange(80) / 10
    pwm = 900 + 1500 * np.clip((t_s - 1) / 3, 0, 1)
    measured = np.zeros(80)
    for at in range(1, 80):
        measured[at] = measured[at - 1] * np.exp(-0.25) + 0.07 * pwm[at - 1] * (1 - np.exp(-0.25))
    return Record("ticks/s", t_s, measured, measured, pwm)


@pytest.mark.slow
@virtual
async def test_gains_are_sent_only_when_requested() -> None:
    records = {"left": motor_record(), "right": motor_record()}
    async with with_robot() as (here, robot):
        before = robot.controls
        tuning = await tune_motors(here.me, "robot_0", records, sends=False)
        await asyncio.sleep(PAUSE_S)
        assert robot.controls == before
        assert not tuning.is_sent
        await tune_motors(here.me, "robot_0", records, sends=True)
        expected = simc_gains(identify_motor(motor_record()))
        await expect(lambda: robot.controls[0].kp == pytest.approx(expected.kp))
        await expect(lambda: robot.controls[1].ki == pytest.approx(expected.ki))
    assert tuning.wheels["left"].present == PAPER_GAINS["left"]
    text = "\n".join(tuning.lines())
    assert "not sent; --send sends them" in text
    assert f'"/robot_0/gains_left" = [{expected.kp:.1f}, {expected.ki:.1f}, 0.0]' in text
    assert json.loads(json.dumps(tuning.view(records)))["wheels"]["right"]["samples"]["unit"] == "ticks/s"


@virtual
async def test_a_robot_that_accepts_no_gains_is_named() -> None:
    async with bench() as here:
        await here.device([*robot_topics(), PLOT])
        with pytest.raises(
            HostlinkError, match="robot_0 accepts no gains, because it does not subscribe to pid_tune_l"
        ):
            await tune_motors(here.me, "robot_0", {"left": motor_record()}, sends=True)


@virtual
async def test_present_gains_are_those_of_the_configuration() -> None:
    config = Config(parameters={"/robot_0/gains_left": [30.0, 50.0, 0.2], "/robot_0/x": "a name"})
    async with bench(config) as here:
        assert await wheel_parameter(here.me, "robot_0", "x") == []
        tuning = await tune_motors(here.me, "robot_0", {"left": motor_record()}, sends=False)
    assert tuning.wheels["left"].present == PidGains(30.0, 50.0, 0.2)
    assert any("of the configuration" in line for line in tuning.lines())


@pytest.mark.parametrize(
    ("parameter", "setting_m", "track_m"),
    [(0.3, None, 0.3), (0.3, 0.33, 0.3), (None, 0.33, 0.33), (None, None, 0.21), (210, None, 0.21)],
)
@virtual
async def test_track_width_is_a_valid_parameter_else_the_setting_else_the_papers(
    parameter: ParameterValue | None, setting_m: float | None, track_m: float
) -> None:
    parameters = {} if parameter is None else {"/robot_0/wheel_separation": parameter}
    robots = {"robot_0": RobotConfig(wheel_separation_m=setting_m)}
    async with bench(Config(robots=robots, parameters=parameters)) as here:
        await here.device(robot_topics())
        assert await separation_of(here.me, "robot_0") == track_m
