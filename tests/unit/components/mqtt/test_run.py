"""A run without a broker: bounds of the answers, problems that are reported, statuses of others."""

from collections import Counter
from typing import Any

import aiomqtt
import structlog

from hostlink.components.mqtt.mqtt import MAX_ANSWERS, Run
from hostlink.components.mqtt.settings import MqttSettings
from tests.support.virtual_loop import run_virtual


class FakeHost:
    """The part of Host that a run uses before its tasks begin."""

    now_s = 0.0

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()
        self.problem = "of an earlier run"
        self.log = structlog.get_logger()

    def count(self, what: str) -> None:
        self.counts[what] += 1

    def report(self, problem: str) -> None:
        self.problem = problem


class FakeConnection:
    """A broker that refuses some filters and notes what is published."""

    def __init__(self, *refused: str) -> None:
        self.refused = refused
        self.published: list[tuple[str, bytes]] = []

    async def subscribe(self, filters: list[str], **_: Any) -> list[str]:
        return [each for each in filters if each in self.refused]

    async def publish(self, topic: str, payload: bytes, **_: Any) -> None:
        self.published.append((topic, payload))
        if len(self.published) == 3:
            raise ConnectionError("enough")


def run(**settings: Any) -> tuple[Any, FakeHost]:
    host = FakeHost()
    return Run(host, MqttSettings(**settings)), host  # type: ignore[arg-type]


def message(topic: str, payload: bytes, *, retain: bool = False) -> aiomqtt.Message:
    return aiomqtt.Message(topic, payload, 0, retain, 1, None)


def test_answers_are_bounded_and_the_excess_is_counted() -> None:
    made, host = run()
    for _ in range(MAX_ANSWERS + 5):
        made._answer(None, b"{}", is_drive=False)
    assert (len(made._answers), host.counts["answers_dropped"]) == (MAX_ANSWERS, 5)


def test_refused_velocities_wait_behind_other_answers_and_only_the_newest_of_a_robot() -> None:
    made, host = run()
    made._answer("a", b"1", is_drive=True)
    made._answer("a", b"2", is_drive=True)
    made._answer("b", b"3", is_drive=True)
    made._answer("a", b"stop", is_drive=False)
    feed = FakeConnection()

    async def send() -> None:
        try:
            await made._send_answers(feed)
        except ConnectionError:
            return

    run_virtual(send())
    assert feed.published == [
        ("hostlink/robots/a/answer", b"stop"),
        ("hostlink/robots/b/answer", b"3"),
        ("hostlink/robots/a/answer", b"2"),
    ]
    assert host.counts["answers_replaced"] == 1


def test_refused_subscription_is_reported() -> None:
    made, host = run(username="robots")
    run_virtual(made._subscribe(FakeConnection("hostlink/stop"), FakeConnection()))
    assert host.problem == "the broker does not permit robots to read hostlink/stop: change its access rules"


def test_connection_without_a_problem_clears_the_report() -> None:
    made, host = run()
    run_virtual(made._subscribe(FakeConnection(), FakeConnection()))
    assert host.problem == ""


def test_status_of_another_daemon_is_reported_and_a_last_will_is_corrected() -> None:
    made, host = run()
    made._is_status_sent = True
    made._receive(message("hostlink/status", b"online", retain=True))  # of an earlier run
    assert (host.problem, made._is_status_sent) == ("of an earlier run", True)
    made._receive(message("hostlink/status", b"online"))
    assert "give each daemon a prefix of its own" in host.problem
    made._receive(message("hostlink/status", b"offline"))
    assert not made._is_status_sent
