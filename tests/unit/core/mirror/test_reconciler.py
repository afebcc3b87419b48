"""Any history of wanted, forgotten and refused endpoints ends with the wanted ones open, within the bounds."""

import math
from collections import Counter
from dataclasses import dataclass, field

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from hostlink.core.mirror.reconciler import Close, Open, Reconciler

KEYS = st.integers(0, 11)
SPECS = st.sampled_from("abc")
RETRY_S, LONGEST_S = 1.0, 4.0


def group_of(key: int) -> int:
    return key % 3


@dataclass
class Peer:
    """The other graph: what is open there, and which keys it refuses."""

    open: dict[int, str] = field(default_factory=dict)
    refused: set[int] = field(default_factory=set)
    replaces: bool = False

    def perform(self, action: Open[int, str] | Close[int, str]) -> bool:
        """Returns whether it was done; what must not be done is an error of the test."""
        if isinstance(action, Close):
            assert self.open.pop(action.key) == action.spec, "closed as it was opened, once"
            return True
        assert self.replaces or action.key not in self.open, "opened twice"
        assert self.open.get(action.key) != action.spec, "opened again as it is"
        if action.key in self.refused:
            return False
        self.open[action.key] = action.spec
        return True


class Histories(RuleBasedStateMachine):
    """Both graphs change in any order, and the work is done in pieces of any size."""

    @initialize(
        replaces=st.booleans(),
        limit=st.sampled_from([math.inf, 5]),
        group_limit=st.sampled_from([math.inf, 2]),
        retry_s=st.sampled_from([RETRY_S, math.inf]),
    )
    def begin(self, *, replaces: bool, limit: float, group_limit: float, retry_s: float) -> None:
        self.limit, self.group_limit, self.retry_s = limit, group_limit, retry_s
        self.reconciler: Reconciler[int, str] = Reconciler(
            limit=limit,
            group_of=group_of,
            group_limit=group_limit,
            retry_s=retry_s,
            longest_s=LONGEST_S,
            replaces=replaces,
        )
        self.peer, self.wanted, self.now_s = Peer(replaces=replaces), dict[int, str](), 0.0

    @rule(wanted=st.dictionaries(KEYS, SPECS))
    def want(self, wanted: dict[int, str]) -> None:
        self.wanted = dict(wanted)
        self.reconciler.want(wanted)

    @rule(key=KEYS, spec=st.none() | SPECS)
    def put(self, key: int, spec: str | None) -> None:
        if spec is None:
            self.wanted.pop(key, None)
        else:
            self.wanted[key] = spec
        self.reconciler.put(key, spec)

    @rule(key=KEYS)
    def refuse(self, key: int) -> None:
        self.peer.refused ^= {key}

    @rule(steps=st.integers(1, 8))
    def work(self, steps: int) -> None:
        for _ in range(steps):
            self.step()

    @rule(keys=st.sets(KEYS))
    def forget(self, keys: set[int]) -> None:
        for key in keys:
            self.peer.open.pop(key, None)
        self.reconciler.forget(keys)

    @rule(data=st.data(), has_failed=st.booleans())
    @precondition(lambda self: self.peer.open)
    def end(self, data: st.DataObject, *, has_failed: bool) -> None:
        key = data.draw(st.sampled_from(sorted(self.peer.open)))
        del self.peer.open[key]
        self.reconciler.ended(key, self.now_s, has_failed=has_failed)

    @rule(seconds=st.sampled_from([0.5, 1.0, 5.0]))
    def wait(self, seconds: float) -> None:
        self.now_s += seconds

    @rule()
    def retry(self) -> None:
        self.reconciler.retry()

    @rule()
    def settle(self) -> None:
        """Final state when every endpoint is accepted: it depends only on the wanted ones."""
        self.peer.refused.clear()
        self.reconciler.retry()
        for _ in range(100):
            if not self.step():
                break
        else:
            pytest.fail("the work has no end")
        assert self.peer.open.items() <= self.wanted.items()
        kept = Counter(map(group_of, self.peer.open))
        for key in self.wanted.keys() - self.peer.open.keys():
            assert len(self.peer.open) == self.limit or kept[group_of(key)] == self.group_limit, "there is room"

    @invariant()
    def what_is_open_is_known_and_bounded(self) -> None:
        if not hasattr(self, "peer"):
            return
        assert self.reconciler.open == self.peer.open
        assert len(self.peer.open) <= self.limit
        assert all(count <= self.group_limit for count in Counter(map(group_of, self.peer.open)).values())
        tried = set(self.reconciler._failures) if self.retry_s < math.inf else set()
        assert self.reconciler._places == self.peer.open.keys() | tried
        assert self.reconciler._sizes == Counter(map(group_of, self.reconciler._places))
        assert len(self.reconciler._places) <= self.limit
        assert len(self.reconciler._due) <= 64 + 2 * 12 + 1
        known = {*self.wanted, *self.peer.open}
        assert self.reconciler._failures.keys() <= known
        assert {key for keys in self.reconciler._crowded.values() for key in keys} <= known

    def step(self) -> bool:
        action = self.reconciler.next(self.now_s)
        assert self.reconciler.next(self.now_s) == action, "the same until it is reported"
        if action is None:
            return False
        if isinstance(action, Close):
            assert self.wanted.get(action.key) != action.spec, "closed although it is wanted"
        else:
            assert self.wanted[action.key] == action.spec
            stays = {key for key, spec in self.peer.open.items() if self.wanted.get(key) == spec}
            assert self.peer.replaces or stays == self.peer.open.keys(), "opened before everything is closed"
            assert self.peer.open.keys() <= self.wanted.keys()
        if self.peer.perform(action):
            self.reconciler.done(action)
        else:
            assert isinstance(action, Open)
            self.reconciler.failed(action, self.now_s)
        return True


TestHistories = Histories.TestCase
TestHistories.settings = settings(max_examples=max(60, settings().max_examples), stateful_step_count=40)


def opened(reconciler: Reconciler[str, str], now_s: float = 0.0, refused: str = "") -> list[str]:
    """Do everything; returns the keys to open in order, also those that are refused."""
    keys = []
    while (action := reconciler.next(now_s)) is not None:
        if isinstance(action, Open):
            keys.append(action.key)
            if action.key in refused:
                reconciler.failed(action, now_s)
                continue
        reconciler.done(action)
    return keys


def wanted(keys: str) -> dict[str, str]:
    return dict.fromkeys(keys, "x")


def test_endpoints_are_opened_in_the_order_in_which_they_are_wanted() -> None:
    reconciler: Reconciler[str, str] = Reconciler()
    reconciler.want(wanted("cab"))
    reconciler.want(wanted("bca"))
    assert opened(reconciler) == ["b", "c", "a"]


def test_a_failure_is_tried_again_later_each_time() -> None:
    reconciler: Reconciler[str, str] = Reconciler(retry_s=1.0, longest_s=4.0)
    reconciler.want(wanted("a"))
    attempts = [at_s / 10 for at_s in range(200) if opened(reconciler, at_s / 10, refused="a")]
    assert attempts == [0.0, 1.0, 3.0, 7.0, 11.0, 15.0, 19.0]
    assert reconciler.due_s == 23.0


def test_a_failure_without_a_time_is_tried_again_with_another_specification_or_on_request() -> None:
    reconciler: Reconciler[str, str] = Reconciler()
    reconciler.want(wanted("ab"))
    assert opened(reconciler, refused="a") == ["a", "b"]
    reconciler.want(wanted("ab"))
    assert opened(reconciler, 1e9) == []
    assert reconciler.due_s == math.inf
    reconciler.retry()
    assert opened(reconciler, refused="a") == ["a"]
    reconciler.put("a", "y")
    assert opened(reconciler) == ["a"]


def test_a_success_makes_the_next_failure_the_first() -> None:
    reconciler: Reconciler[str, str] = Reconciler(retry_s=1.0, longest_s=8.0)
    reconciler.want(wanted("a"))
    assert opened(reconciler, 0.0, refused="a") == ["a"]
    assert opened(reconciler, 1.0) == ["a"]
    reconciler.ended("a", 2.0, has_failed=True)
    assert reconciler.due_s == 3.0


def test_endpoint_that_the_peer_forgot_is_opened_at_once_and_its_next_failure_is_the_first() -> None:
    reconciler: Reconciler[str, str] = Reconciler(retry_s=1.0, longest_s=8.0)
    reconciler.want(wanted("a"))
    assert opened(reconciler, 0.0, refused="a") == ["a"]
    reconciler.done(Open("a", "x"), is_settled=False)
    reconciler.forget("ab")
    assert opened(reconciler, 0.5, refused="a") == ["a"]
    assert opened(reconciler, 1.4) == []
    assert opened(reconciler, 1.5) == ["a"]


@pytest.mark.parametrize(("has_failed", "expected_s"), [(True, 5.0), (False, 4.0)])
def test_end_of_an_endpoint_restarts_the_delay_and_a_failure_continues_it(
    *, has_failed: bool, expected_s: float
) -> None:
    reconciler: Reconciler[str, str] = Reconciler(retry_s=1.0, longest_s=8.0)
    reconciler.want(wanted("a"))
    assert opened(reconciler, 0.0, refused="a") == ["a"]
    action = reconciler.next(1.0)
    assert action == Open("a", "x")
    reconciler.done(action, is_settled=False)
    reconciler.ended("a", 3.0, has_failed=has_failed)
    assert opened(reconciler, expected_s - 0.1) == []
    assert opened(reconciler, expected_s) == ["a"]


def test_endpoint_without_room_is_opened_after_another_leaves_and_is_counted_once() -> None:
    crowded: list[str] = []
    reconciler: Reconciler[str, str] = Reconciler(limit=2, on_crowded=crowded.append)
    for _ in range(3):
        reconciler.want(wanted("abcd"))
        opened(reconciler)
    assert list(reconciler.open) == ["a", "b"]
    assert crowded == ["c", "d"]
    reconciler.want(wanted("bcd"))
    assert opened(reconciler) == ["c"]
    assert crowded == ["c", "d"]


def test_an_endpoint_with_another_specification_keeps_its_place() -> None:
    reconciler: Reconciler[str, str] = Reconciler(limit=1)
    reconciler.want(wanted("ab"))
    assert opened(reconciler) == ["a"]
    reconciler.want({"a": "y", "b": "x"})
    assert opened(reconciler) == ["a"]


def test_a_failure_that_is_not_tried_again_leaves_its_place_to_others() -> None:
    reconciler: Reconciler[str, str] = Reconciler(limit=1, on_crowded=pytest.fail)
    reconciler.want(wanted("ab"))
    assert opened(reconciler, refused="a") == ["a", "b"]


def test_a_failure_that_is_tried_again_keeps_its_place() -> None:
    crowded: list[str] = []
    reconciler: Reconciler[str, str] = Reconciler(limit=1, retry_s=1.0, on_crowded=crowded.append)
    reconciler.want(wanted("ab"))
    for at_s in (0.0, 1.0, 2.0):
        assert opened(reconciler, at_s, refused="a") == ["a"]
    assert crowded == ["b"]
    reconciler.put("a", None)
    assert opened(reconciler, 2.0) == ["b"]


def test_a_failure_of_an_earlier_time_does_not_shorten_the_next_pause() -> None:
    reconciler: Reconciler[str, str] = Reconciler(retry_s=1.0)
    reconciler.want(wanted("a"))
    assert opened(reconciler, 0.0, refused="a") == ["a"]
    reconciler.want({})
    reconciler.want(wanted("a"))
    assert opened(reconciler, 0.5, refused="a") == ["a"]
    assert opened(reconciler, 1.4) == []
    assert opened(reconciler, 1.5) == ["a"]


def test_specification_that_is_wanted_again_before_anything_was_done_is_left_alone() -> None:
    for replaces in (False, True):
        reconciler: Reconciler[str, str] = Reconciler(replaces=replaces)
        reconciler.want({"a": "x"})
        opened(reconciler)
        for other in ({}, {"a": "y"}):
            reconciler.want(other)
            reconciler.want({"a": "x"})
            assert reconciler.next(0.0) is None


def test_failure_of_a_specification_that_was_not_wanted_meanwhile_is_forgotten() -> None:
    reconciler: Reconciler[str, str] = Reconciler(replaces=True)
    reconciler.want({"a": "x"})
    opened(reconciler)
    for _ in range(2):
        reconciler.want({"a": "y"})
        assert opened(reconciler, refused="a") == ["a"]
        reconciler.want({"a": "x"})
        assert opened(reconciler) == []


def test_endpoint_that_is_not_replaced_stays() -> None:
    reconciler: Reconciler[str, str] = Reconciler(replaces=True)
    reconciler.want({"a": "x"})
    assert opened(reconciler) == ["a"]
    reconciler.want({"a": "y"})
    assert opened(reconciler, refused="a") == ["a"]
    assert reconciler.open == {"a": "x"}


def test_a_group_over_its_bound_keeps_no_other_out() -> None:
    reconciler: Reconciler[int, str] = Reconciler(group_of=group_of, group_limit=1)
    reconciler.want(dict.fromkeys([0, 3, 6, 1], "x"))
    while (action := reconciler.next(0.0)) is not None:
        reconciler.done(action)
    assert list(reconciler.open) == [0, 1]
    reconciler.put(0, None)
    while (action := reconciler.next(0.0)) is not None:
        reconciler.done(action)
    assert list(reconciler.open) == [1, 3]


def test_a_specification_that_is_the_same_by_the_adapters_word_stays_open() -> None:
    reconciler: Reconciler[str, str] = Reconciler(is_same=lambda before, now: before in ("", now))
    reconciler.want({"a": "", "b": "x"})
    opened(reconciler)
    reconciler.want({"a": "learned", "b": ""})
    assert opened(reconciler) == ["b"]
    assert reconciler.open == {"a": "", "b": ""}


def test_a_specification_is_replaced_without_a_close_where_the_peer_replaces_it() -> None:
    reconciler: Reconciler[str, str] = Reconciler(replaces=True, limit=1)
    reconciler.want({"a": "x"})
    opened(reconciler)
    reconciler.want({"a": "y"})
    assert reconciler.next(0.0) == Open("a", "y")
    assert opened(reconciler) == ["a"]
    assert reconciler.open == {"a": "y"}


def test_peers_that_come_and_go_with_failures_leave_nothing_behind() -> None:
    reconciler: Reconciler[str, str] = Reconciler(retry_s=1e6)
    for number in range(1000):
        reconciler.want({str(number): "x"})
        action = reconciler.next(float(number))
        assert isinstance(action, Open)
        reconciler.failed(action, float(number))
    assert len(reconciler._due) < 200
