"""Drives in drawn worlds, by their seeds: none is wrong. The module and the emulated Cortex-M3 drive the same way.

A share here; `make soak` sets HOSTLINK_DRIVES to 5000 and HOSTLINK_DRIVES_M3 to 100.
"""

import os
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
import pytest

from hostlink.workbench.sim.firmware_module import WorldParameters, columns, wheel
from tests.firmware.boards import build_m3
from tests.firmware.drive_checks import check_odometry, check_speed, check_standstill
from tests.firmware.scripts import (
    CONNECT_MS,
    STANDS_MS,
    Script,
    column,
    draw,
    draw_joystick,
    draw_reversals,
    run_m3,
    run_module,
    trace,
)

DRIVES = int(os.environ.get("HOSTLINK_DRIVES", "60"))
DRIVES_M3 = int(os.environ.get("HOSTLINK_DRIVES_M3", "1"))
ROW_MS = 10
MINUTE = Script(
    WorldParameters(
        {
            "seed": 7,
            "caster_twist_rad": 0.055,
            "caster_random": 0.4,
            "caster_pwm": 100.0,
            "battery_sag_v": 0.8,
            **wheel("left", radius_m=0.0452, slip_noise_m=0.003),
            **wheel("right", full_speed_rad_s=7.4, slip_accelerating_s2_m=0.02),
        }
    ),
    (
        *((0.25, 0.0, 7000), (0.0, 0.0, 700), (0.0, 0.6, 2600), (0.0, 0.0, 700)) * 4,
        *((-0.2, 0.1, 5000), (0.3, -0.4, 6000), (0.0, 0.0, 1000), (0.02, 0.1, 4000)),
    ),
)


@pytest.fixture(scope="module", autouse=True)
def built() -> None:
    """Compiled before the time limit of the first test starts."""
    build_m3()


def check(script: Script, rows: np.ndarray) -> None:
    """One drive; the first half second has no command."""
    made, start = trace(rows), CONNECT_MS // ROW_MS
    check_odometry(made.since(start), script.reversals)
    check_speed(made.since(start), script.commanded[start:])
    check_standstill(made.since(len(rows) - STANDS_MS // ROW_MS - 1), script.world)
    assert not np.any(column(rows, "left_fault")), "a fault of the left wheel"
    assert not np.any(column(rows, "right_fault")), "a fault of the right wheel"


def wrong_of(scripts: Iterable[Script], folder: Path | None = None) -> list[str]:
    wrong = []
    for script in scripts:
        rows = run_module(script.text, script.rows) if folder is None else run_m3(script.text, folder)
        try:
            check(script, rows)
        except AssertionError as error:
            wrong.append(f"seed {script.world['seed']:.0f}: {error}")
    return wrong


stories = pytest.mark.parametrize(
    "story", [draw, draw_joystick, draw_reversals], ids=["pieces", "joystick", "reversals"]
)


@stories
@pytest.mark.timeout(300 + DRIVES)
def test_no_drive_of_the_module_is_wrong(story: Callable[[int], Script]) -> None:
    assert wrong_of(map(story, range(DRIVES))) == []


@stories
@pytest.mark.timeout(300 + 30 * DRIVES_M3)
def test_no_drive_of_the_emulated_firmware_is_wrong(story: Callable[[int], Script], tmp_path: Path) -> None:
    assert wrong_of(map(story, range(DRIVES_M3)), tmp_path) == []


def changed(rows: np.ndarray, name: str, change: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    made = rows.copy()
    made[:, columns().index(name)] = change(column(rows, name))
    return made


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("left_rolled_ticks", lambda values: values * 1.2),
        ("right_rolled_ticks", lambda values: values + 40.0 * (np.arange(len(values)) > len(values) / 2)),
        ("left_ticks_s", lambda values: values * 3.0),
        ("right_pwm", lambda values: -values),
        ("left_ticks_s", lambda values: values + 50.0 * (np.arange(len(values)) > len(values) - 50)),
        ("right_fault", lambda values: values + 1.0),
    ],
    ids=["wheel slips from its encoder", "odometry jumps", "too fast", "driven against", "rolls on", "fault"],
)
def test_each_kind_of_wrong_drive_is_found(name: str, change: Callable[[np.ndarray], np.ndarray]) -> None:
    for seed in range(3):
        script = Script(draw(seed).world, ((0.25, 0.0, 4000), (0.0, 0.0, STANDS_MS)))
        rows = run_module(script.text, script.rows)
        check(script, rows)
        with pytest.raises(AssertionError):
            check(script, changed(rows, name, change))


@pytest.mark.long
def test_module_and_emulated_firmware_after_a_minute_are_at_the_same_place(tmp_path: Path) -> None:
    module, emulated = run_module(MINUTE.text, MINUTE.rows), run_m3(MINUTE.text, tmp_path)
    assert len(module) == len(emulated) >= 6000
    off_m = np.hypot(column(module, "x_m") - column(emulated, "x_m"), column(module, "y_m") - column(emulated, "y_m"))
    off_rad = np.abs(column(module, "theta_rad") - column(emulated, "theta_rad"))
    assert float(np.max(off_m)) <= 0.001
    assert float(np.max(off_rad)) <= 0.001
    assert column(module, "rolled_m")[-1] > 6.0
