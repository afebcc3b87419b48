"""Reports of a device about itself: its battery, its WiFi, its firmware, its faults."""

from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind
from hostlink.core.protocol.rosserial.control import Log
from hostlink.core.protocol.rosserial.frame import Id, encode
from hostlink.core.robot.state import BATTERY_TYPE
from tests.support.device_codec import encode_log
from tests.support.fake_device import CATALOG, topic

_BATTERY_ID = 130


def battery_topic(name: str = "robot_0") -> DeviceEndpoint:
    """The topic of a robot's battery."""
    return topic(EndpointKind.PUBLISHER, _BATTERY_ID, f"/{name}/battery", BATTERY_TYPE)


BATTERY = battery_topic()


def battery(volts: float, **fields: float) -> bytes:
    """A sensor_msgs/BatteryState that says nothing else."""
    type_ = CATALOG.message(BATTERY_TYPE)
    assert type_ is not None
    return encode(_BATTERY_ID, type_.encode({"voltage": volts, **fields}))


def report(volts: float) -> bytes:
    """All of it, as one device sends it."""
    logs = [Log(0, "WiFi signal -67 dBm"), Log(1, "firmware rover 1.4"), Log(3, "battery low: 9.5 V, below 10.5 V")]
    return b"".join(encode(Id.LOG, encode_log(log)) for log in logs) + battery(volts, percentage=0.25)
