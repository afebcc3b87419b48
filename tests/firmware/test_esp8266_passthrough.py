"""Laws of the passthrough under any traffic, full ports and lost links: frames of one link never reach another."""

from struct import Struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hostlink.core.protocol.rosserial.frame import Frame, encode
from hostlink.core.protocol.rosserial.stream import FrameStream
from tests.firmware.esp8266 import Bridge

pytestmark = pytest.mark.usefixtures("esp8266_built")

TAG = Struct("<II")  # number of the link, number of the frame
ID = 125
steps = st.lists(
    st.tuples(
        st.sampled_from(["turn", "turn", "from_device", "from_host", "half_from_host", "lose", "wait"]),
        st.integers(0, 3),
        st.sampled_from([0, 1, 7, 128]),
        st.sampled_from([0, 100, 2920]),
    ),
    max_size=60,
)


def tags(stream: FrameStream, data: bytes) -> list[tuple[int, int]]:
    found = []
    for event in stream.feed(data):
        assert isinstance(event, Frame), f"not a frame: {event!r}"
        found.append(TAG.unpack_from(event.payload))
    return found


class Links:
    """A bridge, and its output on each side."""

    def __init__(self, bridge: Bridge) -> None:
        self.bridge, self.link, self.frame = bridge, 0, 0
        self.is_linked = False  # the bridge's view
        self.is_open = False  # the host's view
        self.to_host: list[tuple[int, int]] = []
        self.to_device: list[tuple[int, int]] = []
        self._at_device, self._at_host = FrameStream(), FrameStream()

    def next_frame(self, size: int) -> bytes:
        self.frame += 1
        return encode(ID, TAG.pack(self.link if self.is_linked else 10**6, self.frame) + bytes(size * 200))

    def turn(self, after_ms: int, device_room: int = 128, host_room: int = 2920) -> None:
        was_linked = self.is_linked
        self.is_linked = self.bridge.turn(after_ms, device_room=device_room, host_room=host_room)
        self._check(self.link)
        if self.is_linked and not was_linked:
            self.link += 1
            self.is_open = True
            self._at_host = FrameStream()  # a new connection

    def _check(self, link: int) -> None:
        for write in self.bridge.to_host():
            found = tags(self._at_host, write)
            assert all(tag[0] == link for tag in found)
            self.to_host += found
        self.to_device += tags(self._at_device, self.bridge.to_device())

    def lose(self) -> None:
        self.bridge.lose()
        self.is_open = False

    def drain(self) -> None:
        for _ in range(600):
            self.turn(1)


def play(links: Links, steps: list[tuple[str, int, int, int]]) -> None:
    for name, size, device_room, host_room in steps:
        if name == "from_device":
            links.bridge.from_device(links.next_frame(size))
        elif name == "from_host" and links.is_open:
            links.bridge.from_host(links.next_frame(size))
        elif name == "half_from_host" and links.is_open:
            links.bridge.from_host(links.next_frame(size)[:11])
            links.lose()
        elif name == "lose":
            links.lose()
        links.turn(300 if name == "wait" else 1, device_room, host_room)


@settings(deadline=None)
@given(steps)
def test_frames_arrive_in_order_and_on_their_own_link_only(steps: list[tuple[str, int, int, int]]) -> None:
    with Bridge() as bridge:
        links = Links(bridge)
        play(links, steps)
        links.drain()
        for arrived in (links.to_host, links.to_device):
            numbers = [number for _, number in arrived]
            assert numbers == sorted(set(numbers))
            assert all(link != 10**6 for link, _ in arrived)


@settings(deadline=None)
@given(st.lists(st.tuples(st.booleans(), st.integers(0, 3)), max_size=30), st.sampled_from([7, 13, 128]))
def test_no_frame_is_lost_while_a_link_is_up(traffic: list[tuple[bool, int]], device_room: int) -> None:
    sent: dict[bool, list[int]] = {True: [], False: []}
    with Bridge() as bridge:
        links = Links(bridge)
        while not links.is_linked:
            links.turn(1)
        links.turn(30)
        for is_from_device, size in traffic:
            (bridge.from_device if is_from_device else bridge.from_host)(links.next_frame(size))
            sent[is_from_device].append(links.frame)
            links.turn(1, device_room)
        for _ in range(20000 // device_room):
            links.turn(0, device_room)
        assert [number for _, number in links.to_host] == sent[True]
        assert [number for _, number in links.to_device] == sent[False]
        assert bridge.dropped() == 0
