"""Picture of a calibration: an SVG with the driven squares, and their errors before and after. Pure."""

import itertools
import math
from collections.abc import Iterable, Sequence

from hostlink.core.robot.odometry import OdometryCorrection
from hostlink.workbench.calibration import Calibration, MeasuredRun, RunKind, end_of, uncorrected

WIDTH, HEIGHT, MARGIN = 520.0, 520.0, 46.0
DRAWN = 4  # every fourth pose is drawn
COLOURS = {RunKind.SQUARE_CW: "#c2410c", RunKind.SQUARE_CCW: "#1d4ed8"}
_SQUARES = tuple(COLOURS)
_GOOD = "#15803d"

Point = tuple[float, float]


def picture(found: Calibration, runs: Sequence[MeasuredRun], checks: Sequence[MeasuredRun]) -> str:
    """Return the picture as SVG."""
    squares = [run for run in runs if run.kind in _SQUARES]
    parts = [*_paths(found, squares), *_ends(found, squares, [run for run in checks if run.kind in _SQUARES])]
    body = "\n".join(parts)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{2 * WIDTH:g}" height="{HEIGHT + 40:g}" '
        f'font-family="sans-serif" font-size="13">\n<rect width="100%" height="100%" fill="white"/>\n{body}\n</svg>\n'
    )


class _Panel:
    """Mapping of metres to pixels, with the same scale in both directions and y upwards."""

    def __init__(self, left: float, points: Iterable[Point]) -> None:
        xs, ys = zip(*points, strict=True)
        self._scale = (WIDTH - 2 * MARGIN) / max(max(xs) - min(xs), max(ys) - min(ys), 1e-3)
        self._x_m, self._y_m = (max(xs) + min(xs)) / 2, (max(ys) + min(ys)) / 2
        self._x, self._y = left + WIDTH / 2, 40 + HEIGHT / 2

    def at(self, point: Point) -> Point:
        return self._x + (point[0] - self._x_m) * self._scale, self._y - (point[1] - self._y_m) * self._scale

    def line(self, points: Iterable[Point], colour: str, *, width: float = 1.5, dash: str = "") -> str:
        pixels = " ".join(f"{x:.1f},{y:.1f}" for x, y in map(self.at, points))
        return f'<polyline points="{pixels}" fill="none" stroke="{colour}" stroke-width="{width}" {_dashed(dash)}/>'

    def dot(self, point: Point, colour: str, *, is_filled: bool) -> str:
        x, y = self.at(point)
        fill = colour if is_filled else "white"
        return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="5" fill="{fill}" stroke="{colour}" stroke-width="2"/>'

    def circle(self, radius_m: float, colour: str) -> str:
        x, y = self.at((0.0, 0.0))
        size = radius_m * self._scale
        return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{size:.1f}" fill="none" stroke="{colour}" {_dashed("4 4")}/>'


def _paths(found: Calibration, squares: Sequence[MeasuredRun]) -> list[str]:
    """Draw the path by odometry (dashed), the path with the new wheels, and the measured end."""
    raw = [_path(run, uncorrected(found.nominal)) for run in squares]
    true = [_path(run, found.correction) for run in squares]
    ends = [(run.measured.x_m, run.measured.y_m) for run in squares]
    panel = _Panel(0.0, [*(point for path in (*raw, *true) for point in path), *ends])
    return [
        _text(MARGIN, 24, "Squares: by odometry (dashed), new wheels, true ends"),
        *(panel.line(path, "#9ca3af", dash="5 4") for path in raw),
        *(panel.line(path, COLOURS[run.kind]) for run, path in zip(squares, true, strict=True)),
        *(panel.dot(end, COLOURS[run.kind], is_filled=True) for run, end in zip(squares, ends, strict=True)),
    ]


def _ends(found: Calibration, squares: Sequence[MeasuredRun], checks: Sequence[MeasuredRun]) -> list[str]:
    """Draw the errors at the end, measured less odometry, as UMBmark does."""
    before = [(run, _error(run, uncorrected(found.nominal))) for run in squares]
    after = [(run, _error(run, found.correction)) for run in squares]
    tested = [(run, _error(run, found.correction)) for run in checks]
    largest_m = found.before.largest_m
    corners = [(-largest_m, -largest_m), (largest_m, largest_m)]
    panel = _Panel(WIDTH, [*corners, *(error for _, error in before)])
    left = WIDTH + MARGIN
    return [
        _text(left, 24, "Errors at the end: before (empty), after (filled), check drive (green)"),
        panel.line([(-largest_m, 0.0), (largest_m, 0.0)], "#d1d5db"),
        panel.line([(0.0, -largest_m), (0.0, largest_m)], "#d1d5db"),
        panel.circle(largest_m, "#9ca3af"),
        *(panel.dot(error, COLOURS[run.kind], is_filled=False) for run, error in before),
        *(panel.dot(error, COLOURS[run.kind], is_filled=True) for run, error in after),
        *(panel.dot(error, _GOOD, is_filled=True) for _, error in tested),
        _text(
            left, HEIGHT + 12, f"E_max,syst {largest_m * 100:.1f} cm before, {found.after.largest_m * 100:.2f} cm after"
        ),
        _text(left, HEIGHT + 30, "orange: clockwise, blue: counter-clockwise"),
    ]


def _path(run: MeasuredRun, correction: OdometryCorrection) -> list[Point]:
    cos, sin = math.cos(run.path[0].theta_rad), math.sin(run.path[0].theta_rad)
    here, path = run.path[0], []
    for before, after in itertools.pairwise(run.path):
        dx_m, dy_m = here.x_m - run.path[0].x_m, here.y_m - run.path[0].y_m
        path.append((dx_m * cos + dy_m * sin, dy_m * cos - dx_m * sin))
        here = correction.advance(here, before, after)
    return [*path[::DRAWN], *path[-1:]]


def _error(run: MeasuredRun, correction: OdometryCorrection) -> Point:
    end = end_of(run, correction)
    return run.measured.x_m - end.x_m, run.measured.y_m - end.y_m


def _text(x: float, y: float, text: str) -> str:
    return f'<text x="{x:g}" y="{y:g}">{text}</text>'


def _dashed(dash: str) -> str:
    return f'stroke-dasharray="{dash}"' if dash else ""
