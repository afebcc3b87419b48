"""The blocking client has what the asynchronous one has."""

import inspect

import pytest

from hostlink.client import BlockingHost, BlockingRobot, Host, Robot

INTERNAL = {"running", "stop_driven", "end_cell"}  # of `connect` and of the thread
PAIRS = ((BlockingHost, Host), (BlockingRobot, Robot))


def public(cls: type) -> dict[str, object]:
    return {name: each for name, each in inspect.getmembers(cls) if not name.startswith("_")}


def test_no_public_method_is_left_out() -> None:
    assert set(public(BlockingHost)) - {"close", "url"} == set(public(Host)) - INTERNAL
    assert set(public(BlockingRobot)) - {"name", "priority"} == set(public(Robot))


@pytest.mark.parametrize(("blocking", "asynchronous"), PAIRS)
def test_methods_have_the_arguments_and_docstrings_of_the_asynchronous_ones(blocking: type, asynchronous: type) -> None:
    others = public(asynchronous)
    for name, method in public(blocking).items():
        assert not inspect.iscoroutinefunction(method)
        assert inspect.getdoc(method), name
        if inspect.isfunction(method) and name in others:
            theirs = others[name]
            assert callable(theirs)
            assert list(inspect.signature(method).parameters) == list(inspect.signature(theirs).parameters), name
