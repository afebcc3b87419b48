"""Services between programs: each call is answered exactly once, after any order of offers, answers and departures."""

import asyncio
import json
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from tests.support.rosbridge_memory import Peer, World, world
from tests.support.virtual_loop import within

PEERS = 3
services = st.sampled_from(["/switch", "switch", "/other"])
types = st.sampled_from(["std_srvs/SetBool", "std_srvs/Empty", "my_srvs/Mine"])
values = st.sampled_from([{}, {"success": True}, {"success": "no"}, {"x": [1]}, [1], "text", None, 7])
results = st.sampled_from([True, False, None, 3, "yes"])
actions = st.one_of(
    st.tuples(st.just("offer"), services, types),
    st.tuples(st.just("take back"), services, st.none()),
    st.tuples(st.just("call"), services, st.sampled_from([None, 0.5, 3.0])),
    st.tuples(st.just("answer"), values, results),
    st.tuples(st.just("answer"), values, results),
    st.tuples(st.just("wait"), st.sampled_from([0.0, 1.0]), st.none()),
    st.tuples(st.just("leave"), st.none(), st.none()),
)


class Program:
    """One client, and what it was asked."""

    def __init__(self, peer: Peer) -> None:
        self.peer = peer
        self.is_there = True
        self.pending: list[Any] = []
        self.calls: list[int] = []
        self.answers: list[Any] = []

    def read(self) -> None:
        for heard in self.peer.received():
            if heard["op"] == "call_service":
                self.pending.append(heard)
            elif heard["op"] == "service_response":
                self.answers.append(heard["id"])

    def act(self, action: tuple[str, Any, Any], number: int) -> None:
        kind, what, more = action
        match kind:
            case "offer":
                self.peer.send(op="advertise_service", service=what, type=more)
            case "take back":
                self.peer.send(op="unadvertise_service", service=what)
            case "call":
                self.calls.append(number)
                self.peer.send(op="call_service", id=number, service=what, timeout=more)
            case "answer" if self.pending:
                pending = self.pending.pop(0)
                response = {"op": "service_response", "id": pending["id"], "service": pending["service"]}
                self.peer.client.receive(json.dumps(response | {"values": what, "result": more}))
            case "leave":
                self.is_there = False
                self.peer.client.participant.leave()


@given(st.lists(st.tuples(st.integers(0, PEERS - 1), actions), max_size=40))
@within(world)
async def test_every_call_is_answered_exactly_once(
    here: World, response: list[tuple[int, tuple[str, Any, Any]]]
) -> None:
    programs = [Program(here.client()) for _ in range(PEERS)]
    for number, (who, action) in enumerate(response):
        if programs[who].is_there:
            programs[who].act(action, number)
        await asyncio.sleep(action[1] if action[0] == "wait" else 0)
        for program in programs:
            program.read()
    await asyncio.sleep(100)  # virtual: every deadline is over
    for program in programs:
        program.read()
        if program.is_there:
            assert sorted(program.answers) == program.calls
            program.peer.client.participant.leave()
    assert all(name.startswith("/rosapi/") for name, _ in here.hub.services.all())
