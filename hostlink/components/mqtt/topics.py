"""Names of MQTT topics, in both directions. Pure."""

import re
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

ROBOT = re.compile(r"[A-Za-z0-9_]{1,64}")


class Verb(StrEnum):
    """Last level of a command's topic."""

    STOP = "stop"
    LOCK = "lock"
    UNLOCK = "unlock"
    SET_LOCK = "set_lock"
    DRIVE = "drive"


OF_ALL: Final = (Verb.STOP, Verb.LOCK, Verb.UNLOCK)
OF_ROBOT: Final = (*OF_ALL, Verb.SET_LOCK)


@dataclass(frozen=True, slots=True)
class Request:
    """A command's topic, parsed. `robot` is None for all robots."""

    verb: Verb
    robot: str | None


@dataclass(frozen=True, slots=True)
class Topics:
    """Topics below a prefix."""

    prefix: str

    @property
    def status(self) -> str:
        """Whether the daemon is connected."""
        return f"{self.prefix}/status"

    def state(self, robot: str) -> str:
        """State of a robot."""
        return f"{self.prefix}/robots/{robot}/state"

    def availability(self, robot: str) -> str:
        """Whether the robot is connected."""
        return f"{self.prefix}/robots/{robot}/availability"

    def answer(self, robot: str | None) -> str:
        """Answers to commands for a robot, or for all."""
        return f"{self.prefix}/answer" if robot is None else f"{self.prefix}/robots/{robot}/answer"

    def command(self, robot: str, verb: Verb) -> str:
        """Topic on which a robot takes a command."""
        return f"{self.prefix}/robots/{robot}/{verb}"

    @property
    def commands(self) -> list[str]:
        """Filters of stops, locks and unlocks."""
        return [f"{self.prefix}/{verb}" for verb in OF_ALL] + [self.command("+", verb) for verb in OF_ROBOT]

    @property
    def drives(self) -> str:
        """Filter of velocities."""
        return self.command("+", Verb.DRIVE)

    @property
    def availabilities(self) -> str:
        """Filter of what earlier runs have published about robots."""
        return self.availability("+")

    def parse(self, topic: str) -> Request | None:
        """Return the command that a topic names; None if it names none."""
        if not topic.startswith(f"{self.prefix}/"):
            return None
        match topic[len(self.prefix) + 1 :].split("/"):
            case [verb] if verb in OF_ALL:
                return Request(Verb(verb), None)
            case ["robots", robot, verb] if verb in (*OF_ROBOT, Verb.DRIVE) and ROBOT.fullmatch(robot):
                return Request(Verb(verb), robot)
        return None

    def robot_of_availability(self, topic: str) -> str | None:
        """Return the robot of an availability's topic; None if it is another topic."""
        match topic.removeprefix(f"{self.prefix}/").split("/"):
            case ["robots", robot, "availability"] if ROBOT.fullmatch(robot):
                return robot
        return None
