"""The oracle of the simulated world notices a daemon that breaks a promise, with a seed that breaks it again."""

from collections.abc import Callable, Iterable
from typing import Any

import pytest

from hostlink.core.hub.gates import Gates
from hostlink.core.hub.participant import Participant
from hostlink.core.hub.queue import Queue
from hostlink.core.hub.stall_watch import StallWatch
from hostlink.core.hub.topic import Topic
from hostlink.core.robot.admission import Admission, Command, Decision
from hostlink.core.robot.velocity_gate import VelocityGate
from tests.support.simulation.run import Run, play

SECONDS = 8.0
SEEDS = 12


def skip_zeros(patch: pytest.MonkeyPatch) -> None:
    def stand(gate: VelocityGate[Any], _: float) -> None:
        gate._zeros = max(0, gate._zeros - 1)

    patch.setattr(VelocityGate, "_stand", stand)


def interrupt_nobody(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(Admission, "interrupt", lambda *_, **__: None)


def ignore_epochs(patch: pytest.MonkeyPatch) -> None:
    decide = Admission.decide

    def without(admission: Admission, command: Command[Any], now_s: float, **named: Any) -> Decision:
        epoch = None if command.epoch is None else admission.epoch
        return decide(admission, command._replace(epoch=epoch), now_s, **named)

    patch.setattr(Admission, "decide", without)


def extend_leases(patch: pytest.MonkeyPatch) -> None:
    make = Admission.__init__

    def longer(admission: Admission, *given: Any, **named: Any) -> None:
        make(admission, *given, **named)
        admission.lease_s = 0.7

    patch.setattr(Admission, "__init__", longer)


def lock_nothing(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(Admission, "lock", lambda admission, _reason, now_s, *, by=None: admission.interrupt(now_s, by=by))


def keep_who_left(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(Gates, "release", lambda *_: None)


def notice_no_pauses(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(StallWatch, "_notice", lambda *_: 0.0)
    patch.setattr(StallWatch, "late_s", lambda *_: 0.0)


def lose_messages(patch: pytest.MonkeyPatch) -> None:
    publish, numbers = Topic.publish, {"count": 0}

    def lossy(topic: Topic, payload: bytes, **named: Any) -> None:
        numbers["count"] += topic.name.endswith("count")
        if not topic.name.endswith("count") or numbers["count"] % 40:
            publish(topic, payload, **named)

    patch.setattr(Topic, "publish", lossy)


def lose_texts(patch: pytest.MonkeyPatch) -> None:
    publish, numbers = Participant.publish, {"text": 0}

    def lossy(participant: Participant, topic: str, payload: bytes, **named: Any) -> None:
        numbers["text"] += topic.endswith("text")
        if not topic.endswith("text") or numbers["text"] % 10:
            publish(participant, topic, payload, **named)

    patch.setattr(Participant, "publish", lossy)


def keep_queues(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(Queue, "release", lambda _: None)


def broken(mutate: Callable[[pytest.MonkeyPatch], None], promise: str, seeds: Iterable[int]) -> Run:
    """Return the first run of a changed daemon that breaks a promise."""
    for seed in seeds:
        with pytest.MonkeyPatch.context() as patch:
            mutate(patch)
            found = play(seed, SECONDS)
        if any(promise in text for text in found.broken):
            return found
    raise AssertionError(f"no seed breaks: {promise}")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mutate", "promise"),
    [
        (skip_zeros, "before a zero on a new connection"),
        (interrupt_nobody, "has not let go since"),
        (ignore_epochs, "has not let go since"),
        (extend_leases, "after its lease"),
        (lock_nothing, "while it is locked"),
        (keep_who_left, "its source has left"),
        (notice_no_pauses, "after its lease"),
        (notice_no_pauses, "has not let go since the pause"),
        (lose_messages, "on an intact connection"),
        (lose_texts, "is lost on an intact connection"),
        (keep_queues, "the byte budget holds"),
    ],
)
def test_oracle_names_the_promise_that_a_changed_daemon_breaks(
    mutate: Callable[[pytest.MonkeyPatch], None], promise: str
) -> None:
    found = broken(mutate, promise, range(SEEDS))
    again = broken(mutate, promise, [found.seed])
    assert again.broken == found.broken
    assert again.log == found.log
