"""A connection that is not open yet explains how to open it."""

from contextlib import AbstractContextManager
from typing import Any, cast

import pytest

import hostlink.client
from hostlink.errors import HostlinkError

HOW = "async with hostlink.client.connect"


async def test_await_instead_of_async_with_is_explained() -> None:
    with pytest.raises(HostlinkError, match=HOW):
        await cast(Any, hostlink.client.connect())


def test_with_instead_of_async_with_is_explained() -> None:
    with (
        pytest.raises(HostlinkError, match="connect_blocking"),
        cast(AbstractContextManager[Any], hostlink.client.connect()),
    ):
        pass


def test_a_method_of_what_is_not_open_is_explained() -> None:
    host = cast(Any, hostlink.client.connect("robot.local:9090"))
    with pytest.raises(AttributeError, match=f"'robots': <connect to robot.local:9090> is not open yet.*{HOW}"):
        host.robots()
    assert not hasattr(host, "drive")
