"""Retained messages: after any history the broker has those of the known robots, and no others."""

from hypothesis import given
from hypothesis import strategies as st

from hostlink.components.mqtt.retained import MAX_EARLIER, Retained
from hostlink.components.mqtt.settings import MqttSettings
from hostlink.components.mqtt.topics import Topics
from tests.unit.components.mqtt.robots import robot

NAMES = ("a", "b", "c")


def of(names: set[str]) -> dict[str, str]:
    return {f"hostlink/robots/{name}/availability": name for name in names}


class Broker:
    """Messages that a broker keeps."""

    def __init__(self, **settings: object) -> None:
        self.retained = Retained(MqttSettings(**settings), Topics("hostlink"))  # type: ignore[arg-type]
        self.kept: dict[str, bytes] = {}
        self.received = 0

    def update(self, *robots: object, now_s: float = 0.0) -> None:
        changes = [each for robot in robots for each in self.retained.update(robot)]  # type: ignore[arg-type]
        present = [robot.name for robot in robots]  # type: ignore[attr-defined]
        for each in [*changes, *self.retained.remove_others(present, now_s=now_s)]:
            self.received += 1
            if each.payload:
                self.kept[each.topic] = each.payload
            else:
                self.kept.pop(each.topic, None)

    @property
    def robots(self) -> set[str]:
        return {topic.split("/")[2] for topic in self.kept if topic.startswith("hostlink/robots/")}


@given(st.lists(st.sets(st.sampled_from(NAMES))), st.booleans())
def test_broker_has_the_messages_of_the_known_robots(history: list[set[str]], discovery: bool) -> None:
    broker = Broker(discovery=discovery)
    for known in history:
        broker.update(*(robot(name) for name in sorted(known)))
        assert broker.robots == known
        assert len(broker.kept) == len(known) * (3 if discovery else 2)


def test_unchanged_state_is_not_published_again() -> None:
    broker = Broker()
    broker.update(robot("a"))
    assert broker.received == 3
    broker.update(robot("a"))
    assert broker.received == 3
    broker.update(robot("a", holder="teleop"))
    assert broker.received == 4


def test_availability_follows_the_connection() -> None:
    broker = Broker()
    broker.update(robot("a"))
    assert broker.kept["hostlink/robots/a/availability"] == b"online"
    broker.update(robot("a", link=None))
    assert broker.kept["hostlink/robots/a/availability"] == b"offline"


def test_robot_of_an_earlier_run_is_offline_and_then_forgotten() -> None:
    broker = Broker(forget_after_s=600.0)
    broker.kept["hostlink/robots/old/availability"] = b"online"
    broker.kept["hostlink/robots/old/state"] = b"{}"
    broker.kept["homeassistant/device/hostlink_old/config"] = b"{}"
    broker.retained.find("old", b"online", is_kept=True, now_s=100.0)
    broker.update(now_s=100.0)
    assert broker.kept["hostlink/robots/old/availability"] == b"offline"
    broker.update(now_s=699.0)
    assert broker.robots == {"old"}
    broker.update(now_s=700.0)
    assert broker.kept == {}


def test_robot_of_an_earlier_run_that_returns_is_kept() -> None:
    broker = Broker(forget_after_s=600.0)
    broker.retained.find("a", b"online", is_kept=True, now_s=0.0)
    broker.update(now_s=0.0)
    broker.update(robot("a"), now_s=10.0)
    broker.update(robot("a"), now_s=1000.0)
    assert broker.kept["hostlink/robots/a/availability"] == b"online"


def test_discovery_that_was_switched_off_removes_the_device() -> None:
    broker = Broker(discovery=False)
    broker.kept["homeassistant/device/hostlink_a/config"] = b"{}"
    broker.update(robot("a"))
    assert set(broker.kept) == {"hostlink/robots/a/state", "hostlink/robots/a/availability"}


def test_played_robot_is_not_a_device() -> None:
    broker = Broker()
    broker.update(robot("a", is_played=True))
    assert set(broker.kept) == {"hostlink/robots/a/state", "hostlink/robots/a/availability"}


def test_new_firmware_changes_the_device() -> None:
    broker = Broker()
    broker.update(robot("a", firmware=None))
    broker.update(robot("a", firmware="rover 2"))
    assert b"rover 2" in broker.kept["homeassistant/device/hostlink_a/config"]


def test_message_that_another_daemon_has_replaced_is_published_again() -> None:
    broker = Broker()
    broker.update(robot("a"))
    broker.retained.find("a", b"online", is_kept=False, now_s=0.0)
    broker.update(robot("a"))
    assert broker.received == 3
    broker.kept.clear()
    broker.retained.find("a", b"", is_kept=False, now_s=0.0)
    broker.update(robot("a"))
    assert broker.robots == {"a"}
    assert broker.kept["hostlink/robots/a/availability"] == b"online"


def test_robot_that_another_daemon_publishes_is_not_removed() -> None:
    broker = Broker(forget_after_s=600.0)
    broker.retained.find("b", b"online", is_kept=True, now_s=0.0)
    broker.update(now_s=0.0)
    broker.retained.find("b", b"online", is_kept=False, now_s=1.0)
    broker.kept["hostlink/robots/b/availability"] = b"online"
    broker.update(now_s=1000.0)
    assert broker.robots == {"b"}


def test_robots_of_earlier_runs_are_bounded() -> None:
    broker = Broker()
    for number in range(MAX_EARLIER + 3):
        broker.retained.find(f"r{number}", b"online", is_kept=True, now_s=0.0)
    assert broker.retained.excess == 3
