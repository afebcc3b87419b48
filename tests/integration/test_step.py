"""A robot that is driven through a step by the daemon's API, and what may come between."""

import asyncio
import contextlib
import json
from collections.abc import AsyncIterator, Sequence
from dataclasses import replace

import numpy as np
import pytest

from hostlink.cli import step as step_command
from hostlink.cli.demo import DemoDriver
from hostlink.cli.robots import free_robot, require_robot
from hostlink.cli.step import (
    PAPER_GAINS,
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
from hostlink.client import PRIORITY, Host, connect
from hostlink.config import Config, ParameterValue, RobotConfig
from hostlink.errors import CommandRefused, DeviceGone, HostlinkError, RefusalKind, Refused
from hostlink.protocol.frame import Id, encode
from hostlink.robot.motor_model import PidGains, identify_motor, simc_gains
from hostlink.robot.step_response import Record, step_figures
from hostlink.robot.velocity import PlanarVelocity
from tests.support.daemon import Daemon, daemon
from tests.support.fake_device import FakeDevice, fake_device, pose, robot_topics, topic
from tests.support.gates import drive_gate
from tests.support.simulated import DisturbedRobot, simulated_robot
from tests.support.waiting import TIMEOUT_S, expect

SLOW = make_stage(0.04, 1.5, None, 0.21)  # 33 ticks/s: a set-point that is there after 0.6 s
PLOT = topic(Id.PUBLISHER, 126, "/robot_0/plot_data", "geometry_msgs/Twist")


@contextlib.asynccontextmanager
async def bench(config: Config | None = None) -> AsyncIterator[tuple[Daemon, DisturbedRobot, Host]]:
    """A daemon, a simulated robot that it knows, and a program."""
    async with daemon(config) as host, simulated_robot(host.tcp) as robot, connect(host.url, reconnect=False) as me:
        await expect(lambda: host.hub.robots.find("robot_0").link is not None)
        await expect(lambda: robot.is_configured)
        yield host, robot, me


async def record(me: Host, stages: Sequence[Stage] = (SLOW,), wheel: Wheel | None = None) -> StepRecording:
    robot = await require_robot(me, "robot_0")
    source = await find_source(me, await free_robot(me, "robot_0", below=PRIORITY), wheel, 0.21)
    async with asyncio.timeout(TIMEOUT_S):
        while True:
            try:
                return await StepRecorder(me, robot, source, show=lambda _: None).record(stages)
            except Refused as refused:  # the machine was too busy for the step, which the daemon noticed
                if refused.kind != RefusalKind.LATE:
                    raise


async def stands(robot: DisturbedRobot) -> None:
    await expect(lambda: robot.speed_m_s == 0 and all(wheel.speed_m_s == 0 for wheel in robot.world.wheels))


async def stepping(host: Daemon) -> None:
    """Until the step has begun."""
    await expect(lambda: host.hub.robots.find("robot_0").gate.current.x_m_s > 0.03)


# -- a step -----------------------------------------------------------------------------------------------------------


async def test_a_step_is_recorded_from_a_standstill_and_ends_in_one() -> None:
    async with bench() as (host, robot, me):
        recording = await record(me)
        assert host.hub.robots.find("robot_0").gate.owner_name is None
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


async def test_one_wheel_alone_is_driven_and_recorded() -> None:
    async with bench() as (_, robot, me):
        recording = await record(me, [make_stage(-0.04, 1.5, Wheel.RIGHT, 0.21)], Wheel.RIGHT)
        rolled_m = [wheel.rolled_rad * 0.045 for wheel in robot.world.wheels]
    assert set(recording.records) == {"right"}
    assert recording.records["right"].target < -30
    assert rolled_m[0] == pytest.approx(0.0, abs=0.0005)
    assert rolled_m[1] < -0.015


async def test_driver_of_lower_priority_is_stopped_before_the_step_and_limits_are_noticed() -> None:
    config = Config(robots={"robot_0": RobotConfig(max_linear_m_s=0.03)})
    async with bench(config) as (host, _, me), connect(host.url) as demo:
        await demo.robot("robot_0", priority=0).drive(0.1, 0.0)
        await expect(lambda: host.hub.robots.find("robot_0").gate.owner_name is not None)
        recording = await record(me)
    left = recording.records["left"]
    assert np.abs(left.measured[left.t_s < 0]).max() < 1.5
    assert recording.accepted == (0.03, 0.0)


async def test_driver_of_lower_priority_that_begins_meanwhile_does_not_disturb_the_step() -> None:
    """The demo is such a driver: it drives whenever the robot was idle for a while."""
    async with bench() as (host, _, me), asyncio.TaskGroup() as tasks:
        idle = host.hub.join("demo", priority=0)
        step = tasks.create_task(record(me))
        await expect(lambda: host.hub.robots.find("robot_0").gate.counts.stops > 0)
        demo = tasks.create_task(DemoDriver(host.hub, idle, lambda _: True).run())
        recording = await step
        demo.cancel()
        idle.leave()
    assert recording.records["left"].target > 30


async def test_a_cancelled_step_stops_the_robot_at_once() -> None:
    async with bench() as (host, robot, me):
        async with asyncio.TaskGroup() as tasks:
            drive = tasks.create_task(record(me, [replace(SLOW, seconds=30.0)]))
            await stepping(host)
            drive.cancel()
            await expect(lambda: host.hub.robots.find("robot_0").gate.current.is_zero, timeout_s=0.3)
        await stands(robot)


# -- interruptions ----------------------------------------------------------------------------------------------------


async def test_a_person_who_takes_over_ends_the_step_and_keeps_the_robot() -> None:
    async with bench() as (host, _, me), asyncio.TaskGroup() as tasks:
        drive = tasks.create_task(refused(record(me, [replace(SLOW, seconds=30.0)])))
        await stepping(host)
        robot = host.hub.robots.find("robot_0")
        stops = robot.gate.counts.stops
        drive_gate(robot, PlanarVelocity(x_m_s=0.1), owner="a person", priority=60)
        assert "a person drives it" in await drive
        assert robot.gate.counts.stops == stops
        assert robot.gate.owner_name == "a person"


async def test_a_program_that_begins_while_the_step_waits_keeps_the_robot() -> None:
    async with bench() as (host, _, me), connect(host.url) as other, asyncio.TaskGroup() as tasks:
        step = tasks.create_task(refused(record(me)))
        gate = host.hub.robots.find("robot_0").gate
        await expect(lambda: gate.counts.stops > 0)
        await other.robot("robot_0").drive(0.1, 0.0)
        assert "; end that program first" in await step
        assert gate.counts.stops == 1
        assert gate.owner_name is not None


async def test_an_emergency_stop_ends_the_step() -> None:
    async with bench() as (host, robot, me), asyncio.TaskGroup() as tasks:
        drive = tasks.create_task(refused(record(me, [replace(SLOW, seconds=30.0)])))
        await stepping(host)
        await me.robot("robot_0").lock("a cat")
        assert "a cat" in await drive
        await stands(robot)
        assert "locked: a cat" in await refused(record(me))


async def test_a_robot_that_leaves_ends_the_step() -> None:
    async with daemon() as host, connect(host.url, reconnect=False) as me, asyncio.TaskGroup() as tasks:
        async with simulated_robot(host.tcp):
            await expect(lambda: host.hub.robots.find("robot_0").link is not None)
            drive = tasks.create_task(refused(record(me, [replace(SLOW, seconds=30.0)])))
            await stepping(host)
        assert "robot_0" in await drive
        with pytest.raises(DeviceGone):
            await free_robot(me, "robot_0", below=PRIORITY)


async def test_driven_robot_is_refused() -> None:
    async with bench() as (host, _, me), connect(host.url) as other:
        await other.robot("robot_0").drive(0.1, 0.0)
        with pytest.raises(HostlinkError, match="; end that program first"):
            await free_robot(me, "robot_0", below=PRIORITY)


async def test_unknown_robot_is_refused_with_the_known_names() -> None:
    async with bench() as (_, _, me):
        with pytest.raises(
            HostlinkError, match="there is no robot named robot_7; similar names: robot_0; `hostlink robots`"
        ):
            await require_robot(me, "robot_7")


async def test_a_locked_robot_is_refused() -> None:
    async with bench() as (_, _, me):
        await me.robot("robot_0").lock("a cat")
        with pytest.raises(CommandRefused, match="a cat"):
            await free_robot(me, "robot_0", below=PRIORITY)


async def refused(recording: object) -> str:
    assert asyncio.iscoroutine(recording)
    with pytest.raises(HostlinkError) as caught:
        await recording
    return str(caught.value)


# -- robots of another make -------------------------------------------------------------------------------------------


async def test_a_robot_without_plot_data_is_measured_by_its_odometry() -> None:
    async with (
        daemon() as host,
        fake_device(host.tcp, robot_topics()) as device,
        connect(host.url) as me,
        asyncio.TaskGroup() as tasks,
    ):
        rolling = tasks.create_task(roll(device))
        recording = await record(me, [make_stage(0.2, 2.0, None, 0.21)])
        rolling.cancel()
    assert recording.source == "/robot_0/odom"
    robot = recording.records["robot"]
    assert (robot.unit, robot.target, robot.pwm) == ("m/s", 0.2, None)
    assert step_figures(robot).steady_error_percent == pytest.approx(0.0, abs=3.0)
    with pytest.raises(HostlinkError, match="sends no PWM"):
        identify_motor(robot)


async def roll(device: FakeDevice) -> None:
    """Ten poses a second, as commanded half a second ago."""
    x_m = speed_m_s = 0.0
    now_s = asyncio.get_running_loop().time
    next_s = now_s()
    while True:
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout_at(next_s := next_s + 0.1):
                while True:
                    speed_m_s = (await device.velocity())[0]
        x_m += speed_m_s * 0.1
        await device.send(pose(x_m))


async def test_a_robot_that_sends_nothing_is_not_driven(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(step_command, "FIRST_MESSAGE_S", 0.4)
    async with daemon() as host, fake_device(host.tcp, [*robot_topics(), PLOT]) as device, connect(host.url) as me:
        assert "/robot_0/plot_data had no message in 0.4 s" in await refused(record(me))
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.5):
                await device.velocity_other_than((0.0, 0.0))


async def test_a_robot_that_does_not_come_to_rest_is_not_driven(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(step_command, "STANDING_TIMEOUT_S", 1.5)
    async with (
        daemon() as host,
        fake_device(host.tcp, [*robot_topics(), PLOT]) as device,
        connect(host.url) as me,
        asyncio.TaskGroup() as tasks,
    ):
        rolling = tasks.create_task(run_away(device))
        assert "still moves 1.5 s after the stop" in await refused(record(me))
        rolling.cancel()


async def run_away(device: FakeDevice) -> None:
    twist = np.array([50.0, 0, 0, 0, 0, 0]).tobytes()
    while True:
        await device.send(encode(126, twist))
        await asyncio.sleep(0.1)


# -- parameters and gains ---------------------------------------------------------------------------------------------


def motor_record() -> Record:
    """Return the record of a motor with K 0.07, T 0.4 s and no dead time, along a ramp."""
    t_s = np.arange(80) / 10
    pwm = 900 + 1500 * np.clip((t_s - 1) / 3, 0, 1)
    measured = np.zeros(80)
    for at in range(1, 80):
        measured[at] = measured[at - 1] * np.exp(-0.25) + 0.07 * pwm[at - 1] * (1 - np.exp(-0.25))
    return Record("ticks/s", t_s, measured, measured, pwm)


async def test_gains_are_sent_only_when_requested() -> None:
    records = {"left": motor_record(), "right": motor_record()}
    async with bench() as (_, robot, me):
        before = robot.controls
        tuning = await tune_motors(me, "robot_0", records, sends=False)
        await me.settle()
        assert robot.controls == before
        assert not tuning.is_sent
        await tune_motors(me, "robot_0", records, sends=True)
        expected = simc_gains(identify_motor(motor_record()))
        await expect(lambda: robot.controls[0].kp == pytest.approx(expected.kp))
        await expect(lambda: robot.controls[1].ki == pytest.approx(expected.ki))
    assert tuning.wheels["left"].present == PAPER_GAINS["left"]
    text = "\n".join(tuning.lines())
    assert "not sent; --send sends them" in text
    assert f'"/robot_0/gains_left" = [{expected.kp:.1f}, {expected.ki:.1f}, 0.0]' in text
    assert json.loads(json.dumps(tuning.view(records)))["wheels"]["right"]["samples"]["unit"] == "ticks/s"


async def test_present_gains_and_the_track_are_those_of_the_configuration() -> None:
    config = Config(
        parameters={"/robot_0/gains_left": [30.0, 50.0, 0.2], "/robot_0/wheel_separation": 0.3, "/robot_0/x": "a name"}
    )
    async with bench(config) as (_, _, me):
        assert await separation_of(me, "robot_0") == 0.3
        assert await wheel_parameter(me, "robot_0", "x") == []
        tuning = await tune_motors(me, "robot_0", {"left": motor_record()}, sends=False)
    assert tuning.wheels["left"].present == PidGains(30.0, 50.0, 0.2)
    assert any("of the configuration" in line for line in tuning.lines())


async def test_track_width_without_a_parameter_is_the_robots_setting() -> None:
    robots = {"robot_0": RobotConfig(wheel_separation_m=0.33)}
    async with bench(Config(robots=robots)) as (_, _, me):
        assert await separation_of(me, "robot_0") == 0.33
    async with bench(Config(robots=robots, parameters={"/robot_0/wheel_separation": 0.3})) as (_, _, me):
        assert await separation_of(me, "robot_0") == 0.3


async def test_plot_data_that_falls_silent_ends_the_step_within_a_second() -> None:
    async with bench() as (host, robot, me), asyncio.TaskGroup() as tasks:
        drive = tasks.create_task(refused(record(me, [replace(SLOW, seconds=30.0)])))
        await stepping(host)
        robot.is_plot_silent = True
        await expect(lambda: host.hub.robots.find("robot_0").gate.current.is_zero, timeout_s=1.1)
        assert await drive == "/robot_0/plot_data had no message for 0.9 s; the robot was sent a stop"
        await stands(robot)


@pytest.mark.parametrize("parameters", [{}, {"/robot_0/wheel_separation": 210}])
async def test_invalid_track_width_is_replaced_by_the_papers(parameters: dict[str, ParameterValue]) -> None:
    async with bench(Config(parameters=parameters)) as (_, _, me):
        assert await separation_of(me, "robot_0") == 0.210


async def test_a_robot_that_accepts_no_gains_is_named() -> None:
    async with daemon() as host, fake_device(host.tcp, [*robot_topics(), PLOT]), connect(host.url) as me:
        with pytest.raises(
            HostlinkError, match="robot_0 accepts no gains, because it does not subscribe to pid_tune_l"
        ):
            await tune_motors(me, "robot_0", {"left": motor_record()}, sends=True)
