"""Calibrated: a firmware's numbers from squares that were driven both ways in its world."""

from dataclasses import replace

import numpy as np

from hostlink.lab.experiment import Experiment, Setup, conduct
from hostlink.lab.operator import Run
from hostlink.lab.patterns import SQUARE_LEFT, SQUARE_RIGHT

TRAINING_RUNS = 5  # each way, as UMBmark
_TRAINING_SEED = 1000  # none of the runs that are measured afterwards
_NOMINAL_TRACK_M = 0.21


def calibrated(setup: Setup) -> Setup:
    """The same firmware, told the true radii, and the track that makes the turns of training squares right.

    Raises:
        WorldLibraryMissing: the firmware is not built.
    """
    world = setup.world
    radii = (world.left.radius_m, world.right.radius_m)
    training = replace(_told(setup, radii, _NOMINAL_TRACK_M), first_seed=_TRAINING_SEED)
    runs = [
        run for pattern in (SQUARE_LEFT, SQUARE_RIGHT) for run in conduct(Experiment(training, pattern, TRAINING_RUNS))
    ]
    return _told(setup, radii, _NOMINAL_TRACK_M * _turned(runs))


def _turned(runs: list[Run]) -> float:
    """How far odometry turned for each turn of the robot, by the headings of all runs."""
    true_rad = np.array([run.true_turn_rad for run in runs])
    odometry_rad = true_rad + np.array([run.heading_error_rad for run in runs])
    return float((odometry_rad * true_rad).sum() / (true_rad * true_rad).sum())


def _told(setup: Setup, radii: tuple[float, float], track_m: float) -> Setup:
    return replace(setup, device_parameters=(("wheel_radius", radii), ("wheel_separation", (track_m,))))
