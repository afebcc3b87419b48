"""Pictures of recordings: fields over time, and paths on the floor, drawn by the extra matplotlib.

A recording may be larger than the memory. Only the drawn topics are read, and each line keeps as many points as a
picture can show.
"""

import contextlib
from array import array
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hostlink.components.recorder.channel import Channel
from hostlink.components.recorder.history import Thinned
from hostlink.components.recorder.reader import RecordingSource
from hostlink.components.recorder.tables import Decoders, flat
from hostlink.core.runtime.units import NS_PER_S
from hostlink.errors import RecordingFailed

MAX_POINTS = 4000  # of a line, up to twice as many at a time; a picture has 1200 pixels, and each point costs memory
_POINTS_AT_ONCE = 1000  # of a line that matplotlib draws at once: it keeps every pixel that these cross
MAX_LINES = 64  # of a field that is an array
_SIZE_IN = (10.0, 5.0)
_MAP_SIZE_IN = (7.0, 7.0)
POSITIONS = (("x", "y"), ("pose.pose.position.x", "pose.pose.position.y"))  # Pose2D, Odometry
_POSES = ("Pose2D", "Odometry")


class PlotLine:
    """Values over time. Above `most` points, the lowest and highest of each few are kept."""

    def __init__(self, most: int = MAX_POINTS) -> None:
        self._most = most
        self._times_s, self._values = array("d"), array("d")

    def add(self, time_s: float, value: float) -> None:
        self._times_s.append(time_s)
        self._values.append(value)
        if len(self._values) >= 2 * self._most:
            self._halve()

    def _halve(self) -> None:
        """Keep the lowest and the highest of every four points, in order."""
        times_s, values = self.points()
        whole = len(values) // 4 * 4
        of_four = values[:whole].reshape(-1, 4)
        chosen = np.sort(np.stack((of_four.argmin(axis=1), of_four.argmax(axis=1))), axis=0)
        numbers = np.concatenate(((np.arange(whole, step=4) + chosen).T.reshape(-1), np.arange(whole, len(values))))
        self._times_s = array("d", times_s[numbers].tobytes())
        self._values = array("d", values[numbers].tobytes())

    def points(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return (times, values)."""
        return np.array(self._times_s, dtype=np.float64), np.array(self._values, dtype=np.float64)


class _Field(NamedTuple):
    topic: str
    path: str


def read_lines(source: RecordingSource, names: Iterable[str]) -> dict[str, list[PlotLine]]:
    """Read the lines of each field, such as `/robot_0/odometry.x`. An array has one line for each element.

    Raises:
        RecordingFailed: a field does not exist (the text names the existing ones), or the recording cannot be read.
    """
    topics = sorted({channel.topic for channel in source.read_channels()})
    fields = {name: _field(name, topics) for name in names}
    wanted = {field.topic for field in fields.values()}
    lines: dict[str, list[PlotLine]] = {name: [] for name in fields}
    numeric: dict[str, dict[str, None]] = {topic: {} for topic in wanted}
    found_topics = set[str]()
    decoders = Decoders()
    for message in source.messages(lambda channel: channel.topic in wanted):
        found_topics.add(message.channel.topic)
        found = decoders.decode(message)
        if found is None:
            continue
        topic, time_s = message.channel.topic, (message.steady_ns - source.begin_ns) / NS_PER_S
        values = dict(flat(found))
        if not numeric[topic]:
            numeric[topic] = dict.fromkeys(path for path, value in values.items() if _numbers(value))
        for name, field in fields.items():
            if field.topic == topic:
                for number, value in enumerate(_numbers(values.get(field.path))):
                    if number == len(lines[name]):
                        lines[name].append(PlotLine())
                    lines[name][number].add(time_s, value)
    for name, (topic, path) in fields.items():
        if not lines[name]:
            if topic not in found_topics:
                raise RecordingFailed(f"{topic} has no message in this recording; name another topic")
            what = f"has no numeric field {path!r}" if path else "is a whole topic; add one of its fields"
            raise RecordingFailed(f"{topic} {what}; available: {', '.join(numeric[topic]) or 'none'}")
    return lines


def _field(name: str, topics: list[str]) -> _Field:
    for topic in sorted(topics, key=len, reverse=True):
        if name == topic or name.startswith(f"{topic}."):
            return _Field(topic, name[len(topic) + 1 :])
    raise RecordingFailed(f"{name!r}: the recording has no such topic; available: {', '.join(topics)}")


def _numbers(value: Any) -> list[float]:
    """Return the numbers of a field; empty if it has none."""
    if isinstance(value, (bool, int, float)):
        return [float(value)]
    if isinstance(value, (list, bytes)) and all(isinstance(each, (int, float)) for each in value[:MAX_LINES]):
        return [float(each) for each in value[:MAX_LINES]]
    return []


def read_paths(source: RecordingSource) -> dict[str, list[tuple[float, float]]]:
    """Read the path of every topic with positions: (x, y) in metres.

    Raises:
        RecordingFailed: no topic has positions, or the recording cannot be read.
    """
    paths: dict[str, Thinned[tuple[float, float]]] = {}
    decoders = Decoders()
    for message in source.messages(_has_poses):
        found = decoders.decode(message)
        position = None if found is None else _position(dict(flat(found)))
        if position is not None:
            paths.setdefault(message.channel.topic, Thinned(MAX_POINTS)).add(position)
    if not paths:
        raise RecordingFailed("no poses were recorded (geometry_msgs/Pose2D or nav_msgs/Odometry)")
    return {topic: path.samples() for topic, path in paths.items()}


def _has_poses(channel: Channel) -> bool:
    package, _, base = channel.type_name.rpartition("/")
    return base in _POSES and package.partition("/")[0] in ("geometry_msgs", "nav_msgs")


def _position(values: Mapping[str, Any]) -> tuple[float, float] | None:
    return next(((values[x], values[y]) for x, y in POSITIONS if {x, y} <= values.keys()), None)


def draw_fields(lines: Mapping[str, list[PlotLine]], output: Path) -> None:
    """Draw each field over the time of the recording.

    Raises:
        OSError: the picture cannot be written.
    """
    with _picture(output, _SIZE_IN) as axes:
        for name, of_field in lines.items():
            for number, line in enumerate(of_field):
                label = name if len(of_field) == 1 else f"{name}[{number}]"
                axes.plot(*line.points(), label=label, linewidth=1.2)
        axes.set_xlabel("time since the beginning of the recording, s")


def draw_map(paths: Mapping[str, list[tuple[float, float]]], output: Path) -> None:
    """Draw each path on the floor.

    Raises:
        OSError: the picture cannot be written.
    """
    with _picture(output, _MAP_SIZE_IN) as axes:
        for topic, path in paths.items():
            x_m, y_m = np.array(path, dtype=np.float64).T
            (line,) = axes.plot(x_m, y_m, label=topic, linewidth=1.2)
            axes.plot(x_m[:1], y_m[:1], marker="o", color=line.get_color())
            axes.plot(x_m[-1:], y_m[-1:], marker="s", color=line.get_color())
        axes.set_xlabel("x, m (circle: begin, square: end)")
        axes.set_ylabel("y, m")
        axes.set_aspect("equal", adjustable="datalim")


@contextlib.contextmanager
def _picture(output: Path, size_in: tuple[float, float]) -> Iterator[Any]:
    """Yield axes, and write their picture after the block."""
    from matplotlib import rc_context  # noqa: PLC0415 - takes a second, and is an extra
    from matplotlib.figure import Figure  # noqa: PLC0415

    figure = Figure(figsize=size_in, layout="constrained")
    axes = figure.subplots()
    yield axes
    axes.grid(visible=True, alpha=0.3)
    axes.legend(loc="best")
    with rc_context({"agg.path.chunksize": _POINTS_AT_ONCE}):
        figure.savefig(output, dpi=120)
