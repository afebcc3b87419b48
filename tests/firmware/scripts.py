"""Drives as scripts (firmware/host/world_script.h) that the firmware runs in virtual time, as a module or emulated."""

import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hostlink.workbench.sim.firmware_module import WorldParameters, columns, wheel
from hostlink.workbench.sim.firmware_world import Firmware
from tests.firmware.boards import TEXT_AT, build_m3
from tests.firmware.worlds import Trace, wheel_speeds

ROW_MS = 10
CONNECT_MS = 500
STANDS_MS = 1200  # at the end of each script
QEMU_S = 120.0
# The columns of worlds.Trace.
_SIDES = [f"{side}_{name}" for name in ("ticks_s", "set_ticks_s") for side in ("left", "right")]
_POSES = [f"{prefix}{name}" for prefix in ("", "odometry_") for name in ("x_m", "y_m", "theta_rad")]
_MOTORS = [f"{side}_{name}" for name in ("pwm", "rolled_ticks") for side in ("left", "right")]
_TRACE = ["t_s", *_SIDES, *_POSES, *_MOTORS]


@dataclass(frozen=True)
class Script:
    """A world and a drive in it: pieces of m/s, rad/s and milliseconds."""

    world: WorldParameters
    pieces: tuple[tuple[float, float, int], ...]

    @property
    def text(self) -> str:
        lines = (f"drive {linear!r} {angular!r} {ms}\n" for linear, angular, ms in self.pieces)
        return self.world.text() + "".join(lines)

    @property
    def rows(self) -> int:
        """Number of rows that it gives."""
        return (CONNECT_MS + sum(ms for _, _, ms in self.pieces)) // ROW_MS

    @property
    def reversals(self) -> int:
        """Number of changes of direction that a wheel is commanded, for the wheel with more of them."""
        signs = np.sign(self.commanded)
        return max(int(np.count_nonzero(np.diff(wheel[wheel != 0.0]))) for wheel in signs.T)

    @property
    def commanded(self) -> np.ndarray:
        """One row for each row of the trace: commanded speeds of the wheels, left and right, in ticks/s."""
        silent = np.zeros((CONNECT_MS // ROW_MS, 2))
        return np.concatenate([silent, *(np.tile(wheel_speeds(v, w), (ms // ROW_MS, 1)) for v, w, ms in self.pieces)])


def run_module(text: str, rows: int) -> np.ndarray:
    """Rows of the module that simulated robots run."""
    firmware = Firmware()
    wrong = firmware.run_script(text)
    assert wrong == 0, f"line {wrong}: {text.splitlines()[wrong - 1]}"
    assert len(firmware.rows) == rows
    return firmware.rows


def start_m3(text: str, folder: Path) -> "subprocess.Popen[bytes]":
    """Emulate a Cortex-M3 that runs the script in this folder."""
    (folder / "script.txt").write_text(text)
    machine = ["qemu-system-arm", "-M", "mps2-an385", "-semihosting", "-display", "none", "-monitor", "none"]
    loader = ["-device", f"loader,force-raw=on,addr={TEXT_AT:#x},file=script.txt"]
    kernel = ["-serial", "none", "-kernel", str(build_m3() / "due_script_m3.elf")]
    return subprocess.Popen([*machine, *loader, *kernel], cwd=folder)


def run_m3(text: str, folder: Path) -> np.ndarray:
    """Rows of the firmware on the emulated Cortex-M3."""
    with start_m3(text, folder) as process:
        try:
            status = process.wait(QEMU_S)
        finally:
            process.kill()
    assert status == 0
    return np.fromfile(folder / "rows.bin").reshape(-1, len(columns()))


def column(rows: np.ndarray, name: str) -> np.ndarray:
    return rows[:, columns().index(name)]


def trace(rows: np.ndarray) -> Trace:
    """The rows in the form that the checks of a drive read."""
    return Trace(*(column(rows, name) for name in _TRACE))


def draw(seed: int) -> Script:
    """A drawn world for which the firmware was not tuned, and drives and pauses that end in a zero."""
    random = np.random.default_rng(seed)
    full_speed_rad_s = WorldParameters()["left.full_speed_rad_s"]
    dead_zone_pwm, time_constant_s = random.uniform(0.0, 800.0), random.uniform(0.02, 0.2)
    make = {
        "dead_zone_pwm": dead_zone_pwm,
        "has_jump": float(random.integers(2)),
        "rise_constant_s": time_constant_s,
        "coast_constant_s": random.uniform(max(0.05, time_constant_s), 1.0),
        "brake_constant_s": time_constant_s,  # the same motor against the same resistance, without a voltage
        "friction_rad_s": random.uniform() * dead_zone_pwm / 4095 * full_speed_rad_s,
    }
    left, right = (
        wheel(
            side,
            full_speed_rad_s=random.uniform(0.9, 1.1) * full_speed_rad_s,
            radius_m=random.uniform(0.044, 0.046),
            slip_noise_m=random.choice([0.0, 0.003]),
            slip_accelerating_s2_m=random.choice([0.0, 0.02]),
            slip_braking_s2_m=random.choice([0.0, 0.02]),
            **make,
        )
        for side in ("left", "right")
    )
    world = WorldParameters(
        {
            "seed": seed,
            "track_m": random.uniform(0.2, 0.22),
            "caster_pwm": random.choice([0.0, 100.0, 300.0]),
            "caster_twist_rad": random.choice([0.0, 0.055]),
            "caster_random": 0.4,
            "floor_pwm": random.choice([0.0, 0.0, 200.0]),
            "battery_v": random.uniform(10.5, 13.0),
            "battery_sag_v": random.uniform(0.0, 1.0),
            **left,
            **right,
        }
    )
    return Script(world, tuple(_story(random)))


def draw_joystick(seed: int) -> Script:
    """World of `draw`, driven with a joystick: a new command every 20 to 200 ms, and sometimes a zero."""
    return Script(draw(seed).world, tuple(_strokes(np.random.default_rng((seed, 1)))))


def draw_reversals(seed: int) -> Script:
    """World of `draw`, driven with a stick that is pulled through zero and back, in steps and with an unsteady hand."""
    return Script(draw(seed).world, tuple(_reversals(np.random.default_rng((seed, 2)))))


def _reversals(random: np.random.Generator) -> list[tuple[float, float, int]]:
    pieces: list[tuple[float, float, int]] = []
    interval_ms = int(random.choice([50, 100]))
    now = np.zeros(2)
    for _ in range(random.integers(2, 7)):
        aim = np.array([random.uniform(-0.34, 0.34), random.choice([0.0, random.uniform(-3.0, 3.0)])])
        steps, tremble = random.integers(1, 8), random.choice([0.0, 0.01, 0.05])
        for linear, angular in np.linspace(now, aim, int(steps) + 1)[1:]:
            pieces.append((float(linear), float(angular), interval_ms))
        for _ in range(random.integers(0, 1500 // interval_ms)):  # a command too small to turn a wheel stalls after 5 s
            linear, angular = aim * (1.0 + tremble * random.uniform(-1.0, 1.0, 2))
            pieces.append((float(linear), float(angular), interval_ms))
        now = aim
    return [*pieces, (0.0, 0.0, STANDS_MS)]


def _strokes(random: np.random.Generator) -> list[tuple[float, float, int]]:
    pieces = []
    interval_ms = 10 * int(random.integers(2, 21))
    now = np.zeros(2)
    for _ in range(random.integers(2, 7)):
        aim = np.array([random.uniform(-0.34, 0.34), random.choice([0.0, random.uniform(-1.5, 1.5)])])
        share, tremble = random.uniform(0.05, 0.5), random.choice([0.0, 0.001, 0.01])
        for _ in range(random.integers(5, 3000 // interval_ms)):  # a command too small to turn a wheel stalls after 5 s
            now = now + share * (aim - now)
            linear, angular = now + tremble * random.uniform(-1.0, 1.0, 2)
            pieces.append((float(linear), float(angular), interval_ms))
        if random.integers(3) == 0:
            pieces.append((0.0, 0.0, int(random.choice([40, 100, 600]))))
            now = np.zeros(2)
    return [*pieces, (0.0, 0.0, STANDS_MS)]


def _story(random: np.random.Generator) -> list[tuple[float, float, int]]:
    pieces = []
    for _ in range(random.integers(1, 9)):
        linear = random.uniform(0.02, 0.34) * random.choice([-1.0, 1.0])
        angular = random.choice([0.0, random.uniform(-1.5, 1.5)])
        pieces.append((float(linear), float(angular), 10 * int(random.integers(10, 301))))
        pieces.append((0.0, 0.0, int(random.choice([0, 0, 40, 70, 100, 200, 600, 1000]))))
    return [*pieces, (0.0, 0.0, STANDS_MS)]
