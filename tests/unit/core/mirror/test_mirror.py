"""Endpoints follow what is wanted: at once, in slices of time, again after a failure, and each by itself."""

import asyncio
import math
from dataclasses import dataclass, field

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.core.mirror.mirror import Mirror
from hostlink.errors import HostlinkError
from tests.support.virtual_loop import VirtualLoop, virtual

COST_S = 0.001  # to open an endpoint, and to close it
Keys = st.lists(st.sampled_from("abcdefgh"), unique=True)


@dataclass
class Peer:
    """The other graph."""

    present: list[str] = field(default_factory=list)
    refused: set[str] = field(default_factory=set)
    failures: list[str] = field(default_factory=list)

    def open(self, key: str, _spec: str) -> "Endpoint":
        burn()
        if key in self.refused:
            raise HostlinkError(key)
        assert key not in self.present
        self.present.append(key)
        return Endpoint(self, key)

    def fail(self, key: str, error: Exception) -> None:
        assert isinstance(error, HostlinkError | ZeroDivisionError)
        self.failures.append(key)


@dataclass
class Endpoint:
    peer: Peer
    key: str

    def close(self) -> None:
        burn()
        self.peer.present.remove(self.key)
        if f"close {self.key}" in self.peer.refused:
            raise ZeroDivisionError


def burn() -> None:
    loop = asyncio.get_running_loop()
    if isinstance(loop, VirtualLoop):
        loop.burn(COST_S)


def mirror_to(peer: Peer, *, slice_s: float = math.inf, retry_s: float = math.inf) -> Mirror[str, str, Endpoint]:
    return Mirror(peer.open, peer.fail, slice_s=slice_s, retry_s=retry_s)


def wanted(keys: str) -> dict[str, str]:
    return dict.fromkeys(keys, "x")


@given(st.lists(st.tuples(Keys, Keys, st.booleans())), Keys, st.sampled_from([0.003, math.inf]))
@virtual
async def test_any_history_ends_in_what_is_wanted_last(
    history: list[tuple[list[str], list[str], bool]], last: list[str], slice_s: float
) -> None:
    peer = Peer()
    mirror = mirror_to(peer, slice_s=slice_s, retry_s=1.0)
    for keys, refused, is_waiting in history:
        peer.refused = {*refused, *(f"close {key}" for key in refused)}
        mirror.want(wanted("".join(keys)))
        await asyncio.sleep(1.0 if is_waiting else 0.0)
    peer.refused.clear()
    mirror.want(wanted("".join(last)))
    await asyncio.sleep(2.0)
    assert sorted(peer.present) == sorted(mirror.endpoints) == sorted(last)
    mirror.close()
    assert peer.present == []
    mirror.want(wanted("a"))
    await asyncio.sleep(2.0)
    assert peer.present == []


@virtual
async def test_without_slices_everything_is_done_at_once() -> None:
    peer = Peer()
    mirror = mirror_to(peer)
    mirror.want(wanted("abc"))
    assert peer.present == ["a", "b", "c"]
    mirror.put("b", None)
    mirror.put("d", "x")
    assert peer.present == ["a", "c", "d"]
    mirror.close()


@virtual
async def test_a_slice_ends_in_time_and_the_next_leaves_as_much_to_others() -> None:
    peer, loop = Peer(), asyncio.get_running_loop()
    mirror = mirror_to(peer, slice_s=0.003)
    began_s = loop.time()
    mirror.want(wanted("abcdefgh"))
    assert loop.time() - began_s <= 0.003 + COST_S
    assert peer.present == ["a", "b", "c"]
    mirror.want(wanted("abcdefgh"))
    assert peer.present == ["a", "b", "c"]
    await asyncio.sleep(0.002)
    assert peer.present == ["a", "b", "c"]
    await asyncio.sleep(1.0)
    assert len(peer.present) == 8
    mirror.close()


@virtual
async def test_endpoint_wanted_only_during_a_pause_is_never_opened() -> None:
    peer = Peer()
    mirror = mirror_to(peer, slice_s=COST_S / 2)
    mirror.want(wanted("ab"))
    mirror.want(wanted("abc"))
    mirror.want(wanted("a"))
    await asyncio.sleep(1.0)
    assert peer.present == ["a"]
    mirror.close()


@virtual
async def test_a_failure_affects_no_other_endpoint_and_is_tried_again_in_time() -> None:
    peer = Peer(refused={"b", "close a"})
    mirror = mirror_to(peer, retry_s=1.0)
    mirror.want(wanted("abc"))
    assert peer.present == ["a", "c"]
    mirror.want(wanted("bcd"))
    assert peer.present == ["c", "d"]
    assert peer.failures == ["b", "a"]
    peer.refused.clear()
    await asyncio.sleep(0.9)
    assert peer.present == ["c", "d"]
    await asyncio.sleep(0.2)
    assert sorted(peer.present) == ["b", "c", "d"]
    mirror.close()


@virtual
async def test_a_failure_is_tried_again_on_request() -> None:
    peer = Peer(refused={"a"})
    mirror = mirror_to(peer)
    mirror.want(wanted("a"))
    peer.refused.clear()
    mirror.retry()
    assert peer.present == ["a"]
    mirror.close()


@virtual
async def test_a_report_that_raises_stops_the_rest_for_a_turn_of_the_loop_only() -> None:
    peer = Peer(refused={"a", "close b", "close c"})

    def fail(key: str, error: Exception) -> None:
        raise AssertionError(key) from error

    mirror: Mirror[str, str, Endpoint] = Mirror(peer.open, fail)
    with pytest.raises(AssertionError):
        mirror.want(wanted("abcd"))
    errors: list[object] = []
    asyncio.get_running_loop().set_exception_handler(lambda _, context: errors.append(context))
    await asyncio.sleep(0.1)
    assert peer.present == ["b", "c", "d"]
    with pytest.raises(AssertionError):
        mirror.close()
    await asyncio.sleep(0.1)
    assert peer.present == []
    assert len(errors) == 1


@virtual
async def test_endpoint_that_changes_the_wanted_ones_while_it_is_opened_starts_no_nested_loop() -> None:
    peer = Peer()

    def open_(key: str, spec: str) -> Endpoint:
        made = peer.open(key, spec)
        if key == "a":
            mirror.put("b", "x")
            assert peer.present == ["a"]
        return made

    mirror: Mirror[str, str, Endpoint] = Mirror(open_, peer.fail)
    mirror.put("a", "x")
    assert peer.present == ["a", "b"]
    mirror.close()


@virtual
async def test_an_endpoint_that_ended_by_itself_is_opened_again_in_time() -> None:
    peer = Peer()
    mirror = mirror_to(peer, retry_s=1.0)
    mirror.want(wanted("a"))
    peer.present.clear()
    mirror.ended("a")
    mirror.ended("a")
    assert mirror.endpoints == {}
    await asyncio.sleep(1.1)
    assert peer.present == ["a"]
    mirror.close()


class Tasks:
    """Endpoints that are tasks."""

    def __init__(self, tasks: asyncio.TaskGroup, *, retry_s: float = 1.0) -> None:
        self.running: list[str] = []
        self.failures: list[str] = []
        self.errors: dict[str, Exception] = {}
        self.ends: set[str] = set()
        self.began: list[str] = []
        self.mirror = Mirror.of_tasks(self.serve, tasks.create_task, self.fail, retry_s=retry_s, longest_s=8.0)

    async def serve(self, key: str, _spec: str) -> None:
        assert key not in self.running
        self.began.append(key)
        self.running.append(key)
        try:
            await asyncio.sleep(0.5)
            if key in self.errors:
                raise self.errors[key]
            if key not in self.ends:
                await asyncio.Event().wait()
        finally:
            self.running.remove(key)

    def fail(self, key: str, error: Exception) -> None:
        assert error is self.errors[key]
        self.failures.append(key)


@virtual
async def test_tasks_run_until_they_are_closed_and_begin_again_after_a_failure_or_an_end() -> None:
    async with asyncio.TaskGroup() as tasks:
        served = Tasks(tasks)
        served.errors["a"] = HostlinkError("a")
        served.ends.add("b")
        served.mirror.want(wanted("abc"))
        await asyncio.sleep(0.6)
        assert served.running == ["c"]
        assert served.failures == ["a"]
        await asyncio.sleep(1.0)
        assert sorted(served.running) == ["a", "b", "c"]
        await asyncio.sleep(0.9)  # again half a second, then two seconds for the failure, one for the end
        assert served.running == ["c"]
        await asyncio.sleep(0.7)
        assert sorted(served.running) == ["b", "c"]
        served.mirror.put("c", None)
        await asyncio.sleep(0)
        assert served.running == ["b"]
        served.mirror.close()
        await asyncio.sleep(10.0)
        assert served.running == []
    assert served.began[:3] == ["a", "b", "c"]


@virtual
async def test_a_task_that_was_closed_before_it_began_never_begins() -> None:
    async with asyncio.TaskGroup() as tasks:
        served = Tasks(tasks)
        served.mirror.want(wanted("a"))
        served.mirror.close()
    assert served.began == []


@virtual
async def test_a_task_that_fails_while_it_is_closed_leaves_the_next_one_of_its_key_alone() -> None:
    failures: list[str] = []
    began = 0

    async def serve(key: str, spec: str) -> None:
        nonlocal began
        began += 1
        try:
            await asyncio.Event().wait()
        finally:
            if spec == "old":
                raise HostlinkError(key)

    async with asyncio.TaskGroup() as tasks:
        mirror = Mirror.of_tasks(
            serve, tasks.create_task, lambda key, error: failures.append(f"{key}: {error}"), retry_s=1.0
        )
        mirror.put("a", "old")
        await asyncio.sleep(0)
        mirror.put("a", "new")
        await asyncio.sleep(10.0)
        assert began == 2
        assert failures == ["a: a"]
        assert list(mirror.endpoints) == ["a"]
        mirror.close()


@virtual
async def test_endpoint_without_room_is_counted() -> None:
    peer, crowded = Peer(), list[str]()
    mirror: Mirror[str, str, Endpoint] = Mirror(peer.open, peer.fail, limit=2, on_crowded=crowded.append)
    mirror.want(wanted("abcde"))
    assert crowded == ["c", "d", "e"]
    mirror.close()
