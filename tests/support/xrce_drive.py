"""Drive: a stock micro-ROS board and a session over a link with faults, in virtual time. The host commands the board.

The board publishes an Odometry and an Imu at 50 Hz reliably, and each publish blocks until it is acknowledged.
"""

import contextlib
import math
import struct
from random import Random

from hostlink.core.messages.catalog import Catalog
from hostlink.core.protocol.xrce.protocol import MICRO_ROS_UDP
from hostlink.core.protocol.xrce.session import XrceSession
from hostlink.errors import HostlinkError
from tests.support.xrce_board import Client, Datagrams, Link, Program, Published, Stock, World
from tests.support.xrce_device import cdr

CATALOG = Catalog()
COMMAND_S = 0.05
KEY = (0x01020304).to_bytes(4)
ODOMETRY = cdr("nav_msgs/Odometry", {"header": {"frame_id": "odom"}, "child_frame_id": "base_link"})
IMU = cdr("sensor_msgs/Imu", {"header": {"frame_id": "imu_link"}})


class Drive:
    """A board that drives: each velocity has the time at which it was commanded."""

    def __init__(
        self,
        link: Link,
        *,
        has_reconnect: bool = False,
        turn_s: float = 0.0,
        period_s: float = 0.02,
        command_s: float = COMMAND_S,
        kind: type[Stock] = Stock,
        session: XrceSession | None = None,
        transport: Datagrams | None = None,
        damage: float = 0.0,
    ) -> None:
        self.client = Client(key=KEY)
        self.board = kind(self.client, ODOMETRY, IMU, restarts=has_reconnect, turn_s=turn_s, period_s=period_s)
        session = session or MICRO_ROS_UDP.session(CATALOG)
        self.world = World(session, self.board.run(), self.client, link, transport, damage)
        self.stops_at_s = math.inf
        self.commanded_s: list[float] = []
        self._command_s = command_s
        self.world.at(0.0, self._command)

    def _command(self) -> None:
        world, velocity = self.world, struct.pack("<6d", self.world.now_s, 0, 0, 0, 0, 0)
        if world.now_s >= self.stops_at_s:
            return
        if world.is_host_there and world.session.topics:
            with contextlib.suppress(HostlinkError):
                world.session.publish("/cmd_vel", velocity, is_urgent=True)
                self.commanded_s.append(world.now_s)
            world.write()
        world.at(world.now_s + self._command_s, self._command)

    def stop_at(self, at_s: float) -> None:
        """Send the last velocity before that time, and a zero then."""

        def stop() -> None:
            world = self.world
            assert world.session.send_zero(world.session.endpoint_of("/cmd_vel", bytes(48)), bytes(48))
            world.write()

        self.stops_at_s = at_s
        self.world.at(at_s, stop)

    @property
    def stood_s(self) -> float:
        """Time after the stop at which the board took the zero behind which it took no other velocity."""
        last, at_s = self.board.taken[-1][1], math.inf
        for taken_s, velocity in reversed(self.board.taken):
            if velocity != 0.0:
                break
            at_s = taken_s
        return at_s - self.stops_at_s if last == 0.0 else math.inf

    @property
    def ages_s(self) -> list[float]:
        """Ages of the velocities when the board took them, sorted."""
        return sorted(at_s - commanded_s for at_s, commanded_s in self.board.taken)

    def published(self, since_s: float = 0.0) -> list[Published]:
        return [each for each in self.board.published if each.at_s >= since_s]

    def taken_since(self, since_s: float) -> int:
        return sum(at_s >= since_s for at_s, _ in self.board.taken)

    def restart_board(self, at_s: float, away_s: float) -> None:
        """Switch the board off at that time, and on again later with another key."""
        world = self.world

        def begin() -> None:
            client = Client(key=b"boot")
            self.board = Stock(client, ODOMETRY, IMU, restarts=True, begun=0x0A0B0C0D, taken=self.board.taken)
            world.restart_board(client, self.board.run())

        world.at(at_s, lambda: world.restart_board(Client(key=KEY), _off()))
        world.at(at_s + away_s, begin)

    def restart_host(self, at_s: float, away_s: float, *, has_state: bool) -> None:
        """End the host at that time, and start it again later, with or without what it has stored."""
        world = self.world

        def restart() -> None:
            session = resumed(world.session) if has_state else MICRO_ROS_UDP.session(CATALOG)
            world.restart_host(session, away_s=away_s)

        world.at(at_s, restart)

    def is_usable(self, since_s: float) -> bool:
        """Whether the board has published and taken velocities since then, on all of its topics."""
        names = {each.name for each in self.world.session.topics}
        is_publishing = any(each.is_done for each in self.published(since_s))
        return (
            is_publishing and self.taken_since(since_s) > 0 and names == {"/odom/unfiltered", "/imu/data", "/cmd_vel"}
        )

    def run_until_usable(self, within_s: float) -> float:
        """Let both sides live until the board is usable again. Return the seconds that it took."""
        world, since_s = self.world, self.world.now_s
        while not self.is_usable(since_s):
            assert world.now_s < since_s + within_s, (self.board.failed_at, world.session.topics)
            world.run(world.now_s + 0.05)
        return world.now_s - since_s


def played(
    seed: int,
    seconds: float = 8.0,
    *,
    turn_s: float = 0.0,
    period_s: float = 0.02,
    **faults: float,
) -> Drive:
    """Drive a board for some seconds over a link with these faults."""
    drive = Drive(Link(Random(seed), **faults), turn_s=turn_s, period_s=period_s)  # type: ignore[arg-type]
    drive.world.run(seconds)
    assert drive.board.is_running, drive.board.failed_at
    return drive


def resumed(session: XrceSession) -> XrceSession:
    """A session that continues from what the earlier one had stored."""
    return MICRO_ROS_UDP.resumed(CATALOG, session.memory())


def _off() -> Program:
    """The program of a board that is off."""
    while True:
        yield -1e9
