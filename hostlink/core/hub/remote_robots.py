"""RemoteRobots: the robots that one run of a component announces."""

import re
from collections.abc import Hashable

from hostlink.core.hub.gates import Gates
from hostlink.core.hub.providers import Provision
from hostlink.core.hub.remote_robot import RemoteRobot
from hostlink.core.hub.robots import Robots
from hostlink.core.hub.topic_graph import TopicGraph
from hostlink.core.robot.state import RobotState
from hostlink.errors import BadRequest

MAX_REMOTE = 4096  # robots of all components


class RemoteRobots:
    """Robots that one run of a component announces. They are withdrawn with the run."""

    def __init__(self, robots: Robots, gates: Gates, graph: TopicGraph, provision: Provision) -> None:
        """Reach the provider from now on."""
        self._robots, self._gates, self._graph, self._provision = robots, gates, graph, provision
        self._has_ended = False
        self._has_lost = False  # robots that it announced until the end
        gates.providers.add(provision)

    def announce(self, known: RobotState, *, host: str, place: Hashable = "") -> RemoteRobot:
        """Announce a robot, which is not connected yet. Its name is that of `known`.

        An earlier robot of this name is replaced: its drivers still drive it. `host` names its host, as users see it.

        Raises:
            BadRequest: the run has ended, the name is invalid, another component announces it, or there are too many.
        """
        name = known.name
        before = self._robots.remote.get(name)
        if self._has_ended:
            raise BadRequest(f"robot {name}: the run of {self._provision.name} has ended")
        if re.fullmatch(r"\w{1,64}", name, re.ASCII) is None:
            raise BadRequest(f"robot {name!r}: a name has 1 to 64 letters, digits and _")
        if before is not None and before.provision is not self._provision:
            raise BadRequest(f"robot {name}: {before.provision.name} announces it already")
        if before is None and len(self._robots.remote) >= MAX_REMOTE:
            raise BadRequest(f"robot {name}: more than {MAX_REMOTE} robots are announced")
        robot = RemoteRobot(
            known,
            host=host,
            place=place,
            provision=self._provision,
            gates=self._gates,
            graph=self._graph,
            new_number=self._robots.new_number,
        )
        if before is not None:
            robot.admission = before.admission
        self._robots.put_remote(robot)
        return robot

    def get(self, name: str) -> RemoteRobot | None:
        """Return the robot of this name; None if the run announces none."""
        robot = self._robots.remote.get(name)
        return robot if robot is not None and robot.provision is self._provision else None

    def all(self) -> list[RemoteRobot]:
        """Return all robots of the run."""
        return [each for each in self._robots.remote.values() if each.provision is self._provision]

    def withdraw(self, name: str) -> None:
        """Announce a robot no longer. Do nothing if the run announces none of this name."""
        if self.get(name) is not None:
            self._robots.pop_remote(name)

    def withdraw_all(self) -> None:
        """Announce no robot any longer. What a source here drives is released."""
        for robot in self.all():
            self._has_lost = True
            robot.release_driver()
            self._robots.pop_remote(robot.name)

    def close(self, *, is_resumed: bool) -> None:
        """Withdraw all robots; the provider is not reached again. Called by the daemon at the end of the run.

        `is_resumed`: another run follows. Until then a stop or a lock of all is an error, if there was a robot.
        """
        self._has_ended = True
        self.withdraw_all()
        if is_resumed and self._has_lost:
            self._provision.has_ended = True
        else:
            self._gates.providers.remove(self._provision)
