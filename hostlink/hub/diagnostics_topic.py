"""DiagnosticsTopic: what `hostlink doctor` finds, once a second as diagnostic_msgs/DiagnosticArray on /diagnostics.

Nothing is made while nobody subscribes. A crowd of robots is several arrays, each made in a turn of its own: who reads
them joins them by the names.
"""

import asyncio
import contextlib
import itertools
import time
from collections import Counter
from collections.abc import Callable, Iterator
from functools import partial

from hostlink.errors import HostlinkError
from hostlink.hub.diagnoses import Diagnoses, Diagnosis
from hostlink.hub.diagnostic_status import (
    Status,
    absent_status,
    daemon_status,
    device_status,
    port_status,
    robot_status,
)
from hostlink.hub.isolation import Isolation
from hostlink.hub.participant import Participant
from hostlink.hub.robot import LocalRobot
from hostlink.hub.robots import Robots

TOPIC, TYPE = "/diagnostics", "diagnostic_msgs/DiagnosticArray"
NODE = "hostlink"
INTERVAL_S = 1.0
ARRAY_STATUSES = 8  # of one array: a status takes about a tenth of a millisecond
_NS_PER_S = 1_000_000_000


class DiagnosticsTopic:
    """Publishes for the whole daemon."""

    def __init__(
        self,
        participant: Participant,
        diagnoses: Diagnoses,
        robots: Robots,
        isolation: Isolation,
        refused: Counter[str],
        namespace: str,
    ) -> None:
        """`namespace`: of the node in a graph where several daemons share the topic; "/": of the only one."""
        self._participant = participant
        self._node = "/".join([NODE, *filter(None, namespace.split("/"))])
        self._diagnoses, self._robots, self._isolation = diagnoses, robots, isolation
        self._refused = refused
        self._topic = participant.advertise(TOPIC, TYPE)

    async def run(self) -> None:
        """Publish until cancelled."""
        while True:
            with self._isolation.around("task", task="diagnostics"):
                await self._publish()
            await asyncio.sleep(INTERVAL_S)

    async def _publish(self) -> None:
        makers = self._makers() if self._topic.has_subscribers else iter(())
        while statuses := [self._named(make()) for make in itertools.islice(makers, ARRAY_STATUSES)]:
            if self._topic.type is None:
                return
            secs, nsecs = divmod(time.time_ns(), _NS_PER_S)
            header = {"stamp": {"secs": secs, "nsecs": nsecs}}
            with contextlib.suppress(HostlinkError):  # a device that subscribes may not take it
                payload = self._topic.type.encode({"header": header, "status": statuses})
                self._participant.publish(TOPIC, payload)
            await asyncio.sleep(0)

    def _named(self, status: Status) -> Status:
        """`node: component` is the usual form of a name, by which an aggregator selects."""
        return {**status, "name": f"{self._node}: {status['name']}"}

    def _makers(self) -> Iterator[Callable[[], Status]]:
        """What makes each status: the daemon's first, then robots by name, other devices, ports."""
        yield self._daemon
        now_s = asyncio.get_running_loop().time()
        absent: dict[str, Diagnosis] = {each.robot: each for each in self._diagnoses.ended if each.robot}
        for robot in self._robots.here():
            diagnosis = None if robot.link is None else self._diagnoses.find(robot.link.number)
            if diagnosis is None:
                yield partial(_absent, robot, absent.get(robot.name), now_s)
            else:
                yield partial(robot_status, robot, diagnosis, now_s)
        taken: set[str] = set()
        for diagnosis in self._diagnoses.live():
            if self._robots.of_link(diagnosis.link) is None:
                name = f"device {diagnosis.link.address}"
                name = f"{name} link {diagnosis.link.number}" if name in taken else name
                taken.add(name)
                yield partial(device_status, name, diagnosis)
        for port, found in list(self._diagnoses.ports.items()):
            yield partial(port_status, port, found)

    def _daemon(self) -> Status:
        robots = self._robots.here()
        counts = {
            "links": len(self._diagnoses.live()),
            "robots": len(robots),
            "robots connected": sum(robot.link is not None for robot in robots),
        }
        return daemon_status(counts, self._refused, self._isolation.crashes.total())


def _absent(robot: LocalRobot, last: Diagnosis | None, now_s: float) -> Status:
    address = robot.config.address or ""
    if last is None:
        return absent_status(robot, address, None, "")
    why = "" if last.end is None else last.end.value
    return absent_status(robot, last.link.address, now_s - last.ended_at_s, why)
