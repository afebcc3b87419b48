"""A program that streams without a pause moves no robot after a stop, however the network delays its commands."""

import asyncio
import tempfile
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from hostlink.core.robot.admission import LEASE_S
from tests.support.api_memory import api_memory, text_frame
from tests.support.participants import VELOCITY_ID
from tests.support.virtual_loop import VirtualLoop, run_virtual

PERIOD_S = 0.1
STOP_S = 3.03  # after the first command
LAST_S = 7.0
READ_S = 0.1  # until a stop and what it meets have passed the daemon, and the device has its zero

gaps = st.lists(
    st.tuples(st.floats(0.0, 4.5), st.sampled_from([0.2, 0.45, 0.55, 0.6, 0.75, 1.0, 2.0])), max_size=4
)  # of the network: when, for how long; what is sent meanwhile arrives at its end
stalls = st.lists(st.tuples(st.floats(0.0, 4.5), st.sampled_from([0.1, 0.3, 0.45])), max_size=3)  # of the daemon


def arrives_s(sent_s: float, delays: list[tuple[float, float]]) -> float:
    """Return when bytes of a connection arrive: in order, none of them within a gap."""
    arrival_s = sent_s
    for began_s, lasts_s in sorted(delays):
        if began_s <= arrival_s < began_s + lasts_s:
            arrival_s = began_s + lasts_s
    return arrival_s


def command(sent_s: float | None) -> bytes:
    if sent_s is None:
        return text_frame(op="publish", topic="/robot_0/velocity_commands", msg={"linear": {"x": 0.1}})
    return text_frame(op="drive", robot="robot_0", linear=0.1, angular=0.0, sent_s=1000.0 + sent_s)


async def moves(
    delays: list[tuple[float, float]], late: list[tuple[float, float]], *, tells_times: bool
) -> list[float]:
    """Return when the device was given a velocity after the stop, in seconds since the stop."""
    loop = asyncio.get_running_loop()
    assert isinstance(loop, VirtualLoop)
    with tempfile.TemporaryDirectory() as folder:
        async with api_memory(Path(folder)) as api:
            peer, robot, began_s = await api.web_socket(), api.hub.robots.find("robot_0"), loop.time()

            arriving: dict[float, bytes] = {}
            for number in range(round(LAST_S / PERIOD_S)):
                sent_s = number * PERIOD_S
                at_s = arrives_s(sent_s, delays)
                arriving[at_s] = arriving.get(at_s, b"") + command(sent_s if tells_times else None)
            for at_s, data in arriving.items():
                loop.call_at(began_s + at_s, peer.send, data)
            for at_s, lasts_s in late:
                loop.call_at(began_s + at_s, loop.burn, lasts_s)
            loop.call_at(began_s + STOP_S, robot.stop)
            await asyncio.sleep(LAST_S)
            frames = [(at_s, frame.payload) for at_s, frame in api.device.heard if frame.topic_id == VELOCITY_ID]
            assert any(any(payload) for _, payload in frames)
            return [at_s - began_s - STOP_S for at_s, payload in frames if any(payload) and at_s > began_s + STOP_S]


@example([(3.0, 0.6)], [])
@example([(3.0, 1.0)], [])
@example([(2.95, 0.55), (3.6, 0.6)], [])
@example([], [(3.2, 0.45)])
@example([(3.2, 0.2)], [(3.3, 0.45)])
@given(gaps, stalls)
def test_program_that_tells_when_it_sends_moves_no_robot_after_a_stop(
    delays: list[tuple[float, float]], late: list[tuple[float, float]]
) -> None:
    after_s = run_virtual(moves(delays, late, tells_times=True))
    allowed_s = READ_S + sum(lasts_s for at_s, lasts_s in late if at_s <= STOP_S + READ_S)  # the stop itself waits
    assert not [at_s for at_s in after_s if at_s > allowed_s]


@pytest.mark.parametrize("gap_s", [0.55, 0.6, 1.0, 2.0])
@pytest.mark.parametrize("began_s", [2.5, 2.95, 3.0, 3.1, 3.4])
def test_program_that_tells_no_times_moves_no_robot_after_a_gap_of_the_network(began_s: float, gap_s: float) -> None:
    """The commands of the gap come together."""
    after_s = run_virtual(moves([(began_s, gap_s)], [], tells_times=False))
    assert not [
        at_s for at_s in after_s if at_s > READ_S and not began_s + gap_s <= at_s + STOP_S < began_s + gap_s + 0.01
    ]
    assert len(after_s) <= 2


def test_program_that_pauses_drives_again() -> None:
    """A lease of silence is a program's own where the network is quick."""

    async def paused() -> bool:
        with tempfile.TemporaryDirectory() as folder:
            async with api_memory(Path(folder)) as api:
                peer, robot = await api.web_socket(), api.hub.robots.find("robot_0")
                for _ in range(3):
                    peer.send(command(None))
                    await asyncio.sleep(PERIOD_S)
                robot.stop()
                await asyncio.sleep(LEASE_S)
                for _ in range(20):
                    peer.send(command(None))
                    await asyncio.sleep(0.02)
                return not robot.gate.target.is_zero

    assert run_virtual(paused())
