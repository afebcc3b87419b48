"""The component of the table [mqtt]."""

import asyncio
import contextlib
import importlib
import importlib.util
import time
from collections import deque
from collections.abc import Iterable
from typing import TYPE_CHECKING, ClassVar, Final

from hostlink.components.mqtt.commands import Commands
from hostlink.components.mqtt.discovery import OFFLINE, ONLINE
from hostlink.components.mqtt.retained import Publication, Retained
from hostlink.components.mqtt.settings import MqttSettings
from hostlink.components.mqtt.topics import Topics
from hostlink.core.host import Component, EventKind, Host, RobotEvent
from hostlink.errors import LibraryMissing

if TYPE_CHECKING:
    import aiomqtt

    from hostlink.components.mqtt.broker import Connection

MAX_ANSWERS: Final = 256  # that wait to be sent
REFUSALS_S: Final = 0.01  # between two answers to velocities
SHORTEST_S: Final = 0.2  # between two looks at all robots
ROBOTS_A_TURN: Final = 32
FAREWELL_S: Final = 1.0


class Mqtt(Component[MqttSettings]):
    """States of robots to a broker; stops, locks and, where it is switched on, velocities from it.

    One connection takes stops, locks and unlocks, in their order. Another one publishes and takes velocities, so that
    a flood of them delays no stop. The end of either ends the run, and with it what MQTT drives.
    """

    name = "mqtt"
    settings_type = MqttSettings
    log_events: ClassVar = {
        "mqtt.connected": "the broker has accepted the login, and commands are subscribed to",
        "mqtt.retained_found": "the broker keeps a command, which arrives again at each connection: remove it",
        "mqtt.subscription_refused": "the broker's access rules keep commands from hostlink",
    }

    def check(self) -> tuple[str, ...]:
        """Check the settings, and that the library is installed."""
        warnings = self.settings.check()
        if importlib.util.find_spec("aiomqtt") is None:
            raise LibraryMissing("mqtt", "aiomqtt", "mqtt")
        return warnings

    def describe(self) -> str:
        """One line for --check-config."""
        settings = self.settings
        login = f" as {settings.username}" if settings.username else ""
        takes = ["stop", "lock", *(["unlock"] if settings.unlock else []), *(["drive"] if settings.drive else [])]
        found = f", discovery under {settings.discovery_prefix}" if settings.discovery else ""
        return f"robots at {settings.broker}{login} under {settings.prefix}, takes {', '.join(takes)}{found}"

    async def run(self, host: Host) -> None:
        """Serve one connection to the broker."""
        await Run(host, self.settings).serve()


class Run:
    """One run: from a connection to its end."""

    def __init__(self, host: Host, settings: MqttSettings) -> None:
        self._host, self._settings = host, settings
        self._topics = Topics(settings.prefix)
        self._retained = Retained(settings, self._topics)
        self._answers: deque[tuple[str, bytes]] = deque()
        self._refused: dict[str, bytes] = {}
        self._answered, self._changed = asyncio.Event(), asyncio.Event()
        self._is_status_sent = False
        self._other = self._refused_topics = ""  # problems
        self._commands = Commands(host, settings, self._topics, self._answer, self._report, time.time)

    async def serve(self) -> None:
        """Connect and serve; returns by an error."""
        await asyncio.to_thread(importlib.import_module, "aiomqtt")  # blocks for some time
        import aiomqtt  # noqa: PLC0415 - an extra: `check` has looked for it

        from hostlink.components.mqtt.broker import connected, load_tls, read_password  # noqa: PLC0415 - the same

        settings = self._settings
        file = settings.password_file
        password = None if file is None else await asyncio.to_thread(read_password, file)
        tls = await asyncio.to_thread(load_tls, settings)
        will = aiomqtt.Will(self._topics.status, OFFLINE, qos=1, retain=True)
        control = connected(settings, self._receive, password=password, tls=tls)
        feed = connected(settings, self._receive, password=password, tls=tls, suffix="-feed", will=will)
        async with feed as feed_connection, control as control_connection:
            await self._subscribe(control_connection, feed_connection)
            try:
                self._host.log.info("mqtt.connected", broker=settings.broker, prefix=settings.prefix)
                self._host.spawn(control_connection.ended(), name="control")
                self._host.spawn(self._send_answers(feed_connection), name="answers")
                self._host.spawn(self._publish(feed_connection), name="states")
                await feed_connection.ended()
            finally:
                with contextlib.suppress(OSError):  # a TimeoutError, too
                    async with asyncio.timeout(FAREWELL_S):
                        await feed_connection.publish(self._topics.status, OFFLINE.encode(), retain=True, qos=1)

    async def _subscribe(self, control: "Connection", feed: "Connection") -> None:
        refused = await control.subscribe(self._topics.commands, qos=1)
        refused += await feed.subscribe([self._topics.drives], qos=0)
        found = [self._topics.availabilities, self._topics.status]
        refused += await feed.subscribe(found, qos=0, own=False, as_published=False)
        if refused:
            self._host.log.warning("mqtt.subscription_refused", topics=refused)
            user = self._settings.username or "hostlink"
            self._refused_topics = f"the broker does not permit {user} to read {refused[0]}: change its access rules"
        self._report()

    def _receive(self, message: "aiomqtt.Message") -> None:
        """Act on a message; in the turn in which it is read."""
        topic, payload = message.topic.value, bytes(message.payload)
        robot = self._topics.robot_of_availability(topic)
        if topic == self._topics.status:
            self._receive_status(payload, is_kept=message.retain)
        elif robot is None:
            self._commands.receive(topic, payload, retain=message.retain)
        else:
            self._retained.find(robot, payload, is_kept=message.retain, now_s=self._host.now_s)
            self._changed.set()

    def _receive_status(self, payload: bytes, *, is_kept: bool) -> None:
        """Read a status of another connection: the last will of an earlier run of ours, or another daemon."""
        if is_kept:
            return
        if payload == ONLINE.encode():
            self._other = f"another program publishes {self._topics.status}: give each daemon a prefix of its own"
            self._report()
        else:
            self._is_status_sent = False
            self._changed.set()

    def _report(self) -> None:
        self._host.report("; ".join(filter(None, (self._refused_topics, self._other, self._commands.problem))))

    def _answer(self, robot: str | None, payload: bytes, *, is_drive: bool) -> None:
        """Queue an answer. Of refused velocities only a robot's newest one waits, behind all other answers."""
        topic = self._topics.answer(robot)
        if is_drive:
            if self._refused.pop(topic, None) is not None:
                self._host.count("answers_replaced")
            waiting = len(self._refused)
        else:
            waiting = len(self._answers)
        if waiting >= MAX_ANSWERS:
            self._host.count("answers_dropped")
        elif is_drive:
            self._refused[topic] = payload
        else:
            self._answers.append((topic, payload))
        self._answered.set()

    async def _send_answers(self, feed: "Connection") -> None:
        while True:
            await self._answered.wait()
            self._answered.clear()
            while self._answers or self._refused:
                answer = self._answers.popleft() if self._answers else self._refused.popitem()
                await feed.publish(*answer)
                self._host.count("answers")
                if not self._answers:
                    await asyncio.sleep(REFUSALS_S)

    async def _publish(self, feed: "Connection") -> None:
        """Publish what has changed: SHORTEST_S after the last look if something happened, else at each interval."""
        self._host.observe(self._note)
        self._host.watch_graph(self._changed.set)
        shortest_s = min(SHORTEST_S, self._settings.interval_s)
        while True:
            self._changed.clear()
            if not self._is_status_sent:
                self._is_status_sent = True
                await feed.publish(self._topics.status, ONLINE.encode(), retain=True, qos=1)
            robots = self._host.robots()
            for number, robot in enumerate(robots, 1):
                await self._send(feed, self._retained.update(robot))
                if number % ROBOTS_A_TURN == 0:
                    await asyncio.sleep(0)
            present = {robot.name for robot in robots}
            await self._send(feed, self._retained.remove_others(present, now_s=self._host.now_s))
            self._commands.forget(present)
            await asyncio.sleep(shortest_s)
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(self._settings.interval_s - shortest_s):
                    await self._changed.wait()

    async def _send(self, feed: "Connection", publications: Iterable[Publication]) -> None:
        for each in publications:
            await feed.publish(each.topic, each.payload, retain=True)
            self._host.count("published" if each.payload else "cleared")

    def _note(self, event: RobotEvent) -> None:
        if event.kind is not EventKind.LOGGED:
            self._changed.set()
