"""The simulated device under any bytes at any times: it may crash as the original does, and it is found again."""

import contextlib

from hypothesis import given
from hypothesis import strategies as st

from hostlink.core.protocol.rosserial.frame import TOPICS_REQUEST, Frame, Id, encode
from hostlink.core.protocol.rosserial.stream import FrameStream
from tests.support.original_device import DeviceCrashed, OriginalDevice
from tests.support.strategies import damaged, frames, noise, split, wire_of

LOOP_S = 1 / 30
good = st.sampled_from([TOPICS_REQUEST, encode(100, b"\x01"), encode(Id.TIME, bytes(8)), encode(Id.STOP, b"")])
lines = st.lists(st.one_of(noise, frames.map(wire_of), good), max_size=8).map(b"".join)


def run(device: OriginalDevice, now_s: float) -> float:
    """One turn with its retry waits; a crash is a reboot."""
    with contextlib.suppress(DeviceCrashed):
        while (wait_s := device.spin(now_s)) is not None:
            now_s += wait_s
        return now_s
    device.reboot()
    return now_s


@given(st.lists(st.tuples(lines, st.floats(0.0, 0.2)), max_size=8), st.booleans(), st.data())
def test_any_bytes_at_any_time(story: list[tuple[bytes, float]], retries: bool, data: st.DataObject) -> None:
    heard: list[bytes] = []
    device = OriginalDevice(retries=retries)
    device.advertise("/odometry", "geometry_msgs/Pose2D", "m")
    device.subscribe("/led", "std_msgs/Bool", "m", heard.append)
    now_s = 0.0
    for line, pause_s in story:
        for piece in split(damaged(line, data), data):
            device.from_host.send(piece, now_s)
            now_s = run(device, now_s + LOOP_S)
        now_s += pause_s
    for _ in range(60):  # what is on the UART arrives, and a frame that never ends is dropped
        now_s = run(device, now_s + LOOP_S)
    device.to_host.pop(now_s + 10.0)

    device.from_host.send(TOPICS_REQUEST, now_s)
    now_s = run(device, now_s + 0.1)
    sent = [item for item in FrameStream().feed(device.to_host.pop(now_s + 10.0)) if isinstance(item, Frame)]
    assert [frame.topic_id for frame in sent] == [Id.TIME, Id.PUBLISHER, Id.SUBSCRIBER]
    assert device.is_configured
