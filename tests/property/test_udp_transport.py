"""UdpTransport with any sequence of datagrams, reads and writes:

no byte is lost, and none is sent without allowance.
"""

import asyncio
import contextlib
import socket
from collections import Counter

from hypothesis import given
from hypothesis import strategies as st

from hostlink.core.transport.base import READ_BYTES
from hostlink.core.transport.udp import MAX_DATAGRAM_BYTES, Datagram, UdpTransport

FIRST = b"greeting"
STEPS = st.one_of(
    st.tuples(st.just("receive"), st.integers(1, 1400)),
    st.tuples(st.just("feed"), st.integers(1, 5000)),
    st.tuples(st.just("read"), st.integers(1, 600)),
    st.tuples(st.just("write"), st.integers(1, 4000)),
    st.tuples(st.just("drain"), st.just(0)),
)


class World:
    """Connected sockets of host and device, and what each has sent."""

    def __init__(self, ours: socket.socket, theirs: socket.socket, *, is_verified: bool) -> None:
        self.theirs = theirs
        self.dropped: Counter[str] = Counter()
        first = Datagram(FIRST, theirs.getsockname(), ours.getsockname())
        self.transport = UdpTransport(
            ours, first, is_verified=is_verified, dropped=self.dropped, on_other=lambda _: None
        )
        self.expected = bytearray(FIRST)  # expected reads, in this order
        self.read = b""
        self.came: list[bytes] = []  # datagrams that the device received
        self.number = 0

    async def step(self, what: str, size: int) -> None:
        self.number = (self.number + 1) % 256
        data = bytes([self.number]) * size
        if what == "receive":
            if self.transport.unread_bytes < READ_BYTES:
                self.theirs.send(data)
                self.expected += data
                await asyncio.sleep(0)
                await asyncio.sleep(0)
        elif what == "feed":
            if self.transport.unread_bytes < READ_BYTES:
                self.expected += data
            self.transport.feed(data)
        elif what == "read":
            self.read += self.transport.read(size)
        elif what == "write":
            self.transport.write(data)
        else:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(0.001):
                    await self.transport.drain()
        with contextlib.suppress(BlockingIOError):
            while True:
                self.came.append(self.theirs.recv(65536))


def connect(ours: socket.socket, theirs: socket.socket) -> None:
    for each in (ours, theirs):
        each.setblocking(False)
        each.bind(("127.0.0.1", 0))
    ours.connect(theirs.getsockname())
    theirs.connect(ours.getsockname())


async def play(steps: list[tuple[str, int]], *, is_verified: bool) -> World:
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ours,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as theirs,
    ):
        connect(ours, theirs)
        world = World(ours, theirs, is_verified=is_verified)
        world.transport.start(lambda: None)
        for what, size in steps:
            await world.step(what, size)
            assert world.transport.unread_bytes < 2 * READ_BYTES
        while len(world.read) < len(world.expected):
            world.read += world.transport.read(1000)
            await asyncio.sleep(0)
        await world.transport.aclose()
        return world


@given(st.lists(STEPS, max_size=40), st.booleans())
def test_received_bytes_are_read_in_order_and_sends_stay_within_the_allowance(
    steps: list[tuple[str, int]], is_verified: bool
) -> None:
    world = asyncio.run(play(steps, is_verified=is_verified))
    assert sorted(world.read) == sorted(world.expected)  # datagrams over the two sockets may overtake each other
    if all(what != "feed" for what, _ in steps):
        assert world.read == bytes(world.expected)
    assert all(len(each) <= MAX_DATAGRAM_BYTES for each in world.came)
    if not is_verified:
        assert sum(map(len, world.came)) <= len(world.expected)
    else:
        written = sum(size for what, size in steps if what == "write")
        assert sum(map(len, world.came)) == written
    assert not world.dropped["too_large"]


@given(steps=st.lists(st.tuples(st.sampled_from(["receive", "feed", "read"]), st.integers(1, 1400)), max_size=30))
def test_kept_datagrams_are_read_whole_and_one_by_one(steps: list[tuple[str, int]]) -> None:
    async def run() -> None:
        with (
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ours,
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as theirs,
        ):
            connect(ours, theirs)
            first, sent, found = Datagram(FIRST, theirs.getsockname(), ours.getsockname()), [FIRST], list[bytes]()
            transport = UdpTransport(
                ours, first, is_verified=True, dropped=Counter(), on_other=lambda _: None, keeps_datagrams=True
            )
            transport.start(lambda: None)
            for number, (what, size) in enumerate(steps):
                data = bytes([number]) * size
                if what == "read":
                    found.append(transport.read(size))
                elif transport.unread_bytes < READ_BYTES:
                    sent.append(data)
                    if what == "feed":
                        transport.feed(data)
                    else:
                        theirs.send(data)
                        await asyncio.sleep(0)
                        await asyncio.sleep(0)
            while transport.unread_bytes:
                found.append(transport.read(1))
            assert sorted(each for each in found if each) == sorted(
                sent
            )  # over the two sockets they may overtake each other
            await transport.aclose()

    asyncio.run(run())
