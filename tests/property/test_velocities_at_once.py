"""A velocity that arrives alone is executed in the turn of its read, and nothing else about it changes.

Each world runs twice: as it is, and with a WebSocket that leaves every message to the queue of operations. The device,
the answers, the events and the counters must be the same.
"""

import asyncio
import re
from collections.abc import Awaitable, Callable
from typing import Any, NamedTuple

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from hostlink.components.gateway.settings import ApiConfig
from hostlink.core.config import Config
from hostlink.core.hub.robot_events import EventKind, RobotEvent
from hostlink.core.robot.velocity import TWIST_TYPE
from tests.support.api_memory import ApiMemory, ApiPeer, api_in_memory, text_frame
from tests.support.fake_device import robot_topics
from tests.support.participants import ODOMETRY_ID, POSE, ROBOT, VELOCITY_ID
from tests.support.scripted_device import ScriptedDevice
from tests.support.virtual_loop import run_virtual, virtual

CMD_VEL, OWN = f"/{ROBOT}/cmd_vel", f"/{ROBOT}/velocity_commands"
STEP_S = 0.0537  # between two things that happen: at the same time as a tick of the gates their order is not known
LAST_S = 1.5
COMPARED = {EventKind.COMMANDED, EventKind.REFUSED, EventKind.STOPPED, EventKind.LOCKED, EventKind.UNLOCKED}

Act = Callable[["World"], Awaitable[None]]
Fields = dict[str, Any]

speeds = st.sampled_from([0.0, -0.0, 0.1, 0.25, -0.3, 7, 1e300])
vectors = st.dictionaries(st.sampled_from("xyz"), speeds, max_size=3)
drives = st.builds(
    lambda robot, named, more: {"op": "drive", "robot": robot} | named | more,
    st.sampled_from([ROBOT, f"/{ROBOT}", "nobody", ""]),
    st.dictionaries(st.sampled_from(["linear", "angular", "linear_y", "linear_m_s"]), speeds, max_size=3),
    st.dictionaries(
        st.sampled_from(["id", "priority", "take_over", "sent_s", "link", "reason", "is_planar", "speed", "epoch"]),
        st.sampled_from([1, 50, 60, 101, True, False, "a", 2.5, None]),
        max_size=2,
    ),
)
publishes = st.builds(
    lambda topic, linear, angular, more: (
        {"op": "publish", "topic": topic, "msg": {"linear": linear, "angular": angular}} | more
    ),
    st.sampled_from([CMD_VEL, CMD_VEL[1:], OWN, "/unknown", "", f"/{ROBOT}/odometry"]),
    vectors,
    vectors,
    st.dictionaries(
        st.sampled_from(["id", "priority", "type", "latch", "raw", "msg", "queue_size"]),
        st.sampled_from([1, 60, 101, True, False, TWIST_TYPE, "std_msgs/String", "", None, {}, {"linear": {"x": "a"}}]),
        max_size=2,
    ),
)
plain = st.one_of(
    st.builds(lambda x: {"op": "drive", "robot": ROBOT, "linear": x, "angular": 0.0}, speeds),
    st.builds(lambda x: {"op": "publish", "topic": CMD_VEL, "msg": {"linear": {"x": x}}}, speeds),
)
others = st.sampled_from(
    [
        {"op": "set_level", "level": "error"},
        {"op": "subscribe", "topic": OWN, "throttle_rate": 100, "queue_length": 2},
        {"op": "advertise", "topic": CMD_VEL, "type": TWIST_TYPE},
        {"op": "advertise", "topic": CMD_VEL, "type": TWIST_TYPE, "latch": True},
        {"op": "unadvertise", "topic": CMD_VEL},
        {"op": "call_service", "id": "stop", "service": f"/{ROBOT}/stop"},
        {"op": "unknown"},
    ]
)
messages = st.one_of(plain, plain, drives, publishes, others)


class Segment(NamedTuple):
    """Messages of one client that arrive together, except for the bytes behind a cut, which come later."""

    client: int
    fields: list[Fields]
    cut: float = 1.0

    async def act(self, world: "World") -> None:
        data = b"".join(text_frame(**each) for each in self.fields)
        at = round(self.cut * len(data))
        peer = world.peers[self.client]
        peer.send(data[:at])
        if at < len(data):
            await asyncio.sleep(STEP_S / 2)
            peer.send(data[at:])


class Other(NamedTuple):
    """Event between the commands: a stop, a lock, a flood, a cut connection."""

    what: str

    async def act(self, world: "World") -> None:
        robot, loop = world.api.hub.robots.find(ROBOT), asyncio.get_running_loop()
        if self.what == "stop":
            robot.stop(by="a person")
        elif self.what == "lock":
            robot.lock("smoke")
        elif self.what == "unlock":
            robot.unlock()
        elif self.what == "leave":
            world.peers[0].transport.close()
        elif self.what == "reconnect":
            await world.api.device.aclose()
            world.devices.append(ScriptedDevice(world.api.hub, robot_topics(ROBOT), address="10.0.0.1"))
            world.api.device = world.devices[-1]
        elif self.what == "flood":
            for number in range(40):
                loop.call_later(number * 0.001, world.peers[1].send, text_frame(op="subscribe", topic=f"/t{number}"))
        else:
            await world.api.device.send(ODOMETRY_ID, POSE.pack(0.0, 0.0, 0.0))


class World:
    """A daemon with one robot and two clients."""

    def __init__(self, api: ApiMemory, peers: list[ApiPeer]) -> None:
        self.api, self.peers, self.devices = api, peers, [api.device]
        self.events: list[RobotEvent] = []


segments = st.builds(
    Segment, st.integers(0, 1), st.lists(messages, min_size=1, max_size=3), st.sampled_from([1.0, 1.0, 0.2, 0.5, 0.9])
)
alone = st.builds(lambda fields: Segment(0, [fields]), plain)
beside = st.builds(
    Other, st.sampled_from(["stop", "lock", "unlock", "leave", "reconnect", "flood", "flood", "pose", "pose"])
)


def _comparable(value: Any) -> Any:
    """Return the value without what is drawn at random at each start: epochs and names of the moment."""
    if isinstance(value, dict):
        return {
            key: _comparable(each) for key, each in value.items() if key not in ("epoch", "stops", "stamp_ns", "age_s")
        }
    return re.sub(r"send epoch \d+", "send epoch", value) if isinstance(value, str) else value


def _of_event(event: RobotEvent) -> tuple[Any, ...]:
    facts = [event.facts.get(key) for key in ("owner", "velocity", "limited", "priority", "reason")]
    return (event.kind, round(event.at_s, 6), *map(_comparable, facts))


async def outcome(acts: list[Segment | Other], *, is_at_once: bool) -> dict[str, Any]:
    """Return all that can be seen of a world."""
    async with api_in_memory(Config().with_tables(api=ApiConfig(max_requests_s=200.0))) as api:
        world = World(api, [await api.web_socket(), await api.web_socket()])
        api.hub.join("observer").observe(world.events.append)
        if not is_at_once:
            for peer in world.peers:
                peer.reading._on_message = lambda _: False
        for each in acts:
            await asyncio.sleep(STEP_S)
            await each.act(world)
        await asyncio.sleep(LAST_S)
        admission = api.hub.robots.find_here(ROBOT).gate
        return {
            "device": [
                (round(at_s, 6), frame.payload)
                for device in world.devices
                for at_s, frame in device.heard
                if frame.topic_id == VELOCITY_ID
            ],
            "answers": [_comparable(text) for peer in world.peers for text in peer.texts()],
            "events": [_of_event(event) for event in world.events if event.kind in COMPARED],
            "refused": dict(admission.admission.refused),
            "counts": admission.counts,
            "publishers": [str(each) for each in api.hub.topics.find(CMD_VEL).publishers],
        }


@example([Segment(0, [{"op": "drive", "robot": ROBOT, "linear": 0.1}]), Other("stop")])
@example([Segment(0, [{"op": "drive", "robot": ROBOT}])])
@example([Segment(0, [{"op": "drive", "robot": ROBOT, "linear": 0.0}])])
@example([Segment(0, [{"op": "publish", "topic": CMD_VEL, "msg": {}, "type": TWIST_TYPE}])])
@given(st.lists(st.one_of(segments, alone, alone, beside), min_size=1, max_size=12))
def test_velocity_at_once_does_what_it_does_in_the_queue(acts: list[Segment | Other]) -> None:
    at_once = run_virtual(outcome(acts, is_at_once=True))
    assert at_once == run_virtual(outcome(acts, is_at_once=False))


@virtual
async def test_velocity_read_alone_is_written_to_the_device_and_answered_in_the_turn_of_its_read() -> None:
    async with api_in_memory() as api:
        peer = await api.web_socket()
        session = api.device.link.session
        for fields in (
            {"op": "drive", "robot": ROBOT, "linear": 0.1, "angular": 0.0},
            {"op": "publish", "topic": CMD_VEL, "msg": {"linear": {"x": 0.1}}},
            {"op": "publish", "topic": OWN, "msg": {"linear": {"x": 0.1, "y": 0}, "angular": {"z": 0.2}}},
        ):
            before = session.counts.frames_to_device
            peer.send_text(**fields)
            assert session.counts.frames_to_device == before + 1
            assert [text["result"] for text in peer.texts()] == [True] * (fields["op"] == "drive")
            await asyncio.sleep(0.1)


@pytest.mark.parametrize("ahead", [0, 1])
@pytest.mark.parametrize("place", range(12))
@pytest.mark.parametrize("way", ["drive", "publish"])
def test_zero_among_many_velocities_in_one_segment_reaches_the_gate_in_its_order(
    way: str, place: int, ahead: int
) -> None:
    def command(x_m_s: float) -> bytes:
        if way == "drive":
            return text_frame(op="drive", robot=ROBOT, linear=x_m_s, angular=0.0)
        return text_frame(op="publish", topic=CMD_VEL, msg={"linear": {"x": x_m_s}})

    async def commanded() -> list[float]:
        async with api_in_memory() as api:
            peer = await api.web_socket()
            events: list[RobotEvent] = []
            api.hub.join("observer").observe(events.append)
            speeds = [0.01 * (number + 1) for number in range(12)]
            speeds[place] = 0.0
            for _ in range(ahead):
                peer.send(command(0.5))
            peer.send(b"".join(map(command, speeds)))
            peer.send(command(0.6))  # alone, right behind the segment: it must not overtake
            await asyncio.sleep(0.3)
            return [event.facts["limited"].x_m_s for event in events if event.kind is EventKind.COMMANDED]

    found = run_virtual(commanded())
    assert found[:ahead] == [0.5] * ahead
    assert found[-1] == 0.6
    assert found.count(0.0) == 1
    before, behind = found[ahead : found.index(0.0)], found[found.index(0.0) + 1 : -1]
    assert all(x_m_s <= 0.01 * place + 1e-9 for x_m_s in before)
    assert all(x_m_s > 0.01 * (place + 1) for x_m_s in behind)


@virtual
async def test_velocity_behind_a_request_that_opens_the_socket_waits_for_the_queue() -> None:
    """Bytes that are read with the handshake may be a part of a frame, so that no later bounds are known."""
    async with api_in_memory() as api:
        peer = api.connect()
        command = text_frame(op="drive", robot=ROBOT, linear=0.1, angular=0.0)
        upgrade = "Host: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
        head = f"GET / HTTP/1.1\r\n{upgrade}Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n".encode()
        peer.send(head + command[:7])
        await asyncio.sleep(0.05)
        peer.send(command[7:] + command)
        await asyncio.sleep(0.05)
        counts = api.device.link.session.counts
        before = counts.frames_to_device
        peer.send(command)
        assert counts.frames_to_device == before
        await asyncio.sleep(0.01)
        assert counts.frames_to_device > before
        _, _, peer.transport.written[:] = bytes(peer.transport.written).partition(b"\r\n\r\n")
        assert [text["result"] for text in peer.texts()] == [True] * 3
