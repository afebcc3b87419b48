"""Event loop that `hostlink serve --loop` chooses."""

import pytest

from hostlink.cli.serve_command import loop_factory
from hostlink.cli.uvloop_loop import UvLoop
from hostlink.errors import ConfigError


def test_auto_is_uvloop_on_linux_only() -> None:
    assert loop_factory("auto", "linux") is UvLoop
    assert loop_factory("auto", "darwin") is None
    assert loop_factory("auto", "freebsd14") is None


def test_asyncio_is_chosen_everywhere() -> None:
    assert loop_factory("asyncio", "linux") is loop_factory("asyncio", "darwin") is None


def test_uvloop_on_another_system_is_refused_with_the_next_step() -> None:
    assert loop_factory("uvloop", "linux") is UvLoop
    with pytest.raises(ConfigError, match=r"--loop: uvloop is supported on Linux only.*choose asyncio"):
        loop_factory("uvloop", "darwin")
