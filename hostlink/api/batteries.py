"""Batteries: the newest voltage of each robot that publishes one, for /metrics."""

import asyncio
import math
from typing import Any

from hostlink.errors import HostlinkError
from hostlink.hub.graph import OBSERVERS
from hostlink.hub.hub import Hub
from hostlink.hub.message import Message
from hostlink.hub.participant import Participant
from hostlink.hub.robot_events import EventKind, RobotEvent
from hostlink.messages.message_type import MessageType

BATTERY_TYPE = "sensor_msgs/BatteryState"


class Batteries:
    """One subscription a robot, as long as its device is there. Nothing is decoded before somebody reads it."""

    def __init__(self, hub: Hub) -> None:
        self._hub = hub
        self._newest: dict[str, bytes] = {}
        self._subscribers: dict[str, Participant] = {}
        hub.join_daemon().observe(self._receive)

    def volts(self) -> dict[str, float]:
        """Of the robots that are connected; one that measures none has no voltage."""
        found: dict[str, float] = {}
        type_ = self._hub.catalog.message(BATTERY_TYPE)
        for robot, payload in self._newest.items():
            voltage = math.nan if type_ is None else _voltage(type_, payload)
            if math.isfinite(voltage):
                found[robot] = voltage
        return found

    def _receive(self, event: RobotEvent) -> None:
        if event.kind is EventKind.GONE:
            self._forget(event.robot)
        elif event.kind is EventKind.APPEARED:
            self._forget(event.robot)
            asyncio.get_running_loop().call_soon(self._subscribe, event.robot)  # when the graph has its topics

    def _forget(self, robot: str) -> None:
        self._newest.pop(robot, None)
        subscriber = self._subscribers.pop(robot, None)
        if subscriber is not None:
            subscriber.leave()

    def _subscribe(self, name: str) -> None:
        robot = self._hub.robots.get_here(name)
        link = None if robot is None else robot.link
        if link is None:
            return
        topics = [info.name for info in link.topics if info.type == BATTERY_TYPE and not info.is_to_device]

        def receive(message: Message) -> None:
            if message.source is link:
                self._newest[name] = message.payload

        for topic in topics[:1]:
            self._forget(name)
            self._subscribers[name] = self._hub.join_daemon(group=OBSERVERS)
            self._subscribers[name].subscribe(self._hub.links.shown_name(link, topic), receive, type_name=BATTERY_TYPE)


def _voltage(type_: MessageType, payload: bytes) -> float:
    """NaN: it measures none, or the message is damaged."""
    try:
        found: Any = type_.decode(payload)["voltage"]
    except HostlinkError:
        return math.nan
    return float(found)
