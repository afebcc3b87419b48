"""Operations of one client that the daemon reads together move a robot no more than the same ones read one by one."""

import asyncio
import json
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

from hypothesis import example, given
from hypothesis import strategies as st

from hostlink.robot.velocity import Kinematics
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
operations = st.tuples(
    st.one_of(drives, drives, drives, publishes, st.sampled_from((call("lock"), call("unlock")))),
    st.sampled_from((False, False, False, True)),  # as a fragment, if true
)


class Outcome(NamedTuple):
    """Outcome of operations."""

    answers: dict[int, Fields]
    moved: bool  # whether the device heard of a velocity that is not zero
    moves: bool  # whether it was to move after the last operation
    is_armed: bool  # whether one more velocity is admitted


def outcome(sent: list[tuple[Fields, bool]], *, together: bool, is_disarmed: bool) -> Outcome:
    async def run() -> Outcome:
        with tempfile.TemporaryDirectory() as folder:
            async with api_memory(Path(folder)) as api:
                return await driven(api, sent, together=together, is_disarmed=is_disarmed)

    return run_virtual(run())


async def driven(api: ApiMemory, sent: list[tuple[Fields, bool]], *, together: bool, is_disarmed: bool) -> Outcome:
    peer, robot = await api.web_socket(), api.hub.robots.find("robot_0")
    robot.admission.kinematics = Kinematics.DIFFERENTIAL
    if is_disarmed:
        peer.send_text(**drive())
        await asyncio.sleep(0.01)
        robot.stop()
        await asyncio.sleep(0.2)
        peer.texts()
    heard = len(api.device.heard)
    assert robot.link is not None
    facts = {"epoch": robot.admission.epoch, "stops": robot.admission.epoch, "link": robot.link.number}
    for number, (fields, is_fragment) in enumerate(sent):
        known = {name: fields[name] for name in facts if name in fields}
        told = {name: facts[name] - (value == EARLIER) for name, value in known.items()}
        whole = fields | told | {"id": number}
        peer.send_text(**(fragment(whole) if is_fragment else whole))
        if not together:
            await asyncio.sleep(0.001)
    await asyncio.sleep(0.02)
    answers = answers_of(peer)
    frames = [frame.payload for _, frame in api.device.heard[heard:] if frame.topic_id == VELOCITY_ID]
    moves = not robot.gate.target.is_zero
    peer.send_text(**drive(id=-1))
    await asyncio.sleep(0.02)
    return Outcome(answers, any(any(payload) for payload in frames), moves, answers_of(peer)[-1]["result"])


def answers_of(peer: ApiPeer) -> dict[int, Fields]:
    """Return the answers to `drive` by id: one for each."""
    answers = [text for text in peer.texts() if text["op"] == "drive_result"]
    assert len({answer["id"] for answer in answers}) == len(answers)
    return {answer["id"]: answer for answer in answers}


def whole(*sent: Fields) -> list[tuple[Fields, bool]]:
    return [(each, False) for each in sent]


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
def test_operations_that_wait_together_lead_where_they_lead_one_by_one(
    sent: list[tuple[Fields, bool]], is_disarmed: bool
) -> None:
    alone = outcome(sent, together=False, is_disarmed=is_disarmed)
    together = outcome(sent, together=True, is_disarmed=is_disarmed)
    assert together.moves <= alone.moves
    assert together.is_armed <= alone.is_armed
    assert together.answers.keys() == alone.answers.keys()
    assert together.moved <= alone.moved
    assert (together.moves, together.is_armed) == (alone.moves, alone.is_armed)
    for number, answer in together.answers.items():
        if not answer.get("is_replaced"):
            assert decision(answer) == decision(alone.answers[number])


def decision(answer: Fields) -> tuple[bool, str | None]:
    return answer["result"], answer.get("kind")
