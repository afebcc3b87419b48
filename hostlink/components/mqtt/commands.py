"""Commands that arrive by MQTT: which act, which are refused, and their answers."""

from collections import Counter
from collections.abc import Callable, Coroutine
from typing import Any, Final, Protocol

from hostlink.components.mqtt import payloads
from hostlink.components.mqtt.discovery import LOCK, UNLOCK
from hostlink.components.mqtt.payloads import MAX_PAYLOAD_BYTES, encode_answer
from hostlink.components.mqtt.settings import MqttSettings
from hostlink.components.mqtt.topics import Request, Topics, Verb
from hostlink.core.host import Host, Participant
from hostlink.errors import BadPayload, BadRequest, CommandRefused, HostlinkError

BY: Final = "MQTT"
MEASURED_S: Final = 1.5  # a stop's wait for the odometry
MAX_MEASURED: Final = 4  # stops of one target that wait for its odometry; more are answered without it
MAX_RETAINED: Final = 16  # topics that are reported


class Answer(Protocol):
    """Queue an answer about a robot, or about all; `is_drive`: it refuses a velocity, as many others may."""

    def __call__(self, robot: str | None, payload: bytes, *, is_drive: bool) -> None: ...


class Commands:
    """Everything that a message may ask for. `receive` acts in the turn in which a message is read.

    | message | live | retained | retained and empty: removes what the broker has kept |
    |---|---|---|---|
    | stop, lock | acts with any payload | acts: a stop too many is safe | acts |
    | unlock, drive | acts | refused: the time of its sending is unknown | ignored |
    """

    def __init__(
        self,
        host: Host,
        settings: MqttSettings,
        topics: Topics,
        answer: Answer,
        report: Callable[[], None],
        wall_s: Callable[[], float],
    ) -> None:
        self._host, self._settings, self._topics = host, settings, topics
        self._answer, self._report, self._wall_s = answer, report, wall_s
        self._participants: dict[str, Participant] = {}
        self._measured: Counter[str | None] = Counter()
        self._retained: set[str] = set()

    def receive(self, topic: str, payload: bytes, *, retain: bool) -> None:
        """Act on a message."""
        request = self._topics.parse(topic)
        if request is None:
            self._host.count("unknown_topics")
            return
        verb = self._verb(request, payload)
        if retain:
            self._note_retained(topic, payload)
        match verb:
            case Verb.STOP:
                self._count("stops", retain)
                self._spawn(self._stop(request.robot), "stop")
            case Verb.LOCK:
                self._count("locks", retain)
                reason = payloads.parse_reason(b"" if request.verb is Verb.SET_LOCK else payload)
                self._spawn(self._lock(request.robot, reason), "lock")
            case Verb.UNLOCK | Verb.DRIVE if retain and not payload:
                self._host.count("retained_removed")
            case Verb.UNLOCK | Verb.DRIVE if retain:
                self._host.count("retained_refused")
                self._refuse(
                    request, BadRequest("the message is retained, so it may be old: publish it without retain")
                )
            case Verb.UNLOCK:
                self._unlock(request, payload)
            case Verb.DRIVE:
                self._drive(request, payload)
            case _:
                self._host.count("malformed")
                self._refuse(request, BadPayload(Verb.SET_LOCK, f"the payload must be {LOCK} or {UNLOCK}"))

    def forget(self, robots: set[str]) -> None:
        """Leave as the source of all robots but these."""
        for name in self._participants.keys() - robots:
            self._participants.pop(name).leave()

    @staticmethod
    def _verb(request: Request, payload: bytes) -> Verb | None:
        """Return what to do; None for a set_lock that says neither."""
        if request.verb is not Verb.SET_LOCK:
            return request.verb
        return {LOCK.encode(): Verb.LOCK, UNLOCK.encode(): Verb.UNLOCK}.get(payload[:MAX_PAYLOAD_BYTES].strip().upper())

    def _count(self, what: str, retain: bool) -> None:
        self._host.count(what)
        if retain:
            self._host.count("retained_obeyed")

    def _note_retained(self, topic: str, payload: bytes) -> None:
        """Report a command that the broker keeps. An empty retained message is one that removes it."""
        if not payload:
            self._retained.discard(topic)
        elif len(self._retained) < MAX_RETAINED and topic not in self._retained:
            self._retained.add(topic)
            self._host.log.warning("mqtt.retained_found", topic=topic)
        self._report()

    @property
    def problem(self) -> str:
        """Text for `hostlink doctor`; empty if the broker keeps no command."""
        if not self._retained:
            return ""
        topic = min(self._retained)
        more = f" and {len(self._retained) - 1} more" if len(self._retained) > 1 else ""
        return f"the broker keeps a command on {topic}{more}: remove it with  mosquitto_pub -r -n -t {topic}"

    def _spawn(self, work: Coroutine[Any, Any, None], name: str) -> None:
        self._host.spawn(work, name=name)

    async def _stop(self, robot: str | None) -> None:
        self._measured[robot] += 1
        wait_s = MEASURED_S if self._measured[robot] <= MAX_MEASURED else 0.0
        try:
            stopped = await self._host.stop(robot, by=BY, wait_s=wait_s)
        except HostlinkError as error:
            self._refuse(Request(Verb.STOP, robot), error)
            return
        finally:
            self._measured[robot] -= 1
            if not self._measured[robot]:
                del self._measured[robot]
        robots = {name: str(standstill.state) for name, standstill in list(stopped.robots.items())[:64]}
        self._accept(Verb.STOP, robot, robots=robots, unreached=list(stopped.unreached[:64]) or None)

    async def _lock(self, robot: str | None, reason: str) -> None:
        try:
            unreached = await self._host.lock(robot, reason=reason, by=BY)
        except HostlinkError as error:
            self._refuse(Request(Verb.LOCK, robot), error)
            return
        self._accept(Verb.LOCK, robot, reason=reason, unreached=list(unreached[:64]) or None)

    def _unlock(self, request: Request, payload: bytes) -> None:
        if not self._settings.unlock:
            self._refuse(request, BadRequest("this daemon does not unlock by MQTT: use `hostlink unlock`"))
        elif len(payload) > MAX_PAYLOAD_BYTES:
            self._host.count("too_large")
            self._refuse(
                request, BadPayload(Verb.UNLOCK, f"{len(payload)} bytes, at most {MAX_PAYLOAD_BYTES} are taken")
            )
        else:
            self._host.count("unlocks")
            self._spawn(self._unlocked(request.robot), "unlock")

    async def _unlocked(self, robot: str | None) -> None:
        try:
            await self._host.unlock(robot, by=BY)
        except HostlinkError as error:
            self._refuse(Request(Verb.UNLOCK, robot), error)
            return
        self._accept(Verb.UNLOCK, robot)

    def _drive(self, request: Request, payload: bytes) -> None:
        robot = request.robot
        assert robot is not None  # noqa: S101 - by `Topics.parse`
        try:
            if not self._settings.drive:
                raise BadRequest("driving by MQTT is off: set drive = true in [mqtt]")
            drive = payloads.parse_drive(payload)
            self._check_age(drive.sent_s)
            if robot not in self._participants:
                self._host.robot(robot)  # before a participant is made for any name
                self._participants[robot] = self._host.join(BY)
            self._host.drive(self._participants[robot], robot, drive.velocity, sent_s=drive.sent_s, epoch=drive.epoch)
        except HostlinkError as error:
            if isinstance(error, BadPayload):
                self._host.count("malformed")
            self._refuse(request, error)
            return
        self._host.count("drives")

    def _check_age(self, sent_s: float) -> None:
        """Refuse a command that a broker or a sender has kept: hostlink can only compare the commands of one clock."""
        age_s = self._wall_s() - sent_s
        if abs(age_s) > self._settings.max_age_s:
            raise BadRequest(
                f"sent_s is {abs(age_s):.1f} s {'before' if age_s > 0 else 'after'} this computer's time, max_age_s is "
                f"{self._settings.max_age_s:g}: it must be the time of sending in seconds since 1970; set the clock"
            )

    def _accept(self, verb: Verb, robot: str | None, **facts: object) -> None:
        self._answer(robot, encode_answer(verb, ok=True, **facts), is_drive=False)

    def _refuse(self, request: Request, error: HostlinkError) -> None:
        self._host.count("refused")
        kind = str(error.kind)
        holder = str(error.by) if isinstance(error, CommandRefused) and error.by else None
        answer = encode_answer(
            request.verb, ok=False, kind=kind, reason=str(error), by=holder, epoch=self._epoch(request)
        )
        self._answer(request.robot, answer, is_drive=request.verb is Verb.DRIVE)

    def _epoch(self, request: Request) -> int | None:
        if request.verb is not Verb.DRIVE or request.robot is None:
            return None
        try:
            return self._host.robot(request.robot).epoch
        except HostlinkError:
            return None
