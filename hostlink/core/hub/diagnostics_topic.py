"""DiagnosticsTopic: the findings of `hostlink doctor` as diagnostic_msgs/DiagnosticArray on /diagnostics.

The topic is published once a second while it has subscribers. Many robots are split into several arrays, each made in
a turn of its own; a reader joins them by name.
"""

import asyncio
import contextlib
import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping
from enum import IntEnum
from functools import partial
from typing import Any

from hostlink.core.diagnosis.finding import Finding
from hostlink.core.hub.diagnoses import Diagnosis
from hostlink.core.hub.participant import Participant
from hostlink.core.hub.robot import LocalRobot
from hostlink.core.hub.robots import Robots
from hostlink.core.hub.shared import Shared
from hostlink.core.messages.catalog import to_time
from hostlink.core.runtime.loop_time import loop_time_s
from hostlink.errors import HostlinkError

STALE_AFTER_S = 10.0  # a robot that reconnects sooner has only rebooted, or its network had a gap

Status = dict[str, Any]  # a DiagnosticStatus, to be encoded; the name of the node is put before its name

WARNINGS = frozenset(  # the device works in spite of these; every other finding is an error
    {
        "boot_noise", "wrong_size", "buffer_too_small", "unknown_ids", "battery_low", "watchdog_restart", "weak_signal",
        "clock_trouble", "damaged", "flashed_alike", "not_let_in", "odometry_jumps", "odometry_disagrees", "bad_stamp",
        "slash_frame", "zero_covariance", "odometry_unsent", "line_full", "no_reconnect", "too_many_endpoints",
        "best_effort_too_long", "message_too_long", "type_differs", "type_unknown", "types_by_reference",
        "best_effort_lost", "messages_resent", "publishes_wait", "slow_loop", "address_unverified",
    }
)  # fmt: skip

NODE = "hostlink"
INTERVAL_S = 1.0
ARRAY_STATUSES = 8  # of one array: a status takes about a tenth of a millisecond


class Level(IntEnum):
    """Level of a diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


def level_of(findings: Iterable[Finding]) -> Level:
    """Return the level of the worst finding."""
    return max((Level.WARN if each.code in WARNINGS else Level.ERROR for each in findings), default=Level.OK)


def robot_status(robot: LocalRobot, diagnosis: Diagnosis, now_s: float) -> Status:
    """Build the status of a robot whose device is connected."""
    lock = robot.gate.lock_reason
    odometry = robot.odometry.snapshot(now_s)
    figures = {
        "driver": robot.gate.owner_name or "nobody",
        "locked": "no" if lock is None else lock,
        "odometry rate (Hz)": "none" if odometry is None else f"{odometry.rate_hz:.1f}",
        "odometry age (s)": "none" if odometry is None else f"{odometry.age_s:.2f}",
    }
    return _connected(f"{robot.name} link", diagnosis, figures, "" if lock is None else f"locked: {lock}")


def absent_status(robot: LocalRobot, last: Diagnosis | None, now_s: float) -> Status:
    """Build the status of a robot without a device. `last`: of its last link, if that is known."""
    address, level, message = robot.config.address or "", Level.STALE, "not connected"
    if last is not None:
        gone_s, address = now_s - last.ended_at_s, last.link.address
        level = Level.STALE if gone_s >= STALE_AFTER_S else Level.ERROR
        message += f" for {gone_s:.0f} s" + ("" if last.end is None else f": {last.end.value}")
    return _status(f"{robot.name} link", level, message, address, {"locked": robot.gate.lock_reason or "no"})


def finding_status(name: str, hardware_id: str, found: Finding) -> Status:
    """Build the status of a serial port that cannot be opened, or of a part of the daemon."""
    return _status(name, Level.ERROR, _line(found), hardware_id, {"next step": found.next_step})


def _connected(name: str, diagnosis: Diagnosis, figures: Mapping[str, str], remark: str) -> Status:
    """Build the status of a connected device. `remark` is a text for people when nothing is wrong."""
    link, findings = diagnosis.link, diagnosis.findings
    level = max(level_of(findings), Level.WARN if remark else Level.OK)
    message = _line(findings[0]) if findings else remark or "connected"
    wrong = {each.code: f"{_line(each)}; next: {each.next_step}" for each in findings}
    return _status(name, level, message, link.address, {**wrong, **figures, **_link_figures(diagnosis)})


def _link_figures(diagnosis: Diagnosis) -> dict[str, str]:
    link = diagnosis.link
    facts = link.facts()
    counts = facts.counts
    signal_dbm = diagnosis.monitor.signal_dbm(link.opened_at_s + facts.seconds)
    round_trip_s = None if facts.clock is None else facts.clock.round_trip_s
    return {
        "peer": link.peer,
        "transport": link.kind,
        "connected (s)": f"{facts.seconds:.0f}",
        "silent (s)": f"{link.silent_s:.1f}",
        "topics": str(len(link.topics)),
        "frames from device": str(counts.frames_from_device),
        "frames to device": str(counts.frames_to_device),
        "bytes skipped": str(counts.skipped_bytes),
        "messages lost": str(counts.lost_messages),
        "negotiations": str(counts.negotiations),
        "commands replaced": str(facts.replaced),
        "longest wait (ms)": f"{facts.slowest_wait_s * 1e3:.1f}",
        **({} if round_trip_s is None else {"round trip (ms)": f"{round_trip_s * 1e3:.1f}"}),
        **({} if signal_dbm is None else {"WiFi signal (dBm)": str(signal_dbm)}),
    }


def _status(name: str, level: Level, message: str, hardware_id: str, values: Mapping[str, str]) -> Status:
    return {
        "level": int(level),
        "name": name,
        "message": message,
        "hardware_id": hardware_id,
        "values": [{"key": key, "value": value} for key, value in values.items()],
    }


def _line(found: Finding) -> str:
    return f"{found.cause} ({found.detail})" if found.detail else found.cause


TOPIC, TYPE = "/diagnostics", "diagnostic_msgs/DiagnosticArray"


class DiagnosticsTopic:
    """Publisher of the daemon's diagnostics."""

    def __init__(self, shared: Shared, robots: Robots, participant: Participant) -> None:
        self._shared, self._robots, self._participant = shared, robots, participant
        # The namespace distinguishes daemons that share the topic; a single daemon has "/".
        self._node = "/".join([NODE, *filter(None, shared.namespace.split("/"))])
        self._topic = self._participant.advertise(TOPIC, TYPE)

    async def run(self) -> None:
        """Publish until cancelled."""
        while True:
            if self._topic.has_subscribers:
                with self._shared.isolation.around("task", task="diagnostics"):
                    await self._publish()
            await asyncio.sleep(INTERVAL_S)

    async def _publish(self) -> None:
        makers = self._makers()
        while statuses := [self._named(make()) for make in itertools.islice(makers, ARRAY_STATUSES)]:
            if self._topic.type is None:
                return
            header = {"stamp": to_time(self._shared.wall_ns())}
            with contextlib.suppress(HostlinkError):  # a device that subscribes may not take it
                payload = self._topic.type.encode({"header": header, "status": statuses})
                self._participant.publish(TOPIC, payload)
            await asyncio.sleep(0)

    def _named(self, status: Status) -> Status:
        """Prefix the name as "node: component", the usual form by which an aggregator selects."""
        return {**status, "name": f"{self._node}: {status['name']}"}

    def _makers(self) -> Iterator[Callable[[], Status]]:
        """Yield a function for each status: the daemon, robots by name, other devices, ports, parts of the daemon."""
        yield self._daemon
        diagnoses, robots, now_s = self._shared.diagnoses, self._robots, loop_time_s()
        absent: dict[str, Diagnosis] = {each.robot: each for each in diagnoses.ended if each.robot}
        for robot in robots.here():
            diagnosis = None if robot.link is None else diagnoses.find(robot.link.number)
            if diagnosis is None:
                yield partial(absent_status, robot, absent.get(robot.name), now_s)
            else:
                yield partial(robot_status, robot, diagnosis, now_s)
        taken: set[str] = set()
        for diagnosis in diagnoses.live():
            if robots.of_link(diagnosis.link) is None:
                name = f"device {diagnosis.link.address}"
                name = f"{name} link {diagnosis.link.number}" if name in taken else name
                taken.add(name)
                yield partial(_connected, name, diagnosis, {}, "")
        for port, found in list(diagnoses.ports.items()):
            yield partial(finding_status, f"port {port}", port, found)
        for part, found in list(diagnoses.own.items()):
            yield partial(finding_status, part, "", found)

    def _daemon(self) -> Status:
        shared = self._shared
        robots, crashes = self._robots.here(), shared.isolation.crashes.total()
        counts = {
            "links": len(shared.diagnoses.live()),
            "robots": len(robots),
            "robots connected": sum(robot.link is not None for robot in robots),
            **{f"refused: {cause}": count for cause, count in shared.counts.refused.items()},
        }
        level = Level.ERROR if crashes else Level.OK
        message = f"{crashes} faults of hostlink itself: see its log" if crashes else "running"
        return _status("daemon", level, message, "", {name: str(count) for name, count in counts.items()})
