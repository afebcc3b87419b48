"""Session with a device whose loop takes seconds: its UART sends a frame in pieces, one in each turn."""

import pytest

from hostlink.core.protocol import events
from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind
from hostlink.core.protocol.rosserial.frame import Id, encode
from hostlink.core.protocol.rosserial.stream import Rejection
from tests.support.session_host import LED, ODOMETRY, TIME, Host, wire

RING_BYTES = 63  # what the UART of an Uno takes at once
INFOS = [
    ODOMETRY,
    DeviceEndpoint(EndpointKind.PUBLISHER, 126, "/some_longer_name/battery_state", "std_msgs/Float32", "m" * 32, 512),
    LED,
]


class SlowDevice:
    """Device that sends at most RING_BYTES in each turn. A topic request begins its announcement again."""

    def __init__(self, host: Host, turn_s: float) -> None:
        self.host, self.turn_s = host, turn_s
        self.waiting: list[bytes] = []  # frames; the first may be begun
        self.is_begun = False
        self.found: list[events.Event] = []

    def turn(self, *messages: bytes) -> None:
        for frame in self.host.sent():
            if frame.topic_id == Id.PUBLISHER:
                self.waiting = [*self.waiting[: self.is_begun], TIME, *map(wire, INFOS)]
        self.waiting += messages
        room, piece = RING_BYTES, b""
        while self.waiting and room:
            part, rest = self.waiting[0][:room], self.waiting[0][room:]
            piece, room, self.is_begun = piece + part, room - len(part), bool(rest)
            self.waiting[:1] = [rest] if rest else []
        self.found += self.host.receive(piece, after_s=0.0) if piece else []
        self.found += self.host.wait(self.turn_s)


@pytest.mark.parametrize("turn_s", [1.0, 2.0, 2.5, 4.0])
def test_device_with_slow_turns_is_connected_and_loses_no_frame(turn_s: float) -> None:
    host = Host()
    device = SlowDevice(host, turn_s)
    for _ in range(30):
        device.turn()
    assert {info.name for info in host.session.topics} == {info.name for info in INFOS}
    assert host.session.counts.skipped_bytes == 0
    sent = 0
    for _ in range(60):
        is_free = not device.waiting
        sent += is_free
        device.turn(*([TIME, encode(125, bytes(24))] * is_free))
    for _ in range(20):
        device.turn()
    received = sum(isinstance(event, events.MessageReceived) for event in device.found)
    assert (received, host.session.counts.skipped_bytes) == (sent, 0)
    assert sent > 5


def test_half_a_frame_is_given_up_before_the_link_ends() -> None:
    host = Host(ODOMETRY)
    host.receive(encode(125, bytes(24))[:20])
    host.wait(10.5)
    assert host.session.counts.skipped_bytes == 0
    host.wait(1.0)
    assert host.session.counts.skipped_bytes == 20
    assert host.session.rejected == {Rejection.INCOMPLETE.value: 1}


def test_frame_with_an_unknown_id_is_given_up_soon() -> None:
    host = Host(ODOMETRY)
    host.receive(encode(140, bytes(24))[:20])
    host.wait(2.1)
    assert host.session.counts.skipped_bytes == 20


def test_whole_frame_inside_half_a_frame_is_received_at_once() -> None:
    host = Host(ODOMETRY)
    message = encode(125, bytes(24))
    host.receive(message[:20])
    assert host.receive(message + message) == [events.MessageReceived(ODOMETRY, bytes(24))] * 2


@pytest.mark.parametrize(("paused_s", "silence_s"), [(9.9, 5.0), (0.0, 12.0)])
def test_pause_of_the_host_inside_a_frame_does_not_count_as_a_slow_turn(paused_s: float, silence_s: float) -> None:
    host = Host(ODOMETRY)
    host.receive(TIME[:5])
    host.now_s += 10.0
    host.session.note_host_pause(paused_s)
    host.session.receive(TIME[5:], now_s=host.now_s)
    host.wait(silence_s - 0.1)
    assert all(frame.topic_id != Id.PUBLISHER for frame in host.sent())
    host.wait(0.2)
    assert any(frame.topic_id == Id.PUBLISHER for frame in host.sent())
