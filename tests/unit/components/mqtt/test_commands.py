"""Commands: which messages act, which are refused, and what is answered."""

import json
from collections import Counter
from collections.abc import Coroutine, Iterator
from typing import Any

import pytest
import structlog
from hypothesis import given
from hypothesis import strategies as st

from hostlink.components.mqtt.commands import MAX_MEASURED, Commands
from hostlink.components.mqtt.settings import MqttSettings
from hostlink.components.mqtt.topics import Topics
from hostlink.core.host import PlanarVelocity, RobotState, Stopped
from hostlink.errors import CommandRefused, RefusalKind, UnknownTopic
from tests.unit.components.mqtt.robots import robot

NOW_S = 1_800_000_000.0


class Turn:
    """One turn of waiting."""

    def __await__(self) -> Iterator[None]:
        yield


class Source:
    """A participant that notes whether it has left."""

    has_left = False

    def leave(self) -> None:
        self.has_left = True


class FakeHost:
    """The part of Host that commands use. `done` has what acted, in order."""

    def __init__(self) -> None:
        self.done: list[tuple[Any, ...]] = []
        self.counts: Counter[str] = Counter()
        self.problem = ""
        self.callers: set[str] = set()
        self.sources: list[Source] = []
        self.lock_refusal: CommandRefused | None = None
        self.tasks: list[Coroutine[Any, Any, None]] = []
        self.log = structlog.get_logger()

    def robot(self, name: str) -> RobotState:
        if name != "a":
            raise UnknownTopic("robot", name, ["a"])
        return robot("a", epoch=7)

    async def stop(self, name: str | None = None, *, by: str, wait_s: float) -> Stopped:
        self.callers.add(by)
        self.done.append(("stop", name, wait_s))
        if name is not None:
            self.robot(name)
        if wait_s:
            await Turn()  # the odometry's answer
        return Stopped({}, ())

    async def lock(self, name: str | None = None, *, reason: str, by: str) -> tuple[str, ...]:
        self.callers.add(by)
        self.done.append(("lock", name, reason))
        return ()

    async def unlock(self, name: str | None = None, *, by: str) -> None:
        self.callers.add(by)
        self.done.append(("unlock", name))

    def join(self, name: str) -> Source:
        self.callers.add(name)
        self.sources.append(Source())
        return self.sources[-1]

    def drive(self, source: Source, name: str, velocity: PlanarVelocity, *, sent_s: float, epoch: int | None) -> None:
        assert not source.has_left
        if self.lock_refusal:
            raise self.lock_refusal
        self.done.append(("drive", name, velocity, sent_s, epoch))

    def spawn(self, work: Coroutine[Any, Any, None], *, name: str) -> None:
        assert name
        self.tasks.append(work)

    def count(self, what: str) -> None:
        self.counts[what] += 1

    def report(self, problem: str) -> None:
        self.problem = problem


class World:
    """Commands with their host and their answers."""

    def __init__(self, **settings: Any) -> None:
        self.host, self.answers = FakeHost(), []
        made = MqttSettings(**settings)
        parts = (self.host, made, Topics("hostlink"), self._answer, self._report, lambda: NOW_S)
        self.commands = Commands(*parts)  # type: ignore[arg-type]

    def _report(self) -> None:
        self.host.report(self.commands.problem)

    def _answer(self, name: str | None, payload: bytes, *, is_drive: bool) -> None:
        assert is_drive == (json.loads(payload)["command"] == "drive")
        self.answers.append((name, json.loads(payload)))

    def receive(self, topic: str, payload: str | bytes = b"", *, retain: bool = False) -> None:
        """Receive a message, and run what it spawns to its end."""
        data = payload.encode() if isinstance(payload, str) else payload
        self.commands.receive(f"hostlink/{topic}", data, retain=retain)
        tasks, self.host.tasks = self.host.tasks, []
        for each in tasks:
            while not _is_done(each):
                pass

    @property
    def done(self) -> list[tuple[Any, ...]]:
        return self.host.done


def drive(**fields: Any) -> str:
    return json.dumps({"linear": 0.2, "sent_s": NOW_S, **fields})


@pytest.mark.parametrize("retain", [False, True])
@given(payload=st.binary(max_size=3000))
def test_stop_and_lock_act_with_any_payload(retain: bool, payload: bytes) -> None:
    world = World()
    world.receive("robots/a/stop", payload, retain=retain)
    world.receive("stop", payload, retain=retain)
    world.receive("robots/a/lock", payload, retain=retain)
    world.receive("lock", payload, retain=retain)
    assert [each[:2] for each in world.done] == [("stop", "a"), ("stop", None), ("lock", "a"), ("lock", None)]
    assert world.host.counts["retained_obeyed"] == (4 if retain else 0)


@pytest.mark.parametrize("topic", ["robots/a/unlock", "unlock", "robots/a/set_lock", "robots/a/drive"])
def test_retained_unlock_and_drive_are_refused_and_counted(topic: str) -> None:
    world = World(drive=True)
    payload = drive() if topic.endswith("drive") else "UNLOCK"
    world.receive(topic, payload, retain=True)
    assert world.done == []
    assert world.host.counts["retained_refused"] == 1
    ((_, answer),) = world.answers
    assert (answer["ok"], "publish it without retain" in answer["reason"]) == (False, True)


def test_retained_command_is_reported_until_it_is_removed() -> None:
    world = World()
    world.receive("robots/a/unlock", "x", retain=True)
    assert world.host.problem.endswith("remove it with  mosquitto_pub -r -n -t hostlink/robots/a/unlock")
    world.receive("robots/a/unlock", "", retain=True)
    assert world.host.problem == ""
    assert len(world.answers) == 1  # of the first: the removal is not a command
    assert world.host.counts["retained_removed"] == 1


@pytest.mark.parametrize(
    ("payload", "done"),
    [("LOCK", [("lock", "a", "locked by MQTT")]), ("UNLOCK", [("unlock", "a")]), ("open", []), ("", [])],
)
def test_set_lock_is_that_of_home_assistant(payload: str, done: list[tuple[Any, ...]]) -> None:
    world = World()
    world.receive("robots/a/set_lock", payload)
    assert world.done == done
    assert world.host.counts["malformed"] == (0 if done else 1)
    assert world.answers[0][1]["ok"] == bool(done)


def test_unlock_can_be_switched_off() -> None:
    world = World(unlock=False)
    world.receive("robots/a/unlock")
    world.receive("robots/a/set_lock", "UNLOCK")
    assert world.done == []
    assert all("does not unlock by MQTT" in answer["reason"] for _, answer in world.answers)


def test_drive_is_off_by_default() -> None:
    world = World()
    world.receive("robots/a/drive", drive())
    assert (world.done, world.host.sources) == ([], [])
    assert world.answers == [
        (
            "a",
            {
                "command": "drive",
                "ok": False,
                "kind": "BadRequest",
                "reason": "driving by MQTT is off: set drive = true in [mqtt]",
                "epoch": 7,
            },
        )
    ]


def test_drive_has_the_time_and_the_epoch_of_its_sender() -> None:
    world = World(drive=True)
    world.receive("robots/a/drive", drive(angular=-0.5, linear_y=0.1, epoch=7))
    world.receive("robots/a/drive", drive(sent_s=NOW_S - 0.9))
    assert world.done == [
        ("drive", "a", PlanarVelocity(0.2, 0.1, -0.5), NOW_S, 7),
        ("drive", "a", PlanarVelocity(0.2, 0.0, 0.0), NOW_S - 0.9, None),
    ]
    assert (world.answers, len(world.host.sources)) == ([], 1)


@pytest.mark.parametrize(
    ("payload", "kind", "reason"),
    [
        ('{"linear": 0.2}', "BadPayload", "missing required field `sent_s`"),
        (drive(sent_s=NOW_S - 1.1), "BadRequest", "sent_s is 1.1 s before this computer's time, max_age_s is 1"),
        (drive(sent_s=NOW_S + 5), "BadRequest", "sent_s is 5.0 s after this computer's time"),
        (drive(sent_s=12.5), "BadRequest", "it must be the time of sending in seconds since 1970"),
        ("go", "BadPayload", "malformed"),
        ("[" * 1025, "BadPayload", "1025 bytes"),
    ],
)
def test_drive_that_cannot_be_obeyed_is_answered(payload: str, kind: str, reason: str) -> None:
    world = World(drive=True)
    world.receive("robots/a/drive", payload)
    assert world.done == []
    ((name, answer),) = world.answers
    assert (name, answer["kind"], reason in answer["reason"]) == ("a", kind, True), answer


def test_refusal_has_the_kind_and_who_drives() -> None:
    world = World(drive=True)
    world.host.lock_refusal = CommandRefused("a", RefusalKind.HELD, "teleop drives it", by="teleop")
    world.receive("robots/a/drive", drive())
    ((_, answer),) = world.answers
    assert (answer["kind"], answer["by"], answer["epoch"]) == ("held", "teleop", 7)


def test_unknown_robot_is_answered_and_gets_no_source() -> None:
    world = World(drive=True)
    world.receive("robots/b/drive", drive())
    world.receive("robots/b/stop")
    assert [answer["kind"] for _, answer in world.answers] == ["UnknownTopic", "UnknownTopic"]
    assert world.host.sources == []


def test_source_leaves_with_its_robot() -> None:
    world = World(drive=True)
    world.receive("robots/a/drive", drive())
    world.commands.forget({"a"})
    assert not world.host.sources[0].has_left
    world.commands.forget(set())
    assert world.host.sources[0].has_left


def test_other_topics_are_counted() -> None:
    world = World()
    world.receive("robots/a/state", "{}")
    assert (world.host.counts, world.answers) == ({"unknown_topics": 1}, [])


def test_stops_of_a_flood_act_and_do_not_wait_for_the_odometry() -> None:
    world = World()
    for _ in range(MAX_MEASURED + 3):
        world.commands.receive("hostlink/robots/a/stop", b"", retain=False)
    waiting = [each for each in world.host.tasks if not _is_done(each)]
    assert [wait_s > 0 for _, _, wait_s in world.done] == [True] * MAX_MEASURED + [False] * 3
    assert len(waiting) == MAX_MEASURED
    for each in waiting:
        each.close()


def _is_done(work: Coroutine[Any, Any, None]) -> bool:
    try:
        work.send(None)
    except StopIteration:
        return True
    return False


@given(
    st.lists(
        st.tuples(
            st.sampled_from(
                ["stop", "lock", "unlock", "robots/a/stop", "robots/a/set_lock", "robots/a/drive", "robots/x/y", ""]
            ),
            st.binary(max_size=64) | st.sampled_from([b"LOCK", b"UNLOCK", b'{"sent_s": 1800000000.0}']),
            st.booleans(),
        )
    )
)
def test_any_messages_end_nothing_and_each_refusal_is_answered(messages: list[tuple[str, bytes, bool]]) -> None:
    world = World(drive=True)
    for topic, payload, retain in messages:
        world.receive(topic, payload, retain=retain)
    assert world.host.callers <= {"MQTT"}
    assert world.host.counts["refused"] == sum(not answer["ok"] for _, answer in world.answers)
