"""The blocking client has what the asynchronous one has."""

import inspect

from hostlink.client import BlockingHost, BlockingRobot, Host, Robot
from tools import blocking_client


def public(cls: type) -> dict[str, object]:
    return {name: each for name, each in inspect.getmembers(cls) if not name.startswith("_")}


def test_the_module_is_what_the_two_classes_make_of_it() -> None:
    assert blocking_client.source() == blocking_client.TARGET.read_text()


def test_no_public_method_is_left_out() -> None:
    assert set(public(BlockingHost)) - {"close", "url"} == set(public(Host)) - blocking_client.INTERNAL
    assert set(public(BlockingRobot)) - {"name", "priority"} == set(public(Robot))
    assert not [name for name, each in public(BlockingHost).items() if inspect.iscoroutinefunction(each)]
