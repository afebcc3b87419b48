"""Discovery messages: what Home Assistant demands of them, and that their topics are those of the robot."""

import json
import re
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from hostlink.components.mqtt.discovery import config_topic, encode_config, object_id
from hostlink.components.mqtt.topics import Request, Topics, Verb

TOPICS = Topics("hostlink")
NEEDED = {  # keys that Home Assistant requires of a platform
    "sensor": {"state_topic"},
    "binary_sensor": {"state_topic"},
    "button": {"command_topic"},
    "lock": {"command_topic"},
}


def config(*, may_unlock: bool = True, firmware: str | None = None) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(encode_config(TOPICS, "robot_0", firmware, may_unlock=may_unlock))
    return found


def test_topic_is_that_of_a_device() -> None:
    assert config_topic("homeassistant", TOPICS, "robot_0") == "homeassistant/device/hostlink_robot_0/config"


def test_device_has_the_sensors_and_commands_of_a_robot() -> None:
    platforms = {name: each["platform"] for name, each in config()["components"].items()}
    assert platforms == {
        "battery_percent": "sensor",
        "battery_v": "sensor",
        "signal_dbm": "sensor",
        "holder": "sensor",
        "connected": "binary_sensor",
        "errors": "binary_sensor",
        "stop": "button",
        "lock": "lock",
    }


def test_components_have_what_home_assistant_demands() -> None:
    for may_unlock in (True, False):
        found = config(may_unlock=may_unlock)
        assert found["origin"]["name"]
        assert found["device"]["identifiers"] == ["hostlink_robot_0"]
        components = found["components"].values()
        assert len({each["unique_id"] for each in components}) == len(components)
        for each in components:
            assert NEEDED[each["platform"]] <= each.keys()
            assert {"topic": "hostlink/status"} in each["availability"]
            assert each["availability_mode"] == "all"


def test_commands_are_those_that_are_parsed() -> None:
    components = config()["components"]
    assert TOPICS.parse(components["stop"]["command_topic"]) == Request(Verb.STOP, "robot_0")
    assert TOPICS.parse(components["lock"]["command_topic"]) == Request(Verb.SET_LOCK, "robot_0")


def test_daemon_that_does_not_unlock_offers_a_button() -> None:
    lock = config(may_unlock=False)["components"]["lock"]
    assert (lock["platform"], lock["payload_press"]) == ("button", "LOCK")


def test_firmware_is_shown_when_it_is_known() -> None:
    assert config(firmware="rover 1.4.2")["device"]["sw_version"] == "rover 1.4.2"
    assert "sw_version" not in config()["device"]


@given(
    st.lists(st.tuples(st.text("ab/._é", min_size=1, max_size=6), st.text("ab_", min_size=1, max_size=4)), max_size=8)
)
def test_ids_are_valid_and_differ(pairs: list[tuple[str, str]]) -> None:
    ids = {(prefix, robot): object_id(Topics(prefix), robot) for prefix, robot in pairs}
    assert all(re.fullmatch(r"[A-Za-z0-9_-]+", each) for each in ids.values())
    plain = {f"{prefix}_{robot}" for prefix, robot in ids}
    assert len(set(ids.values())) == len(plain)
