"""Model of a pattern as legs and turns without motors, fast enough for a hundred thousand drawn runs. Pure.

Each turn adds an error to the heading, each leg an error in proportion to its length, and each leg after a turn a fixed
length. An error that no such numbers explain is not explained by caster, slip or radius either.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hostlink.workbench.lab.experiment import BACK, LINE_M, LINE_TABLE, PAPER_CM, SQUARE_LEFT, SQUARE_RIGHT, Pattern

_Array = NDArray[np.float64]

_READING_CM = 0.5  # standard deviation of a mean of three readings of a tape measure on the floor
RUNS = 3  # runs of each of the paper's tables
TURNING = (SQUARE_LEFT, SQUARE_RIGHT, BACK)
T_95 = {
    1: 12.7062,
    2: 4.302653,
    3: 3.182446,
    4: 2.776445,
    5: 2.570582,
    11: 2.200985,
}  # Student's, by degrees of freedom
_NORMAL_95 = 1.959963985  # for many degrees of freedom


@dataclass(frozen=True, slots=True, kw_only=True)
class TurnErrors:
    """Errors of turns and legs."""

    mean_rad: float  # angle by which the robot turns farther than its odometry, at each turn
    random_rad: float = 0.0  # standard deviation of that angle
    loss_m: float = 0.0  # length that slipping wheels add to odometry at the start of each leg after a turn


def errors_cm(pattern: Pattern, turns: TurnErrors, normal: _Array) -> _Array:
    """Return odometry minus truth, x and y, one row for each run. `normal`: random numbers, a column for each turn."""
    marks = np.array([(0.0, 0.0), *pattern.marks_of(0)])
    legs = np.diff(marks[:, 0] + 1j * marks[:, 1])
    sense = np.sign(np.angle(legs[1:] / legs[:-1]))
    off_rad = -sense * (turns.mean_rad + turns.random_rad * normal[:, : len(sense)])
    headings = np.exp(1j * np.concatenate([np.zeros((len(normal), 1)), np.cumsum(off_rad, axis=1)], axis=1))
    losses = np.array([0.0] + [turns.loss_m] * len(sense)) * legs / np.abs(legs)
    total = ((legs + losses) * headings - legs).sum(axis=1) * 100
    return np.stack([total.real, total.imag], axis=1)


@dataclass(frozen=True, slots=True)
class Needed:
    """Number that one column of the paper's tables needs."""

    what: str
    mean: float
    low: float
    high: float  # of the 95 % interval

    def overlaps(self, other: "Needed") -> bool:
        """Whether one number may explain both."""
        return self.low <= other.high and other.low <= self.high


def needed_radius() -> Needed:
    """Return the share by which the wheels must be larger than 45 mm for table 4."""
    shares = PAPER_CM[LINE_TABLE][:, 0] / 100 / np.array(LINE_M)
    return mean_of("line", shares)


def needed_twists() -> list[Needed]:
    """Return the twist of each turn that each column of tables 2, 3 and 5 needs, solved for each run."""
    found = []
    for pattern in TURNING:
        axes = ("y",) if pattern is BACK else ("x", "y")  # there and back, a twist changes x only by its square
        for axis in axes:
            sizes = PAPER_CM[pattern.table][:, "xy".index(axis)]
            twists = np.array([_twist_for(pattern, "xy".index(axis), size) for size in sizes])
            found.append(mean_of(f"table {pattern.table}, {axis}", twists))
    return found


@dataclass(frozen=True, slots=True)
class BestTurns:
    """Turn errors with the highest likelihood of the paper's means, and the probability of larger deviations."""

    turns: TurnErrors
    means_cm: _Array  # |x| and |y| of tables 2, 3, 5
    p_value: float  # share of drawn laboratories whose means deviate more than the paper's


def best_turns(*, has_loss: bool, draws: int = 4000) -> BestTurns:
    """Search a grid, with equal random numbers at each point."""
    normal = np.random.default_rng(1).standard_normal((len(TURNING), draws * RUNS, RUNS))
    paper = np.concatenate([PAPER_CM[pattern.table].mean(axis=0) for pattern in TURNING])
    grid = [
        TurnErrors(mean_rad=mean / 100, random_rad=random / 100, loss_m=loss / 100)
        for mean in range(13)
        for random in range(1, 19)
        for loss in (range(-30, 31, 5) if has_loss else (0,))
    ]
    likely = max(grid, key=lambda turns: _log_likelihood(paper, _means(turns, normal[:, : 400 * RUNS])))
    means = _means(likely, normal)
    distances, distance = _distances(means, means), _distances(means, paper[np.newaxis])[0]
    return BestTurns(likely, means.mean(axis=0), float((distances >= distance).mean()))


def chance_of_table_2(draws: int = 20000) -> tuple[float, TurnErrors]:
    """Return the highest probability of three runs like table 2 (|x| from 26, |y| up to 6 cm) and its turn errors."""
    normal = np.random.default_rng(2).standard_normal((draws, RUNS))
    grid = [TurnErrors(mean_rad=mean / 100, random_rad=random / 100) for mean in range(16) for random in range(19)]

    def chance(turns: TurnErrors) -> float:
        x_cm, y_cm = np.abs(errors_cm(SQUARE_LEFT, turns, normal)).T
        return float(((x_cm >= 26.0) & (x_cm <= 36.0) & (y_cm <= 6.0)).mean()) ** RUNS  # noqa: PLR2004 - table 2's

    best = max(grid, key=chance)
    return chance(best), best


def _means(turns: TurnErrors, normal: _Array) -> _Array:
    """Return the means of |x| and |y| of tables 2, 3, 5, one row for each drawn laboratory."""
    sizes = [np.abs(errors_cm(pattern, turns, normal[i])) for i, pattern in enumerate(TURNING)]
    return np.concatenate([size.reshape(-1, RUNS, 2).mean(axis=1) for size in sizes], axis=1)


def _covariance(means: _Array) -> _Array:
    """Return the covariance of the means, including the readings' errors."""
    covariance: _Array = np.cov(means.T) + np.eye(means.shape[1]) * _READING_CM**2
    return covariance


def _distances(means: _Array, points: _Array) -> _Array:
    off = points - means.mean(axis=0)
    squares: _Array = np.einsum("ij,jk,ik->i", off, np.linalg.inv(_covariance(means)), off)
    return squares


def _log_likelihood(paper: _Array, means: _Array) -> float:
    sign_and_log = np.linalg.slogdet(_covariance(means))
    return float(-_distances(means, paper[np.newaxis])[0] - sign_and_log[1])


def _twist_for(pattern: Pattern, axis: int, size_cm: float) -> float:
    twists = np.linspace(0.0, 0.3, 301)
    sizes = [abs(errors_cm(pattern, TurnErrors(mean_rad=twist), np.zeros((1, RUNS)))[0, axis]) for twist in twists]
    return float(np.interp(size_cm, sizes, twists))


def mean_of(what: str, values: _Array) -> Needed:
    """Return a mean and its 95 % interval."""
    mean, count = float(values.mean()), len(values)
    half = T_95.get(count - 1, _NORMAL_95) * float(values.std(ddof=1)) / count**0.5
    return Needed(what, mean, mean - half, mean + half)
