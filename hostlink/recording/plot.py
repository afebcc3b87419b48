"""Pictures of recordings: fields over time, and paths on the floor. matplotlib draws them, an extra."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from hostlink.errors import RecordingFailed
from hostlink.recording.tables import Table, Tables

_SIZE_IN = (10.0, 5.0)
_MAP_SIZE_IN = (7.0, 7.0)
POSITIONS = (("x", "y"), ("pose.pose.position.x", "pose.pose.position.y"))  # Pose2D, Odometry


def find_field(tables: Tables, name: str) -> tuple[str, Table, str]:
    """(topic, table, field) of `/robot_0/odometry.x`.

    Raises:
        RecordingFailed: there is none; the text names those that are.
    """
    for topic in sorted(tables, key=len, reverse=True):
        if name == topic or name.startswith(f"{topic}."):
            table, field = tables[topic], name[len(topic) + 1 :]
            numeric = [each for each in table if table[each].dtype.kind in "biuf"]
            if field in numeric:
                return topic, table, field
            raise RecordingFailed(f"{topic} has no number {field!r}; it has: {', '.join(numeric) or 'none'}")
    raise RecordingFailed(f"no topic of {name!r} was recorded; there are: {', '.join(tables)}")


def draw_fields(tables: Tables, names: Iterable[str], output: Path) -> None:
    """A line a field, over the time of the recording.

    Raises:
        RecordingFailed: a field is not there.
        OSError: the picture cannot be written.
    """
    chosen = [(name, *find_field(tables, name)) for name in names]
    from matplotlib.figure import Figure  # noqa: PLC0415 - takes a second, and is an extra

    figure = Figure(figsize=_SIZE_IN, layout="constrained")
    axes = figure.subplots()
    for name, _, table, field in chosen:
        axes.plot(table.time_s, table[field], label=name, linewidth=1.2)
    axes.set_xlabel("time since the beginning of the recording, s")
    _finish(figure, axes, output)


def draw_map(tables: Tables, output: Path) -> int:
    """The path of every topic that has positions; returns how many.

    Raises:
        RecordingFailed: there is none.
        OSError: the picture cannot be written.
    """
    paths = dict(_paths(tables))
    if not paths:
        raise RecordingFailed("no poses were recorded (geometry_msgs/Pose2D or nav_msgs/Odometry)")
    from matplotlib.figure import Figure  # noqa: PLC0415 - as above

    figure = Figure(figsize=_MAP_SIZE_IN, layout="constrained")
    axes = figure.subplots()
    for topic, (x_m, y_m) in paths.items():
        (line,) = axes.plot(x_m, y_m, label=topic, linewidth=1.2)
        axes.plot(x_m[:1], y_m[:1], marker="o", color=line.get_color())
        axes.plot(x_m[-1:], y_m[-1:], marker="s", color=line.get_color())
    axes.set_xlabel("x, m (circle: begin, square: end)")
    axes.set_ylabel("y, m")
    axes.set_aspect("equal", adjustable="datalim")
    _finish(figure, axes, output)
    return len(paths)


def _paths(tables: Tables) -> Iterable[tuple[str, tuple[Any, Any]]]:
    for topic, table in tables.items():
        for x, y in POSITIONS:
            if {x, y} <= table.keys() and table.type_name in ("geometry_msgs/Pose2D", "nav_msgs/Odometry"):
                yield topic, (np.asarray(table[x]), np.asarray(table[y]))


def _finish(figure: Any, axes: Any, output: Path) -> None:
    axes.grid(visible=True, alpha=0.3)
    axes.legend(loc="best")
    figure.savefig(output, dpi=120)
