"""Parameters that were subscribed to, and the updates that the master sends; {} is a parameter that is not set."""

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.components.ros1.master import MAX_CHARS, MAX_ITEMS, MAX_KEYS, MAX_PARTS, ParameterCache


def cache() -> ParameterCache:
    made = ParameterCache()
    made.put("/node", {"speed": 1.5, "arm": {"joints": [1, 2]}})
    made.put("/rate", 10)
    made.put("/missing", {})
    return made


def test_subscribed_key_is_known_when_it_is_not_set() -> None:
    assert cache().find("/rate") == (True, 10)
    assert cache().find("/missing") == (True, None)
    assert cache().find("/other") == (False, None)


def test_parameter_below_a_subscribed_key_is_known() -> None:
    assert cache().find("/node/arm/joints") == (True, [1, 2])
    assert cache().find("/node/leg") == (True, None)
    assert cache().find("/node/speed/deeper") == (True, None)
    assert cache().find("/nodes") == (False, None)


def test_an_update_of_a_key() -> None:
    made = cache()
    made.update("/rate/", 20)
    made.update("/missing", "here")
    made.update("/unasked", 1)
    assert [made.find(name)[1] for name in ("/rate", "/missing", "/unasked")] == [20, "here", None]


def test_an_update_below_a_key() -> None:
    made = cache()
    made.update("/node/speed/", 2.5)
    made.update("/node/leg/left/", {"length": 3})
    assert made.find("/node/speed") == (True, 2.5)
    assert made.find("/node/leg/left/length") == (True, 3)
    assert made.find("/node/arm/joints") == (True, [1, 2])


def test_a_parameter_that_was_deleted_is_not_set() -> None:
    made = cache()
    made.update("/rate", {})
    made.update("/node/speed", {})
    assert made.find("/rate") == made.find("/node/speed") == (True, None)


def test_excess_key_drops_the_oldest_and_names_it() -> None:
    made = ParameterCache()
    assert {made.put(f"/{number}", number) for number in range(MAX_KEYS)} == {None}
    assert made.put("/0", 3) is None
    assert made.put("/new", 4) == "/1"
    assert len(made.keys) == MAX_KEYS


PATHS = st.lists(st.sampled_from("abc"), min_size=1, max_size=3).map(lambda parts: "/" + "/".join(parts))


@given(st.lists(st.tuples(PATHS, st.integers(1, 9))))
def test_a_subscription_of_all_below_a_key_follows_a_tree_of_parameters(changes: list[tuple[str, int]]) -> None:
    made, tree = ParameterCache(), dict[str, Any]()
    made.put("/root", {})
    for path, value in changes:
        made.update(f"/root{path}/", value)
        branch = tree
        *parents, last = path.strip("/").split("/")
        for part in parents:
            if not isinstance(branch.get(part), dict):
                branch[part] = {}
            branch = branch[part]
        branch[last] = value
    assert made.find("/root") == (True, tree or None)


def _nested(depth: int) -> Any:
    value: Any = 1
    for _ in range(depth):
        value = [value]
    return value


@pytest.mark.parametrize(
    "value",
    ["x" * (MAX_CHARS + 1), list(range(MAX_ITEMS)), _nested(50_000), {"k" * (MAX_CHARS + 1): 1}],
    ids=["long", "many", "deep", "a long key"],
)
def test_value_over_the_bounds_is_not_kept(value: Any) -> None:
    made = cache()
    made.put("/big", value)
    made.update("/rate", value)
    made.update("/node/speed", value)
    assert made.find("/big") == made.find("/rate") == made.find("/node") == (True, None)
    assert made.find("/node/arm/joints") == (False, None)  # it can be subscribed to by itself
    made.update("/node/arm", {"joints": [3]})
    assert made.find("/node/arm/joints") == (False, None)
    made.update("/node", {"arm": {"joints": [3]}})
    assert made.find("/node/arm/joints") == (True, [3])


def test_many_updates_below_one_key_are_bounded() -> None:
    made = cache()
    for number in range(MAX_ITEMS + 1):
        made.update(f"/node/k{number}", number)
    assert made.find("/node/k1") == (False, None)


def test_a_name_of_too_many_parts_is_not_kept() -> None:
    made = cache()
    made.update("/node" + "/a" * MAX_PARTS, 1)
    assert made.find("/node" + "/a" * MAX_PARTS) == (True, 1)
    made.update("/node" + "/a" * 100_000, 1)
    assert made.find("/node/speed") == (False, None)
