"""Journal: all that happened in a run, in order: lines of text, and records for the oracle."""

from collections.abc import Mapping
from typing import Any, NamedTuple


class Opened(NamedTuple):
    """A board's connection has reached the daemon."""

    at_s: float
    connection: int
    robot: str
    is_clean: bool  # its line damages nothing
    held_s: float = 0.0  # for so long a velocity may wait until the board has read the one before


class Appeared(NamedTuple):
    """The daemon says that a robot is connected."""

    at_s: float
    robot: str


class Ended(NamedTuple):
    """The daemon can write no more to a connection."""

    at_s: float
    connection: int


class Stuck(NamedTuple):
    """A connection takes nothing from the daemon, or takes bytes again."""

    at_s: float
    connection: int
    is_stuck: bool


class Written(NamedTuple):
    """The daemon, or its guardian, has written a velocity to a board."""

    at_s: float
    connection: int
    robot: str
    number: int  # of the command; 0: a zero
    by_guardian: bool


class Obeyed(NamedTuple):
    """A board has another velocity."""

    at_s: float
    robot: str
    linear_m_s: float
    angular_rad_s: float


class Rebooted(NamedTuple):
    """A board has lost what it had read, and perhaps kept its connection."""

    at_s: float
    robot: str


class Given(NamedTuple):
    """The component has given a command to the daemon."""

    at_s: float
    arrived_s: float  # at this computer
    source: int  # connection of the program
    robot: str
    number: int  # 0: a zero
    sent_s: float
    tells_sent: bool
    learned_s: float | None  # when the daemon told the epoch that the command carries


class Interrupted(NamedTuple):
    """The component has stopped, locked or unlocked a robot; "" is every robot."""

    at_s: float
    arrived_s: float
    robot: str
    what: str
    source: int


class Answered(NamedTuple):
    """A stop has ended with what odometry said."""

    at_s: float
    began_s: float
    robot: str
    state: str


class Left(NamedTuple):
    """The component has ended a source."""

    at_s: float
    source: int


class Paused(NamedTuple):
    """The daemon's loop did not run."""

    at_s: float  # its end
    began_s: float


class Began(NamedTuple):
    """A daemon runs, or has ended."""

    at_s: float
    is_begun: bool
    was_killed: bool


class Counted(NamedTuple):
    """A numbered message has arrived."""

    at_s: float
    connection: int
    stream: str
    number: int


class Failed(NamedTuple):
    """A promise was broken that needs no history."""

    at_s: float
    promise: str


Record = (
    Opened
    | Appeared
    | Ended
    | Stuck
    | Written
    | Obeyed
    | Rebooted
    | Given
    | Interrupted
    | Answered
    | Left
    | Paused
    | Began
    | Counted
    | Failed
)


class Journal:
    """Lines and records of one run."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.records: list[Record] = []

    def add(self, record: Record) -> None:
        """Add a record, and its line."""
        self.records.append(record)
        self.lines.append(f"{record.at_s:.6f} {record}")

    def say(self, at_s: float, what: str, **facts: object) -> None:
        """Add a line."""
        self.lines.append(f"{at_s:.6f} {what} {_text(facts)}")

    def log(self, at_s: float, event: Mapping[str, Any]) -> None:
        """Add a line of the daemon's log."""
        facts = {key: value for key, value in event.items() if key != "event"}
        self.say(at_s, f"log {event['event']}", **facts)

    @property
    def text(self) -> str:
        """All lines."""
        return "\n".join(self.lines) + "\n"


def _text(facts: Mapping[str, Any]) -> str:
    return " ".join(f"{key}={facts[key]!r}" for key in sorted(facts))
