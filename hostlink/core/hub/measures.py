"""Measures: counters and readings of the daemon, its robots and its links as values, for `GET /metrics`."""

import dataclasses
from collections import Counter
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, NamedTuple

from hostlink.core.link.link import LinkFacts
from hostlink.core.robot.odometry import OdometrySnapshot
from hostlink.core.robot.velocity import PlanarVelocity
from hostlink.core.runtime.latency import Latency
from hostlink.core.runtime.loop_time import loop_time_s
from hostlink.errors import RefusalKind

if TYPE_CHECKING:
    from hostlink.core.hub.hub import Hub


class Kept(NamedTuple):
    """Use of one share of the budget of bytes that strangers make the daemon keep."""

    held_bytes: int
    refused: int  # items for which there was no room


class DaemonMeasures(NamedTuple):
    """Counters of the daemon since its start, and what is connected."""

    links: int
    crashes: Mapping[str, int]  # by what they ended
    messages_unheard: int  # of devices whose topics were not known in time
    device_calls_refused: int
    late_answers: int  # of devices' services
    messages_out_of_order: int
    refused: Mapping[str, int]  # connections, by cause
    datagrams_dropped: Mapping[str, int]  # by cause
    components: Mapping[str, Mapping[str, int]]  # counters of each component
    fleet_robots: Mapping[str, int]  # connected robots of other daemons, by host
    robots_forgotten: int
    kept: Mapping[str, Kept]  # by kind


class RobotMeasures(NamedTuple):
    """Counters and readings of one robot of this daemon."""

    name: str
    is_connected: bool
    odometry: OdometrySnapshot | None
    velocities_refused: int  # by its device
    unreadable: int  # messages of its odometry
    outcomes: Mapping[str, int]  # of commands at its gate
    refusals: Mapping[RefusalKind, int]  # of its admission
    is_locked: bool
    is_driven: bool
    commanded: PlanarVelocity
    battery_v: float | None


class LinkMeasures(NamedTuple):
    """Counters and readings of one live link."""

    address: str
    robot: str  # empty: it has none
    facts: LinkFacts
    silent_s: float
    command_latency: Latency  # from a velocity command to the device's socket


class Measures:
    """Reads the counters where they are counted: none exists twice."""

    def __init__(self, hub: "Hub") -> None:
        self._hub = hub

    def daemon(self) -> DaemonMeasures:
        """Return the counters of the daemon."""
        hub = self._hub
        return DaemonMeasures(
            links=len(hub.links.all()),
            crashes=dict(hub.isolation.crashes),
            messages_unheard=hub.links.undelivered,
            device_calls_refused=hub.links.calls.refused,
            late_answers=hub.links.late_answers,
            messages_out_of_order=hub.topics.deliveries.out_of_order,
            refused=dict(hub.counts.refused),
            datagrams_dropped=dict(hub.counts.datagrams_dropped),
            components={name: dict(read()) for name, read in hub.counts.components.items()},
            fleet_robots=Counter(robot.host for robot in hub.robots.remote.values() if robot.link),
            robots_forgotten=hub.robots.forgotten,
            kept={kind: Kept(share.held_bytes, share.refused) for kind, share in hub.budget.shares.items()},
        )

    def robots(self) -> Iterator[RobotMeasures]:
        """Yield the robots of this daemon by name. Each is read when it is asked for: the work can be spread."""
        for robot in self._hub.robots.here():
            gate, battery = robot.gate, robot.battery
            yield RobotMeasures(
                name=robot.name,
                is_connected=robot.link is not None,
                odometry=robot.odometry.snapshot(loop_time_s()),
                velocities_refused=robot.refusals.count,
                unreadable=robot.unreadable,
                outcomes=dataclasses.asdict(gate.counts),
                refusals=dict(gate.admission.refused),
                is_locked=gate.lock_reason is not None,
                is_driven=gate.owner is not None,
                commanded=gate.current,
                battery_v=None if battery is None else battery.voltage_v,
            )

    def links(self) -> Iterator[LinkMeasures]:
        """Yield the live links, oldest first; as `robots`."""
        for device in list(self._hub.robots.devices.values()):
            link, robot = device.link, device.robot
            name = "" if robot is None else robot.name
            yield LinkMeasures(link.address, name, link.facts(), link.silent_s, link.command_latency)
