"""Diagnoses of links: findings become events and log lines once, ended links are kept, topics are remembered."""

import asyncio
from typing import Any

import pytest

from hostlink.core.diagnosis.finding import Finding
from hostlink.core.hub.diagnoses import ENDED_LINKS, LOG_AGAIN_S, MAX_ANNOUNCED, Diagnosis
from hostlink.core.protocol.endpoint import EndpointKind
from hostlink.core.protocol.rosserial.control import encode_topic_info
from hostlink.core.protocol.rosserial.frame import encode
from hostlink.core.robot.events import EventKind, RobotEvent
from tests.support.fake_device import robot_topics, topic
from tests.support.memory_hub import MemoryHub, in_hub
from tests.support.scripted_device import ScriptedDevice

HOT = Finding("hot", "the motor is hot", "let it cool down", "80 degrees")
COLD = Finding("cold", "the motor is cold", "warm it up", "")


async def diagnosis_of(made: MemoryHub, device: ScriptedDevice) -> Diagnosis:
    found = made.hub.diagnoses.find(device.link.number)
    assert found is not None
    return found


def with_findings(made: MemoryHub, monkeypatch: pytest.MonkeyPatch) -> list[Finding]:
    """Let each diagnosis have the findings of the returned list."""
    findings: list[Finding] = []
    monkeypatch.setattr("hostlink.core.hub.diagnoses.diagnose", lambda _: list(findings))
    return findings


def test_finding_is_an_event_and_a_log_line_once_while_it_lasts(monkeypatch: pytest.MonkeyPatch) -> None:
    async def test(made: MemoryHub) -> None:
        findings, heard = with_findings(made, monkeypatch), list[RobotEvent]()
        device = await made.connect(peer="10.0.0.2:7")
        made.hub.join("reader").observe(heard.append)
        findings.append(HOT)
        await asyncio.sleep(3.0)
        assert made.hub.diagnoses.of(device.link) == [HOT]
        findings.append(COLD)
        await asyncio.sleep(3.0)
        events = [each for each in heard if each.kind is EventKind.DIAGNOSED]
        assert [(each.robot, each.facts["code"]) for each in events] == [("robot_0", "hot"), ("robot_0", "cold")]
        assert events[0].facts == {
            "link": 1, "code": "hot", "cause": "the motor is hot", "next_step": "let it cool down",
            "detail": "80 degrees",
        }  # fmt: skip
        lines = made.logged("link.diagnosed")
        assert [(each["code"], each["peer"], each["link"]) for each in lines] == [
            ("hot", "10.0.0.2:7", 1), ("cold", "10.0.0.2:7", 1),
        ]  # fmt: skip

    in_hub(test)


def test_finding_that_returns_is_logged_again_only_after_a_minute(monkeypatch: pytest.MonkeyPatch) -> None:
    async def test(made: MemoryHub) -> None:
        findings = with_findings(made, monkeypatch)
        device = await made.connect()
        for lines, pause_s in ((1, 2.0), (1, LOG_AGAIN_S), (2, 2.0)):
            findings.append(HOT)
            await asyncio.sleep(2.0)
            assert len(made.logged("link.diagnosed")) == lines
            findings.clear()
            await asyncio.sleep(pause_s)
        assert made.hub.diagnoses.of(device.link) == []

    in_hub(test)


def test_last_ended_links_are_kept_with_their_end_and_duration() -> None:
    async def test(made: MemoryHub) -> None:
        for number in range(ENDED_LINKS + 2):
            device = await made.connect(robot_topics(f"robot_{number}"), address=f"10.0.1.{number}")
            await asyncio.sleep(1.0)
            await device.aclose()
            await asyncio.sleep(0.1)
        diagnoses = made.hub.diagnoses
        assert diagnoses.numbers() == list(range(3, ENDED_LINKS + 3))
        assert (diagnoses.find(2), diagnoses.live()) == (None, [])
        last = diagnoses.find(ENDED_LINKS + 2)
        assert last is not None
        assert last.end is not None
        assert (last.end.value, last.robot) == ("peer_closed", f"robot_{ENDED_LINKS + 1}")
        assert last.seconds == pytest.approx(1.05, abs=0.1)
        assert last.baud is None
        live = await made.connect(address="10.0.2.1")
        assert diagnoses.find(live.link.number) is diagnoses.live()[0]
        assert diagnoses.of(device.link) == []

    in_hub(test)


def encoded(infos: Any) -> bytes:
    return b"".join(encode(info.kind, encode_topic_info(info)) for info in infos)


def test_announcements_are_remembered_by_their_place_in_the_stream() -> None:
    async def test(made: MemoryHub) -> None:
        device = await made.connect()
        found = await diagnosis_of(made, device)
        assert set(found.topics) == set(device.infos)
        assert found.announced_before(0) == encoded(found.topics)
        places, announced = [device.link.session.counts.bytes_from_device], [found.topics]
        for number in range(MAX_ANNOUNCED):
            device.infos.append(topic(EndpointKind.PUBLISHER, 200 + number, f"/extra_{number}", "std_msgs/Bool"))
            for _ in range(2):  # the second time unchanged: no other announcement
                await device.announce()
                await asyncio.sleep(1.5)
            places.append(device.link.session.counts.bytes_from_device)
            announced.append(found.topics)
        assert set(found.topics) == set(device.infos)
        assert len(found._announced) == MAX_ANNOUNCED
        for place, topics in zip(places[1:], announced[1:], strict=True):
            assert found.announced_before(place) == encoded(topics)
        assert found.announced_before(0) == encoded(announced[1])  # the first is forgotten

    in_hub(test)


def test_same_device_has_the_address_and_the_robot_or_the_topics() -> None:
    async def test(made: MemoryHub) -> None:
        text = [topic(EndpointKind.PUBLISHER, 125, "/text", "std_msgs/String")]
        devices = [
            await made.connect(infos, address=address)
            for infos, address in (
                (robot_topics("a"), "10.0.0.2"),
                (robot_topics("b"), "10.0.0.2"),
                (text, "10.0.0.3"),
                (text, "10.0.0.3"),
                (text, "10.0.0.4"),
                ([topic(EndpointKind.PUBLISHER, 125, "/other", "std_msgs/String")], "10.0.0.3"),
            )
        ]
        a, b, *others = [await diagnosis_of(made, each) for each in devices]
        assert a.is_same_device(a)
        assert not a.is_same_device(b)
        first, same, elsewhere, other = others
        assert first.is_same_device(same)
        assert not first.is_same_device(elsewhere)
        assert not first.is_same_device(other)

    in_hub(test)


def test_port_that_cannot_be_opened_is_a_finding_until_it_is() -> None:
    async def test(made: MemoryHub) -> None:
        diagnoses = made.hub.diagnoses
        diagnoses.observe_port("/dev/ttyACM0", FileNotFoundError(2, "no such port"))
        diagnoses.observe_port("/dev/ttyACM1", None)
        assert list(diagnoses.ports) == ["/dev/ttyACM0"]
        diagnoses.observe_port("/dev/ttyACM0", None)
        assert diagnoses.ports == {}

    in_hub(test)


def test_renamed_robot_says_whose_name_it_wanted() -> None:
    async def test(made: MemoryHub) -> None:
        first = await made.connect(address="10.0.0.2")
        second = await made.connect(address="10.0.0.3")
        assert (await diagnosis_of(made, first)).renaming() == ""
        assert (await diagnosis_of(made, second)).renaming() == "robot_0 is another device's name; this is robot_0_2"

    in_hub(test)
