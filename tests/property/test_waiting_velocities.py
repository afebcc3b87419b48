"""Operations that the daemon reads together move a robot no more than the same ones read one by one."""

import asyncio
import itertools
import json
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from hostlink.components.gateway.clients import Operation, OperationQueue, VelocityOf
from hostlink.core.hub.byte_budget import ByteBudget
from hostlink.core.robot.admission import UNORDERED_S, Admission, Command
from hostlink.core.robot.kinematics import DifferentialDrive
from hostlink.core.robot.velocity import PlanarVelocity
from tests.support.api_memory import ApiMemory, ApiPeer, api_memory
from tests.support.participants import VELOCITY_ID
from tests.support.virtual_loop import run_virtual

Fields = dict[str, Any]
TOPIC = "/robot_0/velocity_commands"
EARLIER, CURRENT = "earlier", "current"  # epoch or link, until the robot is known


def drive(**fields: Any) -> Fields:
    return {"op": "drive", "robot": "robot_0", "linear": 0.1, "angular": 0.0} | fields


def publish(**fields: Any) -> Fields:
    return {"op": "publish", "topic": TOPIC, "msg": {"linear": {"x": 0.1}}} | fields


def fragment(whole: Fields) -> Fields:
    return {"op": "fragment", "id": "f", "num": 0, "total": 1, "data": json.dumps(whole)}


def call(service: str) -> Fields:
    return {"op": "call_service", "service": f"robot_0/{service}"}


known = st.sampled_from((EARLIER, CURRENT))
drives = st.builds(
    lambda robot, velocity, optional: drive(robot=robot, linear=velocity, **optional),
    st.sampled_from(("robot_0", "robot_0", "robot_0", "/robot_0", "nobody")),
    st.sampled_from((0.1, 0.1, 0.1, 0.0)),
    st.fixed_dictionaries(
        {},
        optional={
            "epoch": known,
            "stops": known,
            "link": known,
            "linear_y": st.sampled_from((0.1, 0.0)),
            "is_planar": st.booleans(),
            "priority": st.sampled_from((50, 60, True, 300)),
            "sent_s": st.sampled_from((0.0, "x")),
            "speed": st.just(1),
        },
    ),
)
publishes = st.builds(
    lambda message, optional: publish(msg=message, **optional),
    st.sampled_from(
        (
            *({"linear": {"x": x}} for x in (0.1, 0.1, 0.0, None, "x")),
            *({"linear": {"x": 0.0, axis: 0.1}} for axis in ("y", "z", "speed")),
            {"linear": {"x": 0.1}, "header": {}},
        )
    ),
    st.fixed_dictionaries({}, optional={"priority": st.sampled_from((50, 60)), "type": st.just("geometry_msgs/Twist")}),
)
calls = st.sampled_from((call("lock"), call("unlock")))
STOP, LEAVE, WAIT = {"op": "stop"}, {"op": "leave"}, {"op": "wait"}  # a stop by REST; the end of a connection; a while


class Sent(NamedTuple):
    """An operation of one of two clients."""

    fields: Fields
    is_fragment: bool = False
    client: int = 0


is_fragment = st.sampled_from((False, False, False, True))
operations = st.builds(Sent, st.one_of(drives, drives, drives, publishes, calls), is_fragment, st.just(0))
operations_of_two = st.builds(
    Sent,
    st.one_of(drives, drives, publishes, publishes, calls, st.sampled_from((STOP, LEAVE, WAIT))),
    st.just(False),
    st.integers(0, 1),
)


class Outcome(NamedTuple):
    """Outcome of operations."""

    answers: dict[int, Fields]
    moved: bool  # whether the device heard of a velocity that is not zero
    moves: bool  # whether it was to move after the last operation
    is_armed: tuple[bool, ...]  # whether one more velocity of each client is admitted


def outcome(sent: Sequence[Sent], *, together: bool, is_disarmed: bool) -> Outcome:
    async def run() -> Outcome:
        with tempfile.TemporaryDirectory() as folder:
            async with api_memory(Path(folder)) as api:
                return await driven(api, sent, together=together, is_disarmed=is_disarmed)

    return run_virtual(run())


async def driven(api: ApiMemory, sent: Sequence[Sent], *, together: bool, is_disarmed: bool) -> Outcome:
    peers, robot = [await api.web_socket(), await api.web_socket()], api.hub.robots.find("robot_0")
    robot.admission.drive = DifferentialDrive()
    if is_disarmed:
        peers[0].send_text(**drive())
        await asyncio.sleep(0.01)
        robot.stop()
        await asyncio.sleep(0.2)
        peers[0].texts()
    heard = len(api.device.heard)
    facts = {"epoch": robot.admission.epoch, "stops": robot.admission.epoch, "link": robot.link.number}
    for number, (fields, is_fragment, client) in enumerate(sent):
        peer = peers[client]
        known = {name: fields[name] for name in facts if name in fields}
        told = {name: facts[name] - (value == EARLIER) for name, value in known.items()}
        whole = fields | told | {"id": number}
        if fields == STOP:
            robot.stop()
        elif fields == LEAVE:
            peer.send_close()
        elif fields != WAIT:
            peer.send_text(**(fragment(whole) if is_fragment else whole))
        if not together or fields == WAIT:
            await asyncio.sleep(0.001)
    await asyncio.sleep(0.02)
    answers = answers_of(peers[0]) | answers_of(peers[1])
    frames = [frame.payload for _, frame in api.device.heard[heard:] if frame.topic_id == VELOCITY_ID]
    moves = not robot.gate.target.is_zero
    is_armed = []
    for peer in peers:
        peer.send_text(**drive(id=-1))
        await asyncio.sleep(0.02)
        is_armed.append(any(answer["result"] for answer in answers_of(peer).values()))
    return Outcome(answers, any(any(payload) for payload in frames), moves, tuple(is_armed))


def answers_of(peer: ApiPeer) -> dict[int, Fields]:
    """Return the answers to `drive` by id: one for each."""
    answers = [text for text in peer.texts() if text["op"] == "drive_result"]
    assert len({answer["id"] for answer in answers}) == len(answers)
    return {answer["id"]: answer for answer in answers}


def whole(*sent: Fields) -> list[Sent]:
    return [Sent(each) for each in sent]


@pytest.mark.slow
@given(st.lists(operations, min_size=1, max_size=6), st.booleans())
@example(whole(drive(link=EARLIER), drive(link=CURRENT)), False)
@example(whole(drive(epoch=CURRENT, link=EARLIER), drive(link=CURRENT)), False)
@example(whole(drive(link=EARLIER), drive(epoch=CURRENT)), True)
@example(whole(drive(epoch=EARLIER), publish(), drive()), False)
@example(whole(drive(epoch=EARLIER), drive(priority=60), drive()), False)
@example(whole(drive(epoch=EARLIER), drive(sent_s="x")), False)
@example(whole(drive(priority=60, sent_s="x"), drive(priority=60)), False)
@example(whole(drive(), drive(linear_y=0.1)), False)
@example(whole(publish(), publish(msg={"linear": {"speed": 0.1}})), False)
@example(whole(publish(), publish(msg={"linear": {"speed": 0.0}})), False)
@example(whole(publish(), publish(raw="AAAA")), False)
@example(whole(call("lock"), drive()), False)
@example(whole(drive(), call("unlock"), call("lock")), False)
def test_operations_that_wait_together_lead_where_they_lead_one_by_one(sent: list[Sent], is_disarmed: bool) -> None:
    alone = outcome(sent, together=False, is_disarmed=is_disarmed)
    together = outcome(sent, together=True, is_disarmed=is_disarmed)
    assert together.moved <= alone.moved
    assert (together.moves, together.is_armed) == (alone.moves, alone.is_armed)
    assert together.answers.keys() == alone.answers.keys()
    for number, answer in together.answers.items():
        if not answer.get("is_replaced"):
            assert decision(answer) == decision(alone.answers[number])


def decision(answer: Fields) -> tuple[bool, str | None]:
    return answer["result"], answer.get("kind")


@pytest.mark.slow
@given(st.lists(operations_of_two, min_size=1, max_size=6), st.booleans())
@example([Sent(drive()), Sent(STOP, client=1), Sent(drive())], False)
@example([Sent(call("lock")), Sent(drive(), client=1), Sent(LEAVE)], False)
@example([Sent(drive()), Sent(drive(), client=1), Sent(LEAVE, client=1)], False)
def test_operations_of_two_clients_that_wait_move_a_robot_no_more_than_one_by_one(
    sent: list[Sent], is_disarmed: bool
) -> None:
    """The order of two clients in one turn of the loop is unknown: any order that keeps that of each is right."""
    together = outcome(sent, together=True, is_disarmed=is_disarmed)
    assert any(moves_no_more(together, outcome(each, together=False, is_disarmed=is_disarmed)) for each in orders(sent))


def moves_no_more(one: Outcome, other: Outcome) -> bool:
    are_less = (mine <= others for mine, others in zip(one.is_armed, other.is_armed, strict=True))
    return one.moved <= other.moved and one.moves <= other.moves and all(are_less)


def orders(sent: list[Sent]) -> Iterator[list[Sent]]:
    """Every order of the operations of both clients and the stops, where nothing is executed before a wait ahead."""
    ends = [number for number, each in enumerate(sent) if each.fields == WAIT]
    pieces = [sent[begin:end] for begin, end in zip([0, *ends], [*ends, len(sent)], strict=True)]
    for merged in itertools.product(*map(merges, pieces)):
        yield [each for piece in merged for each in piece]


def merges(sent: list[Sent]) -> list[list[Sent]]:
    """Every order that keeps the one of each source, the given one first."""
    sources = [2 if each.fields == STOP else each.client for each in sent]
    found = []
    for order in sorted(set(itertools.permutations(sources)), key=lambda order: order != tuple(sources)):
        queues = [[each for each, of in zip(sent, sources, strict=True) if of == source] for source in range(3)]
        found.append([queues[source].pop(0) for source in order])
    return found


class Robot:
    """Robot whose client's velocities wait in a queue."""

    calls = 0

    def __init__(self) -> None:
        self.now_s, self.admission = 100.0, Admission("robot_0")
        self.admission.connect(0.0)
        self.queue = OperationQueue[PlanarVelocity](self, lambda: None, 1000.0, ByteBudget()["operations"])

    def read(self, data: str | bytes, came_s: float) -> Operation[PlanarVelocity]:
        velocity = PlanarVelocity(float(data))
        return Operation(velocity, came_s, VelocityOf("drive", "robot_0"), velocity.is_zero)

    def do(self, operation: Operation[PlanarVelocity]) -> None:
        velocity = operation.content
        decision = self.admission.decide(Command(velocity, "client", 50, operation.came_s), self.now_s)
        if velocity.is_zero and decision.is_admitted:
            self.admission.end("")

    def flush(self, now_s: float) -> float | None: ...
    def close(self) -> None: ...

    def work(self) -> None:
        while self.queue.waiting:
            self.queue.work()

    def live(self, events: list[str], *, is_busy: bool) -> tuple[bool, bool]:
        """Return whether it moves after the events, and whether one more velocity is admitted."""
        for event in events:
            if event == "wait":
                self.now_s += STEP_S
            elif event == "stop":
                self.now_s += STEP_S
                self.admission.interrupt(self.now_s, came_s=self.now_s)
                self.now_s += STEP_S
            else:
                self.queue.put(event, self.now_s, self.now_s)
                if not is_busy:
                    self.work()
        self.work()
        moves = self.admission.driver("", self.now_s) is not None
        return moves, self.admission.decide(
            Command(PlanarVelocity(0.1), "client", 50, self.now_s), self.now_s
        ).is_admitted


STEP_S = UNORDERED_S + 0.01
events = st.lists(st.sampled_from(("0.1", "0.2", "0.1", "0.0", "stop", "wait")), max_size=8)


@given(events)
@example(["0.1", "stop", "0.1"])
@example(["0.1", "stop", "0.0", "0.1"])
@example(["0.1", "wait", "0.1", "stop", "0.1"])
def test_velocities_that_wait_while_others_stop_the_robot_move_it_no_more_than_at_once(events: list[str]) -> None:
    waited, at_once = Robot().live(events, is_busy=True), Robot().live(events, is_busy=False)
    assert waited[0] <= at_once[0]
    assert waited[1] <= at_once[1]
