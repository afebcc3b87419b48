"""Plan of a calibration: order and space of its drives, the state file between them, and lengths that people enter."""

import os
from dataclasses import dataclass
from pathlib import Path

import msgspec

from hostlink.cli.files import writing
from hostlink.cli.output import quantity
from hostlink.client.course import Leg, square, straight, turns
from hostlink.core.runtime.whole_file import replace_file
from hostlink.errors import HostlinkError
from hostlink.workbench.calibration import MeasuredRun, RunKind, WheelGeometry

FORMAT = 1  # of the state file
SPARE_M = 0.5  # free floor beyond a course


class Sizes(msgspec.Struct, frozen=True):
    """Lengths and number of the drives."""

    length_m: float = 3.0
    side_m: float = 2.0
    turns: int = 5
    repeats: int = 2


class SavedCalibration(msgspec.Struct):
    """Content of the state file."""

    robot: str
    sizes: Sizes
    nominal: WheelGeometry
    runs: list[MeasuredRun] = []
    checks: list[MeasuredRun] = []
    format: int = FORMAT


@dataclass(frozen=True, slots=True)
class Step:
    """One drive of the plan."""

    kind: RunKind
    size: float

    @property
    def legs(self) -> tuple[Leg, ...]:
        """Course of the drive."""
        match self.kind:
            case RunKind.STRAIGHT:
                return straight(self.size)
            case RunKind.TURNS_CCW | RunKind.TURNS_CW:
                return turns(round(self.size), self.way)
            case _:
                return square(self.size, self.way)

    @property
    def way(self) -> int:
        """Direction: 1 counter-clockwise, -1 clockwise."""
        return -1 if self.kind in (RunKind.TURNS_CW, RunKind.SQUARE_CW) else 1

    @property
    def title(self) -> str:
        """Description of the drive."""
        way = "counter-clockwise" if self.way > 0 else "clockwise"
        match self.kind:
            case RunKind.STRAIGHT:
                return f"a line of {self.size:g} m"
            case RunKind.TURNS_CCW | RunKind.TURNS_CW:
                return f"{quantity(round(self.size), 'turn')} on the spot, {way}"
            case _:
                return f"a square of {self.size:g} m, {way}"

    @property
    def room(self) -> str:
        """Free floor that the drive needs."""
        match self.kind:
            case RunKind.STRAIGHT:
                return f"{self.size + SPARE_M:g} m of free floor before it"
            case RunKind.TURNS_CCW | RunKind.TURNS_CW:
                return "half a metre of free floor around it"
            case _:
                side = "left" if self.way > 0 else "right"
                return f"{self.size + SPARE_M:g} m of free floor before it and to its {side}"


@dataclass(slots=True)
class StateFile:
    """File that keeps the measurements of a calibration between two drives."""

    path: Path
    saved: SavedCalibration

    def save(self) -> None:
        """Write the whole file or nothing.

        Raises:
            HostlinkError: the file cannot be written.
        """
        with writing(self.path, "name another file with --state"):
            self.path.parent.mkdir(parents=True, exist_ok=True)
            replace_file(self.path, msgspec.json.encode(self.saved))

    def remove(self) -> None:
        """Remove the file of a finished calibration."""
        self.path.unlink(missing_ok=True)


def default_path(robot: str) -> Path:
    """Return the usual state file of a robot, in the user's state folder (XDG)."""
    home = os.environ.get("XDG_STATE_HOME") or "~/.local/state"
    name = "".join(char if char.isalnum() or char in "-_." else "_" for char in robot)
    return Path(home).expanduser() / "hostlink" / f"calibrate-{name}.json"


def open_state(path: Path, wanted: SavedCalibration, *, anew: bool) -> StateFile:
    """Open the state file of the same calibration, or begin a new one.

    Raises:
        HostlinkError: the file has drives of another calibration, or is not a state file, which `anew` keeps too.
    """
    try:
        data = path.read_bytes()
        saved = wanted if anew and not data else msgspec.json.decode(data, type=SavedCalibration)
    except (FileNotFoundError, NotADirectoryError):  # the error of writing says what is wrong with the folder
        saved = wanted
    except (OSError, msgspec.DecodeError) as error:
        raise HostlinkError(
            f"{path} is not the state file of a calibration ({error}); name another with --state, or remove it"
        ) from error
    if anew:
        return StateFile(path, wanted)
    same = ("robot", "sizes", "nominal", "format")
    differs = [name for name in same if getattr(saved, name) != getattr(wanted, name)]
    if differs and saved.runs:
        raise HostlinkError(f"{path} has a calibration with another {' and '.join(differs)}; --anew begins again")
    return StateFile(path, saved if saved.runs else wanted)


def steps_of(sizes: Sizes) -> list[Step]:
    """Return the drives that are measured."""
    return [
        *[Step(RunKind.STRAIGHT, sizes.length_m)] * sizes.repeats,
        *([Step(RunKind.TURNS_CCW, sizes.turns), Step(RunKind.TURNS_CW, sizes.turns)] if sizes.turns else []),
        *[Step(RunKind.SQUARE_CW, sizes.side_m), Step(RunKind.SQUARE_CCW, sizes.side_m)] * sizes.repeats,
    ]


def checks_of(sizes: Sizes) -> list[Step]:
    """Return the drives that must confirm the result."""
    kinds = ((RunKind.STRAIGHT, sizes.length_m), (RunKind.SQUARE_CW, sizes.side_m), (RunKind.SQUARE_CCW, sizes.side_m))
    return [Step(kind, size) for kind, size in kinds]
