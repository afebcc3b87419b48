"""A micro-ROS board behind a whole hub ends at zero, with any fault of the board and its radio.

Two boards are equal, and have equal client keys at two addresses. A third address floods the hub. Virtual time.
"""

import asyncio
import contextlib
from collections.abc import Awaitable, Callable
from random import Random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hostlink.core.protocol.xrce.protocol import MICRO_ROS_UDP
from hostlink.core.robot.admission import LEASE_S
from hostlink.core.robot.velocity import ZERO, PlanarVelocity
from hostlink.errors import HostlinkError
from tests.support import xrce_board as board
from tests.support.background import meanwhile
from tests.support.memory_hub import MemoryHub, in_hub
from tests.support.virtual_loop import VirtualLoop
from tests.support.waiting import expect
from tests.support.xrce_device import stock
from tests.support.xrce_radio import Radio, RadioBoard

COMMAND_S = 0.1
FLOOD_S = 0.01
FLOOD = 20  # datagrams at once
STANDS_S = 1.2  # a lease or a stop, and a radio that loses some zeros
CREATION = board.Client(key=b"\t\t\t\t").creation()


class Scene:
    """The hub, two equal boards and what they are sent."""

    def __init__(self, made: MemoryHub, network: board.Link) -> None:
        self.made, self.network = made, network
        self.random = network.random
        self.begun = 0x01020304
        self.ours, self.other = (
            RadioBoard(made.hub, each, address, self.program())
            for each, address in ((network, "10.0.0.1"), (board.Link(Random(1)), "10.0.0.2"))
        )
        self.driver = made.hub.join("driver")
        self.is_driven = True

    def program(self) -> board.Stock:
        return stock(key=self.begun.to_bytes(4), keeps=4, restarts=True, pings=False)

    def robot_of(self, device: RadioBoard) -> object:
        return next(each for each in self.made.hub.robots.here() if each.link is device.link)

    async def drive(self) -> None:
        """Command our board at 10 Hz; after each refusal with a zero first, as one who lets go."""
        while True:
            await asyncio.sleep(COMMAND_S)
            if self.is_driven:
                try:
                    self.driver.drive(self.robot_of(self.ours), PlanarVelocity(0.2, 0.0, 0.5))  # type: ignore[arg-type]
                except (HostlinkError, StopIteration):
                    with contextlib.suppress(HostlinkError, StopIteration):
                        self.driver.drive(self.robot_of(self.ours), ZERO)  # type: ignore[arg-type]

    async def flood(self) -> None:
        """Send anything from a third address: noise, clients with any key, messages of an unknown session."""
        radio = Radio(board.Link(Random(2)), "10.0.0.3")
        hub = self.made.hub
        hub.spawn(hub.links.serve(hub.links.open(radio, MICRO_ROS_UDP)), name="flood")
        while True:
            await asyncio.sleep(FLOOD_S)
            for number in range(FLOOD):
                data = self.random.randbytes(self.random.choice((0, 3, 40, 500)))
                radio.arrive((CREATION, data, b"\x81\x80" + data, CREATION[:12] + data[:4] + CREATION[16:])[number % 4])

    async def stands(self) -> None:
        """Wait for as long as a stop may take with this radio, and check that the board takes no motion then."""
        await asyncio.sleep(STANDS_S + 40 * self.network.loss**2)
        before = len(self.ours.taken)
        await asyncio.sleep(0.5)
        assert not any(speed for _, speed in self.ours.taken[max(before - 1, 0) :]), self.ours.taken[before - 3 :]


# -- what happens -----------------------------------------------------------------------------------------------------


async def lock(scene: Scene) -> None:
    robot = scene.robot_of(scene.ours)
    robot.lock("smoke")  # type: ignore[attr-defined]
    await scene.stands()
    robot.unlock()  # type: ignore[attr-defined]


async def stop(scene: Scene) -> None:
    scene.is_driven = False
    scene.robot_of(scene.ours).stop()  # type: ignore[attr-defined]
    await scene.stands()


async def source_is_silent(scene: Scene) -> None:
    scene.is_driven = False
    await scene.stands()


async def source_leaves(scene: Scene) -> None:
    scene.driver.leave()
    await scene.stands()
    scene.driver = scene.made.hub.join("driver")


async def reboot(scene: Scene) -> None:
    """The key of the board is drawn at each boot; another one may be equal to it."""
    scene.begun += 1
    scene.ours.reboot(scene.program())


async def reboot_with_the_same_key(scene: Scene) -> None:
    scene.ours.reboot(scene.program())


async def radio_is_gone(scene: Scene) -> None:
    before, scene.network.loss = scene.network.loss, 1.0
    await asyncio.sleep(scene.random.uniform(0.2, 3.0))
    scene.network.loss = before


async def pause(scene: Scene) -> None:
    loop = asyncio.get_running_loop()
    assert isinstance(loop, VirtualLoop)
    loop.burn(2.2)
    await asyncio.sleep(0)
    scene.is_driven = False
    await scene.stands()


EVENTS: list[Callable[[Scene], Awaitable[None]]] = [
    lock,
    stop,
    source_is_silent,
    source_leaves,
    reboot,
    reboot_with_the_same_key,
    radio_is_gone,
    pause,
]


def played(events: list[Callable[[Scene], Awaitable[None]]], seed: int, loss: float, disorder: float) -> None:
    async def test(made: MemoryHub) -> None:
        scene = Scene(made, board.Link(Random(seed), doubles=disorder, overtakes=disorder))
        async with contextlib.AsyncExitStack() as stack:
            for work in (scene.ours.run(), scene.other.run(), scene.drive(), scene.flood()):
                await stack.enter_async_context(meanwhile(work))
            await moves(scene)
            scene.network.loss = loss
            for event in events:
                await asyncio.sleep(scene.random.uniform(0.0, 2 * LEASE_S))
                with contextlib.suppress(StopIteration):  # the hub does not know the board again yet
                    await event(scene)
                scene.is_driven = True
            scene.network.loss = 0.0
            await moves(scene)
            scene.is_driven = False
            await scene.stands()
            assert not any(speed for _, speed in scene.other.taken)
            if not (loss or disorder):  # else the first velocity may overtake the zero before it
                assert not any(each.taken[0][1] for each in scene.ours.lives if each.taken)
            names = {each.name for each in made.hub.robots.here()}
            assert len(names) >= 2
            assert made.hub.isolation.crashes == {}

    in_hub(test)


async def moves(scene: Scene) -> None:
    await expect(lambda: scene.ours.is_moving, timeout_s=30.0)


@pytest.mark.slow
@pytest.mark.parametrize("event", EVENTS, ids=lambda each: each.__name__)
@pytest.mark.parametrize("loss", [0.0, 0.2])
def test_board_stands_after_each_event_beside_a_flood(event: Callable[[Scene], Awaitable[None]], loss: float) -> None:
    played([event], 1, loss, 0.0)


@pytest.mark.long
@settings(max_examples=max(settings.default.max_examples // 20, 3), deadline=None)  # each plays half a minute
@given(
    st.lists(st.sampled_from(EVENTS), min_size=1, max_size=5),
    st.integers(0, 10_000),
    st.sampled_from([0.0, 0.05, 0.2]),
    st.sampled_from([0.0, 0.05]),
)
def test_board_stands_after_any_events_with_any_radio(
    events: list[Callable[[Scene], Awaitable[None]]], seed: int, loss: float, disorder: float
) -> None:
    played(events, seed, loss, disorder)
