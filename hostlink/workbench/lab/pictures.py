"""Pictures of driven paths, true and by odometry. Needs matplotlib, which only this module imports."""

from dataclasses import replace
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from hostlink.core.robot.kinematics import Pose
from hostlink.workbench.lab.experiment import PATTERNS, Experiment, Pattern, Run, Setup, Software, calibrated, conduct
from hostlink.workbench.sim.firmware_module import WorldParameters

_TRUE, _ODOMETRY, _MARK = "#1b6ca8", "#d1495b", "#777777"
_DPI = 80
_SIDEWAYS_M = 0.75  # range of y for a line, stretched so that deviations are visible


def draw_software(world: WorldParameters, runs: int, file: Path) -> None:
    """Draw the paper's software and the project's firmware in one world.

    Raises:
        ConfigError: wasmtime is not installed, or has no library for this machine.
        OSError: the file cannot be written.
    """
    firmware = Setup(software=Software.FIRMWARE, world=world)
    paper = replace(firmware, software=Software.PAPER)
    draw({"paper's software": paper, "ours": firmware, "ours, calibrated": calibrated(firmware)}, runs, file)


def draw(setups: dict[str, Setup], runs: int, file: Path) -> None:
    """Draw a row of pictures for each software, one for each pattern, into a PNG.

    Raises:
        ConfigError: wasmtime is not installed, or has no library for this machine.
        OSError: the file cannot be written.
    """
    figure = Figure(figsize=(13, 3.0 * len(setups)), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(len(setups), len(PATTERNS), squeeze=False)
    for row, (title, setup) in zip(grid, setups.items(), strict=True):
        for axes, pattern in zip(row, PATTERNS, strict=True):
            _draw_runs(axes, conduct(Experiment(setup, pattern, runs)), pattern)
            axes.set_title(f"{title}: {pattern.title}", fontsize=9)
    handles, labels = grid[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, fontsize=9)
    figure.savefig(file, dpi=_DPI, format="png", pil_kwargs={"optimize": True})


def _draw_runs(axes: Axes, runs: list[Run], pattern: Pattern) -> None:
    for run in runs:
        first = run is runs[0]
        truth, odometry = [sample.truth for sample in run.samples], [sample.odometry for sample in run.samples]
        axes.plot(*_xy(truth), color=_TRUE, linewidth=0.8, label="true path" if first else None)
        axes.plot(*_xy(odometry), color=_ODOMETRY, linewidth=0.8, label="by odometry" if first else None)
    marks = pattern.marks_of(0)
    axes.plot(*zip(*marks, strict=True), "+", color=_MARK, markersize=8, label="marks on the floor")
    if pattern.is_scaled:
        axes.set_ylim(-_SIDEWAYS_M, _SIDEWAYS_M)
    else:
        axes.set_aspect("equal", adjustable="datalim")
    axes.tick_params(labelsize=7)
    axes.set_xlabel("x (m)", fontsize=7)
    axes.set_ylabel("y (m)", fontsize=7)
    axes.grid(linewidth=0.3)


def _xy(poses: list[Pose]) -> tuple[list[float], list[float]]:
    return [pose[0] for pose in poses], [pose[1] for pose in poses]
