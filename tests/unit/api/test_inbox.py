"""Inbox: the order of a client's operations, and which velocities newer ones replace."""

from dataclasses import dataclass, field

from hypothesis import given
from hypothesis import strategies as st

from hostlink.api.inbox import MANY, MAX_BYTES, MAX_MESSAGES, Inbox, Operation
from tests.support.virtual_loop import run_virtual


@dataclass
class Program:
    """Messages are words; `robot=2` is a velocity."""

    done: list[str] = field(default_factory=list)
    replaced: list[str] = field(default_factory=list)
    came_s: dict[str, float] = field(default_factory=dict)

    def read(self, data: str | bytes, came_s: float) -> Operation[str]:
        word = str(data)
        robot, is_velocity, value = word.partition("=")
        return Operation(word, came_s, robot if is_velocity else None, value == "0")

    def do(self, operation: Operation[str]) -> None:
        self.done.append(operation.content)
        self.replaced += operation.replaced
        self.came_s[operation.content] = operation.came_s


def inbox(program: Program) -> Inbox[str]:
    return Inbox(program, lambda: None)


def outcome(*words: str) -> Program:
    """Return the executed words of words that arrive at once."""

    async def run() -> Program:
        program = Program()
        box = inbox(program)
        for word in words:
            box.put(word, 0.0)
        while len(box):
            box.work()
        return program

    return run_virtual(run())


def test_velocities_of_one_robot_only_the_newest_is_executed() -> None:
    program = outcome("a=1", "a=2", "b=1", "a=3")
    assert program.done == ["b=1", "a=3"]
    assert program.replaced == ["a=1", "a=2"]


def test_zero_is_never_replaced_and_replaces_velocities() -> None:
    assert outcome("a=1", "a=0", "a=2", "a=0", "a=0").done == ["a=0", "a=0", "a=0"]
    assert outcome("a=0", "a=1").done == ["a=0", "a=1"]


def test_velocity_overtakes_no_operation() -> None:
    assert outcome("a=1", "stop", "a=2", "lock").done == ["stop", "a=2", "lock"]


@given(st.lists(st.sampled_from(["a=0", "a=1", "a=2", "b=0", "b=7", "stop", "call"]), max_size=20))
def test_only_velocities_before_a_newer_one_of_their_robot_are_replaced(words: list[str]) -> None:
    program = outcome(*words)
    kept = [
        word
        for number, word in enumerate(words)
        if "=" not in word or word.endswith("=0") or not any(later[:2] == word[:2] for later in words[number + 1 :])
    ]
    assert program.done == kept
    assert len(program.done) + len(program.replaced) == len(words)


def test_waiting_velocity_is_replaced_while_others_are_executed() -> None:
    async def run() -> Program:
        program = Program()
        box = inbox(program)
        for word in ("call", "a=1"):
            box.put(word, 0.0)
        box.work()
        box.put("a=2", 0.0)
        while len(box):
            box.work()
        return program

    assert run_virtual(run()).done == ["call", "a=2"]


def test_message_available_without_waiting_is_as_old_as_the_one_before() -> None:
    program = Program()
    box = inbox(program)
    for word, came_s, was_awaited in (("first", 1.0, True), ("second", 9.0, False), ("third", 9.0, True)):
        box.is_behind = True
        if was_awaited:
            box.note_wait()
        box.put(word, came_s)
    while len(box):
        box.work()
    assert program.came_s == {"first": 1.0, "second": 1.0, "third": 9.0}


def test_inbox_over_its_bound_is_flooding_until_none_waits() -> None:
    box = inbox(Program())
    for _ in range(MANY + 1):
        assert not box.is_flooding
        box.put("call", 0.0)
    assert box.is_flooding
    for _ in range(MANY):
        box.work()
    assert box.is_flooding
    box.work()
    assert not box.is_flooding


def test_inbox_over_its_bytes_has_no_room_until_they_are_executed() -> None:
    box = inbox(Program())
    box.put("x" * MAX_BYTES, 0.0)
    assert box.has_room
    box.put("x", 0.0)
    assert not box.has_room
    box.work()
    assert not box.has_room
    box.work()
    assert box.has_room


def test_inbox_over_its_messages_has_no_room_until_half_are_executed() -> None:
    box = inbox(Program())
    for _ in range(MAX_MESSAGES + 1):
        assert box.has_room
        box.put("call", 0.0)
    for _ in range(MAX_MESSAGES // 2 + 1):
        assert not box.has_room
        box.work()
    assert box.has_room
