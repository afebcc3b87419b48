"""/diagnostics: what doctor finds, as rqt_runtime_monitor and diagnostic_aggregator read it."""

import asyncio
from typing import Any

from hostlink.core.config import Config
from hostlink.core.diagnosis.evidence import HostClock
from hostlink.core.diagnosis.finding import words
from hostlink.core.hub.diagnostics_topic import ARRAY_STATUSES, INTERVAL_S, STALE_AFTER_S, TOPIC, TYPE, WARNINGS
from hostlink.core.hub.hub import Hub
from hostlink.core.hub.message import Message
from hostlink.core.hub.participant import Participant
from hostlink.core.messages.catalog import Catalog
from hostlink.core.protocol.endpoint import EndpointKind
from hostlink.core.protocol.rosserial.control import Log
from hostlink.core.protocol.rosserial.frame import Id
from tests.support.device_codec import encode_log
from tests.support.fake_device import robot_topics, topic
from tests.support.scripted_device import ScriptedDevice
from tests.support.virtual_loop import run_virtual

OK, WARN, ERROR, STALE = 0, 1, 2, 3  # as in diagnostic_msgs/DiagnosticStatus
Statuses = dict[str, dict[str, Any]]


class Reader:
    """Reads all arrays; `statuses` are the last of each name."""

    def __init__(self, participant: Participant) -> None:
        self.arrays: list[dict[str, Any]] = []
        self.statuses: Statuses = {}
        self.subscription = participant.subscribe(TOPIC, self._receive)

    def _receive(self, message: Message) -> None:
        array = message.type.decode(message.payload)
        self.arrays.append(array)
        self.statuses |= {status["name"]: status for status in array["status"]}


def values_of(status: dict[str, Any]) -> dict[str, str]:
    return {each["key"]: each["value"] for each in status["values"]}


class SteadyClock(HostClock):
    """Advance the wall clock in virtual time."""

    def check(self, now_s: float, wall_ns: int) -> str:  # noqa: ARG002 - as the real one
        return ""


async def in_a_hub(config: Config, play: Any) -> None:
    hub = Hub(config, Catalog(), reraises=True)
    hub.diagnoses._clock = SteadyClock()
    async with asyncio.TaskGroup() as tasks:
        running = tasks.create_task(hub.run())
        await hub.is_running.wait()
        await asyncio.sleep(0)
        await play(hub)
        running.cancel()


def test_a_status_for_the_daemon_its_parts_each_robot_each_other_device_and_each_port() -> None:
    async def play(hub: Hub) -> None:
        reader = Reader(hub.join("a monitor"))
        robot = ScriptedDevice(hub, robot_topics(), address="192.168.4.2", peer="192.168.4.2:5000")
        lamp = ScriptedDevice(
            hub, [topic(EndpointKind.SUBSCRIBER, 100, "/led", "std_msgs/Bool")], address="192.168.4.3"
        )
        hub.diagnoses.observe_port("/dev/ttyACM0", FileNotFoundError(2, "no such port"))
        hub.diagnoses.observe_own("recordings", "recordings_taken", "by another daemon")
        for _ in range(30):
            await robot.send(Id.LOG, encode_log(Log(1, "WiFi signal -61 dBm")))
            await lamp.send(Id.LOG, encode_log(Log(1, "well")))
            await asyncio.sleep(0.1)
        names = set(reader.statuses)
        assert names == {
            "hostlink: daemon",
            "hostlink: robot_0 link",
            "hostlink: device 192.168.4.3",
            "hostlink: port /dev/ttyACM0",
            "hostlink: recordings",
        }
        taken = reader.statuses["hostlink: recordings"]
        assert (taken["level"], taken["hardware_id"]) == (ERROR, "")
        assert values_of(taken)["next step"].startswith("give this daemon a folder of its own")
        of_robot = reader.statuses["hostlink: robot_0 link"]
        assert (of_robot["level"], of_robot["message"]) == (OK, "connected")
        assert of_robot["hardware_id"] == "192.168.4.2"
        values = values_of(of_robot)
        assert values["peer"] == "192.168.4.2:5000"
        assert values["driver"] == "nobody"
        assert values["WiFi signal (dBm)"] == "-61"
        assert int(values["frames from device"]) > 10
        assert "WiFi signal (dBm)" not in values_of(reader.statuses["hostlink: device 192.168.4.3"])
        assert reader.statuses["hostlink: port /dev/ttyACM0"]["level"] == ERROR
        assert values_of(reader.statuses["hostlink: daemon"])["links"] == "2"
        await robot.aclose()
        await lamp.aclose()

    run_virtual(in_a_hub(Config(), play))


def test_a_finding_is_the_message_and_its_next_step_a_value() -> None:
    async def play(hub: Hub) -> None:
        reader = Reader(hub.join("a monitor"))
        robot = ScriptedDevice(hub, robot_topics(), address="192.168.4.2")
        await asyncio.sleep(0.1)
        await robot.send(Id.LOG, encode_log(Log(3, "battery low: 9.4 V")))
        await asyncio.sleep(2.5)
        status = reader.statuses["hostlink: robot_0 link"]
        assert status["level"] == WARN
        assert status["message"].startswith(words()["battery_low"]["cause"])
        assert "battery low: 9.4 V" in status["message"]
        assert words()["battery_low"]["next_step"] in values_of(status)["battery_low"]
        await robot.send(Id.LOG, encode_log(Log(3, "left wheel stalled: 0 of 40 ticks")))
        await robot.send(Id.TIME, bytes(8))
        await asyncio.sleep(2.5)
        status = reader.statuses["hostlink: robot_0 link"]
        assert status["level"] == ERROR
        assert {"battery_low", "wheel_stalled"} <= values_of(status).keys()
        await robot.aclose()

    run_virtual(in_a_hub(Config(), play))


def test_a_locked_robot_is_a_warning() -> None:
    async def play(hub: Hub) -> None:
        reader = Reader(hub.join("a monitor"))
        robot = ScriptedDevice(hub, robot_topics(), address="192.168.4.2")
        await asyncio.sleep(0.1)
        hub.robots.find("robot_0").lock("a person is near")
        await asyncio.sleep(1.5)
        status = reader.statuses["hostlink: robot_0 link"]
        assert (status["level"], status["message"]) == (WARN, "locked: a person is near")
        await robot.aclose()

    run_virtual(in_a_hub(Config(), play))


def test_a_robot_that_has_gone_is_an_error_and_after_a_while_stale() -> None:
    async def play(hub: Hub) -> None:
        reader = Reader(hub.join("a monitor"))
        robot = ScriptedDevice(hub, robot_topics(), address="192.168.4.2")
        await asyncio.sleep(1.5)
        await robot.aclose()
        await asyncio.sleep(3.0)
        status = reader.statuses["hostlink: robot_0 link"]
        assert status["level"] == ERROR
        assert status["message"].startswith("not connected for ")
        assert status["message"].endswith(": peer_closed")
        assert status["hardware_id"] == "192.168.4.2"
        await asyncio.sleep(STALE_AFTER_S)
        assert reader.statuses["hostlink: robot_0 link"]["level"] == STALE
        back = ScriptedDevice(hub, robot_topics(), address="192.168.4.2")
        await asyncio.sleep(1.5)
        assert reader.statuses["hostlink: robot_0 link"]["level"] == OK
        await back.aclose()

    run_virtual(in_a_hub(Config(), play))


def test_arrays_come_once_a_second_a_crowd_in_several_and_none_without_a_subscriber() -> None:
    async def play(hub: Hub) -> None:
        robots = [
            ScriptedDevice(hub, robot_topics(f"robot_{number}"), address=f"10.0.0.{number}") for number in range(20)
        ]
        await asyncio.sleep(5.5)
        found = hub.topics.find(TOPIC)
        assert (found.type_name, found.messages) == (TYPE, 0)
        reader = Reader(hub.join("a monitor"))
        await asyncio.sleep(10 * INTERVAL_S)
        arrays_a_second = -(-21 // ARRAY_STATUSES)
        assert len(reader.arrays) == 10 * arrays_a_second
        assert max(len(array["status"]) for array in reader.arrays) == ARRAY_STATUSES
        assert len(reader.statuses) == 21
        reader.subscription.close()
        before = found.messages
        await asyncio.sleep(5)
        assert found.messages == before
        for robot in robots:
            await robot.aclose()

    run_virtual(in_a_hub(Config(), play))


def test_names_are_unique_also_of_devices_behind_one_address() -> None:
    async def play(hub: Hub) -> None:
        reader = Reader(hub.join("a monitor"))
        infos = [[topic(EndpointKind.PUBLISHER, 125, f"/{name}", "std_msgs/Bool")] for name in "abc"]
        devices = [ScriptedDevice(hub, each, address="192.168.4.3") for each in infos]
        await asyncio.sleep(1.5)
        names = [status["name"] for status in reader.arrays[-1]["status"]]
        assert len(names) == len(set(names)) == 4
        for device in devices:
            await device.aclose()

    run_virtual(in_a_hub(Config(), play))


def test_every_finding_of_the_warnings_exists() -> None:
    assert words().keys() > WARNINGS
