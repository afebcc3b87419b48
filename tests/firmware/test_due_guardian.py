"""Firmware and original library obey the guardian's zero, wherever in a frame the daemon was cut off."""

import pytest

from hostlink.core.guardian.frames import stop_sequence
from hostlink.core.messages.catalog import Catalog
from hostlink.core.protocol.rosserial.frame import encode
from tests.firmware.due import Retry, node
from tests.support.original_device import OriginalDevice
from tests.support.rosserial_stop import rosserial_stop

BUFFER_BYTES = 512
LIMIT_S = 0.2
VELOCITY = encode(100, bytes(range(1, 49)))
LONG = encode(101, bytes(value % 251 for value in range(BUFFER_BYTES - 8)))
TURN_S = 0.01
ZEROS = (encode(100, bytes(48)),)


@pytest.mark.parametrize("policy", list(Retry))
@pytest.mark.parametrize("frame", [VELOCITY, encode(101, b"\x01"), LONG], ids=["velocity", "short", "long"])
def test_the_firmware_stands_in_time(frame: bytes, policy: Retry) -> None:
    for cut in range(1, len(frame), 3):
        with node(policy) as device:
            device.feed(VELOCITY + frame[:cut])
            device.spin(1.0)
            heard, waiting = device.received(), stop_sequence(rosserial_stop(ZEROS, BUFFER_BYTES))
            for turn in range(round(LIMIT_S / TURN_S)):
                while waiting and waiting[0][0] <= turn * TURN_S:
                    device.feed(waiting.pop(0)[1])
                while (wait_s := device.spin(1.0 + turn * TURN_S)) is not None:
                    assert wait_s < TURN_S + 0.001
                heard += device.received()
            assert heard[-1] == bytes(48), cut


def test_the_original_library_stands_in_time() -> None:
    twist = Catalog().message("geometry_msgs/Twist")
    assert twist is not None
    for cut in range(1, len(LONG), 3):
        heard: list[bytes] = []
        device = OriginalDevice(baud=None, retries=False)
        device.subscribe("/cmd_vel", twist.name, twist.md5, heard.append)
        device.subscribe("/long", twist.name, twist.md5, lambda _: None)  # 1 of 256 passes by chance
        device.from_host.send(VELOCITY + LONG[:cut], 1.0)
        device.spin(1.0)
        waiting = stop_sequence(rosserial_stop(ZEROS, BUFFER_BYTES))
        for turn in range(round(LIMIT_S / TURN_S)):
            while waiting and waiting[0][0] <= turn * TURN_S:
                device.from_host.send(waiting.pop(0)[1], 1.0 + turn * TURN_S)
            device.spin(1.0 + turn * TURN_S)
        assert heard[-1] == bytes(48), cut
