"""Builds the Due's firmware with CMake: natively and for the Cortex-M3."""

import subprocess
from functools import cache
from pathlib import Path

FIRMWARE = Path(__file__).resolve().parents[2] / "firmware"
BUILD = FIRMWARE.parent / "build" / "firmware"


def _build(preset: str, target: str) -> Path:
    for command in (["cmake", "--preset", preset], ["cmake", "--build", "--preset", preset, "--target", target]):
        done = subprocess.run(command, cwd=FIRMWARE, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
    return BUILD / preset


@cache
def build_native() -> Path:
    """The folder with due_native."""
    return _build("native", "due_native")


@cache
def build_m3() -> Path:
    """The folder with due_m3.elf, built within its budgets."""
    return _build("cortex-m3", "due_m3.elf")
