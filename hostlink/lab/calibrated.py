"""Calibrated: a firmware's numbers by UMBmark, from drives in its world that somebody has measured with a tape."""

from dataclasses import replace

from hostlink.lab.experiment import Experiment, Setup, conduct
from hostlink.lab.operator import Run
from hostlink.lab.paper_results import SQUARE_SIDE_M
from hostlink.lab.patterns import LINE, SQUARE_LEFT, SQUARE_RIGHT, Pattern
from hostlink.robot import calibration
from hostlink.robot.calibration import Kind, MeasuredRun, Measurement, WheelGeometry

TRAINING_RUNS = 5  # each way, as UMBmark
_TRAINING_SEED = 1000  # none of the runs that are measured afterwards
_KINDS: dict[Pattern, Kind] = {LINE: Kind.STRAIGHT, SQUARE_LEFT: Kind.SQUARE_CCW, SQUARE_RIGHT: Kind.SQUARE_CW}


def calibrated(setup: Setup) -> Setup:
    """The same firmware, with the numbers that `hostlink calibrate` finds for it in this world.

    Raises:
        ConfigError: wasmtime is not installed, or has no library for this machine.
    """
    training = replace(setup, first_seed=_TRAINING_SEED)
    runs = [run for pattern in _KINDS for run in conduct(Experiment(training, pattern, TRAINING_RUNS))]
    geometry = calibration.calibrated([_measured(run) for run in runs], WheelGeometry()).geometry
    radii = (geometry.left_radius_m, geometry.right_radius_m)
    return replace(setup, device_parameters=(("wheel_radius", radii), ("wheel_separation", (geometry.separation_m,))))


def _measured(run: Run) -> MeasuredRun:
    """A drive as a person with a tape measure writes it down: the heading is not measured."""
    truth = run.samples[-1].truth
    size_m = truth.x_m if run.pattern is LINE else SQUARE_SIDE_M
    path = tuple(sample.odometry for sample in run.samples)
    return MeasuredRun(_KINDS[run.pattern], size_m, path, Measurement(truth.x_m, truth.y_m))
