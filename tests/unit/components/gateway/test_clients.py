"""OperationQueue: the order of a client's operations, its bounds, and which velocities newer ones replace."""

from dataclasses import dataclass, field

import pytest
from aiohttp import web
from aiohttp.test_utils import make_mocked_request
from hypothesis import given
from hypothesis import strategies as st

from hostlink.components.gateway.access import GRANT, Grant
from hostlink.components.gateway.clients import (
    FEW,
    MANY,
    MAX_BYTES,
    MAX_MESSAGES,
    OPERATION_BYTES,
    ClientQueue,
    Clients,
    Operation,
    OperationQueue,
    VelocityOf,
)
from hostlink.core.hub.byte_budget import ByteBudget, Share
from hostlink.core.hub.node import Role
from hostlink.core.robot.admission import UNORDERED_S
from tests.support.virtual_loop import run_virtual, virtual


@dataclass
class Program:
    """Messages are words. `a=2` is a velocity of the robot a, `a=2 epoch` one with other terms, `a:=2` another way."""

    done: list[str] = field(default_factory=list)
    replaced: list[str] = field(default_factory=list)
    came_s: dict[str, float] = field(default_factory=dict)
    calls: int = 0

    def flush(self, now_s: float) -> float | None: ...
    def close(self) -> None: ...

    def take(self, data: bytes, came_s: float) -> bool:
        if not (is_plain := b"=" in data):
            return False
        self.done.append(data.decode())
        self.came_s[data.decode()] = came_s
        return is_plain

    def read(self, data: str | bytes, came_s: float) -> Operation[str]:
        word = str(data)
        robot, is_velocity, rest = word.partition("=")
        value, _, terms = rest.partition(" ")
        velocity_of = VelocityOf(robot[1:], robot[0], terms) if is_velocity else None
        return Operation(word, came_s, velocity_of, value == "0")

    def do(self, operation: Operation[str]) -> None:
        self.done.append(operation.content)
        self.replaced += operation.replaced
        self.came_s[operation.content] = operation.came_s


def operations(program: Program, messages_s: float = 1000.0, share: Share | None = None) -> OperationQueue[str]:
    return OperationQueue(program, lambda: None, messages_s, ByteBudget()["operations"] if share is None else share)


def outcome(*words: str) -> Program:
    """Return the executed words of words that arrive at once."""

    async def run() -> Program:
        program = Program()
        box = operations(program)
        for word in words:
            box.put(word, 0.0, 0.0)
        while box.waiting:
            box.work()
        return program

    return run_virtual(run())


def test_velocities_of_one_robot_only_the_newest_is_executed() -> None:
    program = outcome("a=1", "a=2", "b=1", "a=3")
    assert program.done == ["b=1", "a=3"]
    assert program.replaced == ["a=1", "a=2"]


def test_velocity_that_came_much_before_a_newer_one_is_not_replaced_but_by_a_zero() -> None:
    """An interruption that came between them disarms its source by the older one."""

    def done(*came_s: float, last: str) -> list[str]:
        async def run() -> list[str]:
            program = Program()
            box = operations(program)
            for number, at_s in enumerate(came_s, 1):
                box.put(last if number == len(came_s) else f"a={number}", at_s, at_s)
            while box.waiting:
                box.work()
            return program.done

        return run_virtual(run())

    step_s = 0.6 * UNORDERED_S
    assert done(0.0, step_s, last="a=9") == ["a=9"]
    assert done(0.0, step_s, 2 * step_s, 3 * step_s, last="a=9") == ["a=2", "a=9"]
    assert done(0.0, step_s, 2 * step_s, 3 * step_s, last="a=0") == ["a=2", "a=0"]
    assert done(0.0, 9.0, last="a=0") == ["a=0"]


def test_first_velocity_that_waits_after_a_silence_is_replaced_by_a_zero_alone() -> None:
    """That operation shows the admission that the silence was that of the network."""

    def done(*pieces: tuple[float, str]) -> list[str]:
        async def run() -> list[str]:
            program = Program()
            box = operations(program)
            for came_s, words in pieces:
                for word in words.split():
                    box.put(word, came_s, came_s)
                while box.waiting:
                    box.work()
            return program.done

        return run_virtual(run())

    assert done((0.0, "a=1"), (0.4, "a=2 a=3 b=1 a=4")) == ["a=1", "b=1", "a=4"]
    assert done((0.0, "a=1"), (0.5, "a=2 a=3 b=1 a=4 b=2"), (0.9, "a=5 a=6 a=7"), (1.1, "a=8 a=9")) == [
        "a=1", "a=2", "b=1", "a=4", "b=2", "a=5", "a=7", "a=9",
    ]  # fmt: skip
    assert done((0.0, "a=1"), (0.5, "a=2 a=3 a=0")) == ["a=1", "a=2", "a=0"]
    assert done((0.0, "a=1"), (0.5, "a=2 a=0")) == ["a=1", "a=0"]


def test_zero_is_never_replaced_and_replaces_velocities() -> None:
    assert outcome("a=1", "a=0", "a=2", "a=0", "a=0").done == ["a=0", "a=0", "a=0"]
    assert outcome("a=0", "a=1").done == ["a=0", "a=1"]


def test_velocity_before_another_operation_is_not_replaced() -> None:
    assert outcome("a=1", "a=2", "stop", "a=3", "lock").done == ["a=2", "stop", "a=3", "lock"]
    assert outcome("a=1", "a:=2", "a=3").done == ["a=1", "a:=2", "a=3"]


def test_velocity_with_other_terms_is_not_replaced() -> None:
    words = ["a=1 epoch", "a=2", "a=0 epoch", "a=3 epoch"]
    assert outcome(*words).done == words
    assert outcome("a=1 epoch", "b=1", "a=2 epoch", "a=3").done == ["b=1", "a=2 epoch", "a=3"]


def is_replaced(word: str, later: list[str]) -> bool:
    """Whether the first later word that may decide about a velocity is one of the same robot, operation and terms."""
    way, _, terms = word.partition("=")
    for other in later:
        other_way, is_velocity, other_terms = other.partition("=")
        if not is_velocity or len(other_way) != len(way):
            return False
        if other_way == way:
            return other_terms[1:] == terms[1:]
    return False


WORDS = ["a=0", "a=1", "a=2", "a=3 epoch", "a=4 epoch", "a=0 epoch", "a:=1", "b=0", "b=7", "stop", "call"]


@given(st.lists(st.sampled_from(WORDS), max_size=20))
def test_only_velocities_before_a_newer_one_like_them_are_replaced(words: list[str]) -> None:
    program = outcome(*words)
    kept = [
        word
        for number, word in enumerate(words)
        if "=" not in word or "=0" in word or not is_replaced(word, words[number + 1 :])
    ]
    assert program.done == kept
    assert len(program.done) + len(program.replaced) == len(words)


@virtual
async def test_waiting_velocity_is_replaced_while_others_are_executed() -> None:
    program = Program()
    box = operations(program)
    for word in ("call", "a=1"):
        box.put(word, 0.0, 0.0)
    box.work()
    box.put("a=2", 0.0, 0.0)
    while box.waiting:
        box.work()
    assert program.done == ["call", "a=2"]


def test_message_available_without_waiting_is_as_old_as_the_one_before() -> None:
    program = Program()
    box = operations(program)
    for word, came_s, was_awaited in (("first", 1.0, True), ("second", 9.0, False), ("third", 9.0, True)):
        box.put(word, came_s, 9.0, is_behind=not was_awaited)
    while box.waiting:
        box.work()
    assert program.came_s == {"first": 1.0, "second": 1.0, "third": 9.0}


def test_operations_over_its_bound_is_flooding_until_none_waits() -> None:
    box = operations(Program())
    for _ in range(MANY + 1):
        assert not box.is_flooding
        box.put("call", 0.0, 0.0)
    assert box.is_flooding
    for _ in range(MANY):
        box.work()
    assert box.is_flooding
    box.work()
    assert not box.is_flooding


def test_operations_over_its_bytes_has_no_room_until_they_are_executed() -> None:
    box = operations(Program())
    box.put("x" * MAX_BYTES, 0.0, 0.0)
    assert box.has_room
    box.put("x", 0.0, 0.0)
    assert not box.has_room
    box.work()
    assert not box.has_room
    box.work()
    assert box.has_room


def test_operations_over_its_messages_has_no_room_until_half_are_executed() -> None:
    box = operations(Program())
    for _ in range(MAX_MESSAGES + 1):
        assert box.has_room
        box.put("call", 0.0, 0.0)
    for _ in range(MAX_MESSAGES // 2 + 1):
        assert not box.has_room
        box.work()
    assert box.has_room


def test_debt_of_a_client_that_sends_too_fast() -> None:
    box = operations(Program(), 10)
    debts_s = []
    for now_s in [5.0] * 12 + [5.2]:
        box.put("call", now_s, now_s)
        debts_s.append(round(box.debt_s, 6))
    assert debts_s == [0.0] * 10 + [0.1, 0.2, 0.1]


@given(st.floats(1, 1000), st.integers(0, 200))
def test_client_that_waits_for_its_debt_never_exceeds_rate_and_burst(messages_s: float, count: int) -> None:
    box, now_s = operations(Program(), messages_s), 0.0
    for _ in range(count):
        box.put("call", now_s, now_s)
        now_s += box.debt_s
    assert count <= messages_s * now_s + messages_s + 1e-6


async def test_clients_count_dropped_messages_of_disconnected_clients() -> None:
    clients, request = Clients(2, max_per_address=2), make_mocked_request("GET", "/")
    request[GRANT] = Grant("", Role.DRIVE)
    queue = ClientQueue()
    queue.dropped = 3
    slow, stream = clients.enter("rosbridge", request, queue), clients.enter("events", request)
    assert [view["kind"] for view in clients.views()] == ["rosbridge", "events"]
    with pytest.raises(web.HTTPServiceUnavailable):
        clients.enter("events", request)
    clients.leave(slow)
    clients.leave(stream)
    assert (clients.gone_dropped, clients.refused, clients.views()) == (3, 1, [])


def test_clients_that_together_have_too_many_operations_have_few_each_and_all_are_executed() -> None:
    share = Share(1000 * OPERATION_BYTES)
    programs = [Program() for _ in range(100)]
    boxes = [operations(program, share=share) for program in programs]
    left = [list(map(str, range(300))) for _ in boxes]
    most = 0
    while any(left):
        for box, words in zip(boxes, left, strict=True):
            while words and box.has_room:
                box.put(words.pop(0), 0.0, 0.0)
            most = max(most, share.held_bytes)
            box.work()
    assert most < 1.1 * (1000 + len(boxes) * FEW) * OPERATION_BYTES
    for box, program in zip(boxes, programs, strict=True):
        while box.waiting:
            box.work()
        assert program.done == list(map(str, range(300)))
    assert share.held_bytes == 0


def test_client_that_has_ended_gives_the_room_of_what_waited_back() -> None:
    share = Share(1000 * OPERATION_BYTES)
    box = operations(Program(), share=share)
    box.put("a", 0.0, 0.0)
    assert share.held_bytes > 0
    box.close()
    assert share.held_bytes == 0


# -- at once ----------------------------------------------------------------------------------------------------------


@virtual
async def test_velocity_is_executed_at_once_while_nothing_waits() -> None:
    program = Program()
    box = operations(program)
    assert box.take(b"a=1", 1.0, 1.5)
    assert (program.done, program.came_s) == (["a=1"], {"a=1": 1.0})
    assert not box.take(b"word", 1.0, 1.5)
    box.put("a=2", 1.6, 1.6)
    assert not box.take(b"a=3", 1.6, 1.6)
    box.work()
    assert box.take(b"a=3", 1.7, 1.7)
    assert program.done == ["a=1", "a=2", "a=3"]


@virtual
async def test_velocity_at_once_counts_for_the_rate_of_messages() -> None:
    program = Program()
    box = operations(program, messages_s=10.0)
    assert [box.take(b"a=1", 5.0, 5.0) for _ in range(12)] == [True] * 10 + [False] * 2
    assert box.debt_s == 0.0  # what is refused here is counted when it is put into the queue
    box.put("a=1", 5.0, 5.0)
    assert box.debt_s == pytest.approx(0.1)
    box.work()
    assert not box.take(b"a=1", 5.1, 5.1)
    assert box.take(b"a=1", 5.25, 5.25)


@virtual
async def test_velocity_at_once_ends_the_silence_of_a_connection() -> None:
    """The first velocity of those that waited through a silence is kept; this one has shown that there was none."""
    program = Program()
    box = operations(program)
    box.put("a=1", 1.0, 1.0)
    box.work()
    for number in range(12):
        box.take(b"a=2", 1.1 + number / 10, 1.1 + number / 10)
    for word in ("a=3", "a=4"):
        box.put(word, 2.3, 2.3)
    while box.waiting:
        box.work()
    assert program.done == ["a=1", *["a=2"] * 12, "a=4"]
