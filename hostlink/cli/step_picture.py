"""The picture of a step: set-point, measured speed and PWM of each wheel. matplotlib draws it, an extra."""

import importlib.util
from collections.abc import Mapping
from pathlib import Path

from hostlink.errors import ConfigError, LibraryMissing
from hostlink.robot.step_response import Record

SUFFIXES = (".pdf", ".png", ".svg")
LIBRARY = "matplotlib"
_WIDTH_IN, _HEIGHT_IN = 9.0, 5.5
_SET_POINT, _MEASURED, _PWM = "#888888", "#0b6bcb", "#c25e00"


def require_picture(path: Path) -> None:
    """Fail before the robot moves, not afterwards.

    Raises:
        ConfigError: no picture can be written there.
    """
    if path.suffix not in SUFFIXES:
        raise ConfigError("--picture", f"{path} must end in one of {', '.join(SUFFIXES)}")
    if not path.parent.is_dir():
        raise ConfigError("--picture", f"there is no folder {path.parent}")
    if importlib.util.find_spec(LIBRARY) is None:
        raise LibraryMissing("--picture", "matplotlib", "pictures")


def draw_picture(path: Path, title: str, records: Mapping[str, Record]) -> None:
    """Write a picture with a column for each wheel."""
    from matplotlib.figure import Figure  # noqa: PLC0415 - takes a second, and is an extra

    figure = Figure(figsize=(_WIDTH_IN, _HEIGHT_IN), layout="constrained")
    figure.suptitle(title)
    has_pwm = any(record.pwm is not None for record in records.values())
    rows = 2 if has_pwm else 1
    axes = figure.subplots(rows, len(records), sharex=True, sharey="row", squeeze=False)
    for column, (name, record) in enumerate(records.items()):
        speeds = axes[0][column]
        speeds.set_title(name)
        speeds.plot(record.t_s, record.set_point, color=_SET_POINT, linestyle="--", label="set-point")
        speeds.plot(record.t_s, record.measured, color=_MEASURED, label="measured")
        if record.pwm is not None:
            axes[1][column].plot(record.t_s, record.pwm, color=_PWM, drawstyle="steps-post", label="PWM")
        axes[-1][column].set_xlabel("time since the first command, s")
        for row in axes:
            row[column].grid(visible=True, alpha=0.3)
    axes[0][0].set_ylabel(f"speed, {next(iter(records.values())).unit}")
    axes[0][0].legend(loc="lower right")
    if has_pwm:
        axes[1][0].set_ylabel("PWM, counts")
    figure.savefig(path, dpi=120)
