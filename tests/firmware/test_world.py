"""The world in C++ and its Python twin: the same names, the same numbers, the same digits after each step."""

import ctypes
import math
import os
import shutil
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from hostlink.messages.catalog import Catalog
from hostlink.protocol.frame import TOPICS_REQUEST, encode
from hostlink.sim.device import SimulatedDevice
from hostlink.sim.firmware_world import COMMAND_S, CONNECT_S, FirmwareWorld
from hostlink.sim.robot import LOOP_S, SimulatedRobot
from hostlink.sim.robot_on_floor import RobotOnFloor
from hostlink.sim.world import World
from hostlink.sim.world_library import LIBRARY, NativeWorld, WorldLibraryMissing, load_library
from hostlink.sim.world_parameters import WorldParameters, bounds, names, read
from tests.firmware.boards import build_native
from tests.firmware.worlds import worlds

CATALOG = Catalog()
SLIPPERY = WorldParameters(
    seed=5.0,
    caster_twist_rad=0.055,
    caster_random=0.4,
    left=replace(WorldParameters().left, slip_noise_m=0.003),
)
WHOLE = {"seed", "pwm_bits"}
STEPS_S = (0.001, 0.002, 0.01, 1 / 30)


@pytest.fixture(scope="module", autouse=True)
def built() -> None:
    """The library, compiled before the clock of the first test runs."""
    build_native()


def state(world: World | NativeWorld) -> list[float]:
    pose = [world.x_m, world.y_m, world.theta_rad, world.rolled_m, world.battery_v, world.caster_rad]
    wheels = [(wheel.speed_rad_s, wheel.rolled_rad, wheel.edges) for wheel in (world.left, world.right)]
    return [*pose, *wheels[0], *wheels[1]]


def read_natively(text: str) -> tuple[int, list[float]]:
    values = (ctypes.c_double * len(names()))()
    wrong = load_library().world_parameters_read(text.encode(), values)
    return int(wrong), list(values)


def test_the_parameters_have_the_same_names_order_and_defaults() -> None:
    library = load_library()
    values = (ctypes.c_double * len(names()))()
    library.world_parameters_defaults(values)
    assert [library.world_parameters_name(i).decode() for i in range(library.world_parameters_count())] == names()
    assert list(values) == WorldParameters().values()


@given(drawn=worlds())
def test_a_world_s_text_is_read_by_both(drawn: WorldParameters) -> None:
    assert read(drawn.text()) == drawn
    wrong, values = read_natively(drawn.text())
    assert wrong == 0
    assert values == pytest.approx(drawn.values(), rel=1e-15)


@pytest.mark.parametrize("text", ["track=0.2\n", "track_m\n", "track_m=\n", "track_m=wide\n", "track_m=0.2 m\n"])
def test_a_line_that_is_none_is_named_by_both(text: str) -> None:
    assert read_natively("# wide\n\n" + text)[0] == 3
    with pytest.raises(ValueError, match="track"):
        read("# wide\n\n" + text)


@pytest.mark.parametrize("name", names())
def test_both_refuse_a_number_that_is_out_of_its_range(name: str) -> None:
    low, high = bounds(name)
    for value in (low, high):
        assert read_natively(f"{name}={value!r}\n")[0] == 0
        assert read(f"{name}={value!r}\n").changed({name: value}) is not None
    for value in (low - 0.5, high * 1.5, 1e300):
        assert read_natively(f"{name}={value!r}\n")[0] == 1
        with pytest.raises(ValueError, match=name):
            read(f"{name}={value!r}\n")


near_numbers = st.text("0123456789.+-eE x", max_size=8)
near_lines = st.one_of(
    st.builds("{}={}".format, st.sampled_from([*names(), "track", "left", "", "#"]), near_numbers),
    st.builds("{}={!r}".format, st.sampled_from(names()), st.floats(0.0, 12.0)),
    st.text(st.characters(exclude_characters="\0", codec="utf-8"), max_size=12),
)


@given(lines=st.lists(near_lines, max_size=4), end=st.sampled_from(["\n", "\r\n", "\r"]))
def test_both_accept_the_same_texts(lines: list[str], end: str) -> None:
    text = end.join(lines)
    wrong, values = read_natively(text)
    try:
        accepted = read(text).values()
    except ValueError:
        assert wrong != 0
    else:
        assert wrong == 0
        assert values == pytest.approx(accepted, rel=1e-14)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_world_has_only_numbers(value: float) -> None:
    with pytest.raises(ValueError, match="track_m"):
        WorldParameters(track_m=value)


pwms = st.one_of(st.just(0), st.integers(-4095, 4095))
pieces = st.tuples(
    pwms, pwms, st.sampled_from(STEPS_S), st.integers(1, 80), st.sampled_from(["", "grip", "shove", "later"])
)


@st.composite
def extremes(draw: st.DrawFn) -> WorldParameters:
    """Any number of its range, its ends most of all."""
    chosen = draw(st.lists(st.sampled_from(names()), unique=True, max_size=8))
    ends = {name: st.one_of(st.sampled_from(bounds(name)), st.floats(*bounds(name))) for name in chosen}
    whole = {name: float(int(draw(values))) if name in WHOLE else draw(values) for name, values in ends.items()}
    return WorldParameters().changed(whole)


@given(drawn=extremes(), story=st.lists(pieces, min_size=1, max_size=4))
def test_whatever_world_it_is_its_numbers_stay_numbers_and_are_the_twin_s(
    drawn: WorldParameters, story: list[tuple[int, int, float, int, str]]
) -> None:
    native, twin = NativeWorld(drawn), World(drawn)
    for left, right, dt_s, steps, _ in story:
        for world in (native, twin):
            world.drive(left, right)
            for _ in range(min(steps, 10)):
                world.step(dt_s)
        assert all(map(math.isfinite, state(native)))
        assert state(native) == state(twin)


@given(drawn=worlds(), later=worlds(), story=st.lists(pieces, min_size=1, max_size=12))
def test_the_twin_computes_the_same_digits(
    drawn: WorldParameters, later: WorldParameters, story: list[tuple[int, int, float, int, str]]
) -> None:
    native, twin = NativeWorld(drawn), World(drawn)
    for left, right, dt_s, steps, event in story:
        for world in (native, twin):
            world.drive(left, right)
            if event == "grip":
                world.left.grip(left / 20)
            elif event == "shove":
                world.shove(0.01, -0.02, 0.3)
            elif event == "later":
                world.be(later)
            else:
                world.left.release()
        for _ in range(steps):
            native.step(dt_s)
            twin.step(dt_s)
            assert state(native) == state(twin)


def test_a_minute_in_coarse_steps_is_a_minute_in_fine_ones() -> None:
    """What a simulated robot's thirty steps a second make of the same PWMs: within 1 mm and 1 mrad."""
    fine, coarse = NativeWorld(), World()
    for piece in range(12):
        for world, steps in ((fine, 5000), (coarse, 150)):
            world.drive(2000 + 150 * piece, 3800 - 120 * piece)
            for _ in range(steps):
                world.step(5.0 / steps)
    assert math.hypot(fine.x_m - coarse.x_m, fine.y_m - coarse.y_m) <= 0.001
    assert fine.theta_rad == pytest.approx(coarse.theta_rad, abs=0.001)
    assert fine.rolled_m > 8.0


@pytest.mark.parametrize("make", [NativeWorld, World])
@pytest.mark.parametrize("ticks_s", [-5e-324, -5e-244, -1e-30, -1e-18, 1e-18, 5e-324])
def test_a_wheel_that_creeps_less_than_a_digit_passes_an_edge_once(
    make: type[NativeWorld] | type[World], ticks_s: float
) -> None:
    world = make(WorldParameters())
    world.left.grip(ticks_s)
    for _ in range(1000):
        world.step(0.001)
    assert world.left.edges <= 1


def test_a_simulated_robot_drives_the_same_way_in_either() -> None:
    poses = []
    for world in (NativeWorld(SLIPPERY), World(SLIPPERY)):
        robot = SimulatedRobot("robot_0", CATALOG, device=SimulatedDevice(baud=None), world=world)
        robot.device.from_host.send(TOPICS_REQUEST, 0.0)
        for turn in range(600):
            now_s = turn * LOOP_S
            twist = struct.pack("<6d", 0.2 if turn < 500 else 0.0, 0, 0, 0, 0, 0.5 if turn > 200 else 0.0)
            if turn % 3 == 0:
                robot.device.from_host.send(encode(100, twist), now_s)
            robot.turn(now_s)
        poses.append((robot.pose, world.x_m, world.y_m, world.theta_rad))
    assert poses[0] == poses[1]
    assert poses[0][1] != poses[0][0].x_m


def test_a_library_older_than_its_sources_is_refused(tmp_path: Path) -> None:
    stale = tmp_path / LIBRARY.name
    shutil.copy(LIBRARY, stale)
    os.utime(stale, (1.0, 1.0))
    with pytest.raises(WorldLibraryMissing, match="older than its sources: run  make world"):
        load_library(stale)


LEGS = (
    *((0.25, 0.0, 7.0), (0.0, 0.0, 0.7), (0.0, 0.6, 2.6), (0.0, 0.0, 0.7)) * 4,
    *((-0.2, 0.1, 5.0), (0.3, -0.4, 6.0), (0.0, 0.0, 1.0), (0.02, 0.1, 4.0), (0.0, 0.0, 1.0)),
)
commands = st.tuples(st.floats(-0.4, 0.4), st.floats(-2.0, 2.0), st.sampled_from([0.1, 0.4, 1.3]))
stops = st.just((0.0, 0.0, 0.7))


@given(drawn=worlds(), legs=st.lists(commands | stops, min_size=1, max_size=12))
@example(drawn=WorldParameters(), legs=list(LEGS))
@example(drawn=SLIPPERY, legs=list(LEGS))
@example(drawn=WorldParameters(seed=3, caster_twist_rad=0.055, caster_random=0.4), legs=list(LEGS))
def test_the_same_commands_bring_the_simulator_where_they_bring_the_firmware(
    drawn: WorldParameters, legs: list[tuple[float, float, float]]
) -> None:
    """Native firmware and the Python control, both with their own loop: within 1 mm and 1 mrad, after a minute too."""
    firmware, simulated = FirmwareWorld(drawn), RobotOnFloor(drawn)
    firmware.connect()
    simulated.drive(0.0, 0.0, CONNECT_S)
    for linear_m_s, angular_rad_s, seconds in legs:
        for _ in range(round(seconds / COMMAND_S)):
            for robot in (firmware, simulated):
                robot.drive(linear_m_s, angular_rad_s, COMMAND_S)
        if firmware.row["left_fault"] or firmware.row["right_fault"]:
            return  # it stops until a zero; the simulated one has no guardian
        for there, here in ((firmware.pose, simulated.pose), (firmware.odometry, simulated.odometry)):
            off = np.subtract(there, here)
            assert math.hypot(off[0], off[1]) <= 0.001
            assert abs(math.remainder(off[2], math.tau)) <= 0.001
