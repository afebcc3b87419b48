"""Home Assistant's MQTT discovery: one retained message makes a device of a robot. Pure.

The format is that of https://www.home-assistant.io/integrations/mqtt/#device-discovery-payload.
"""

import re
import zlib
from typing import Any

import msgspec

from hostlink.components.mqtt.topics import Topics, Verb

ONLINE, OFFLINE = "online", "offline"
LOCK, UNLOCK = "LOCK", "UNLOCK"


def object_id(topics: Topics, robot: str) -> str:
    """Return the id of a robot's device. Letters that it may not have are replaced; a checksum tells such ids apart."""
    plain = f"{topics.prefix}_{robot}"
    taken = re.sub(r"[^A-Za-z0-9_-]", "_", plain)
    return taken if taken == plain else f"{taken}_{zlib.crc32(plain.encode()):08x}"


def config_topic(prefix: str, topics: Topics, robot: str) -> str:
    """Return the topic of a robot's discovery message."""
    return f"{prefix}/device/{object_id(topics, robot)}/config"


def encode_config(topics: Topics, robot: str, firmware: str | None, *, may_unlock: bool) -> bytes:
    """Return a robot's discovery message."""
    own = object_id(topics, robot)
    daemon = {"topic": topics.status}
    present = [daemon, {"topic": topics.availability(robot)}]
    state = topics.state(robot)

    def component(key: str, platform: str, name: str, availability: list[dict[str, str]], **options: Any) -> Any:
        return {
            "platform": platform,
            "unique_id": f"{own}_{key}",
            "name": name,
            "availability": availability,
            "availability_mode": "all",
            **options,
        }

    def sensor(key: str, name: str, **options: Any) -> Any:
        value = f"{{{{ value_json.{key} }}}}"
        return component(key, "sensor", name, present, state_topic=state, value_template=value, **options)

    of_board: Any = {"entity_category": "diagnostic", "state_class": "measurement"}
    components = {
        "battery_percent": sensor(
            "battery_percent", "Battery", device_class="battery", unit_of_measurement="%", **of_board
        ),
        "battery_v": sensor("battery_v", "Voltage", device_class="voltage", unit_of_measurement="V", **of_board),
        "signal_dbm": sensor(
            "signal_dbm", "Signal", device_class="signal_strength", unit_of_measurement="dBm", **of_board
        ),
        "holder": sensor("holder", "Driver", icon="mdi:controller"),
        "connected": component(
            "connected", "binary_sensor", "Connection", [daemon],
            device_class="connectivity", entity_category="diagnostic",
            state_topic=topics.availability(robot), payload_on=ONLINE, payload_off=OFFLINE,
        ),
        "errors": component(
            "errors", "binary_sensor", "Problem", present, device_class="problem", entity_category="diagnostic",
            state_topic=state, value_template="{{ 'ON' if value_json.errors else 'OFF' }}",
        ),
        "stop": component(
            "stop", "button", "Stop", present, icon="mdi:stop", command_topic=topics.command(robot, Verb.STOP), qos=1
        ),
    }  # fmt: skip
    if may_unlock:
        components["lock"] = component(
            "lock", "lock", "Lock", [daemon],
            command_topic=topics.command(robot, Verb.SET_LOCK), payload_lock=LOCK, payload_unlock=UNLOCK, qos=1,
            state_topic=state, value_template="{{ 'LOCKED' if value_json.locked else 'UNLOCKED' }}",
        )  # fmt: skip
    else:
        components["lock"] = component(
            "lock", "button", "Lock", [daemon], icon="mdi:lock",
            command_topic=topics.command(robot, Verb.SET_LOCK), payload_press=LOCK, qos=1,
        )  # fmt: skip
    device = {"identifiers": [own], "name": robot, "model": "rosserial robot"}
    if firmware:
        device["sw_version"] = firmware
    origin = {"name": "hostlink"}
    return msgspec.json.encode({"device": device, "origin": origin, "components": components})
