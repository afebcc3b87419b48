"""How much the property tests try, how workers share the tests, and which signals the tests' programs get.

HYPOTHESIS_PROFILE=fuzz: fifty times the usual examples; ci: the same examples each time.
"""

import gc
import os
import signal
import zlib
from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

_EXAMPLES, _EXAMPLES_OF_UNIT = 100, 20
_COMMON = {"deadline": None, "suppress_health_check": [HealthCheck.too_slow]}
_FUZZ = settings(max_examples=_EXAMPLES * 50, **_COMMON)
_PROFILE = os.environ.get("HYPOTHESIS_PROFILE", "default")

settings.register_profile("default", max_examples=_EXAMPLES, **_COMMON)
settings.register_profile("default_unit", max_examples=_EXAMPLES_OF_UNIT, **_COMMON)
settings.register_profile("ci", max_examples=_EXAMPLES, derandomize=True, print_blob=True, **_COMMON)
settings.register_profile("ci_unit", settings.get_profile("ci"), max_examples=_EXAMPLES_OF_UNIT)
settings.register_profile("fuzz", _FUZZ)
settings.register_profile("fuzz_unit", _FUZZ)
settings.load_profile(_PROFILE)


def pytest_collectstart(collector: pytest.Collector) -> None:
    """The unit tests are quick: they draw fewer examples, and `make fuzz` as many as of the property tests."""
    if isinstance(collector, pytest.Module):
        settings.load_profile(f"{_PROFILE}_unit" if "/tests/unit/" in collector.path.as_posix() else _PROFILE)


@pytest.fixture(autouse=True, scope="session")
def _state_of_its_own(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Recordings of the tests are not put beside those of whoever runs them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        patch.delenv("STATE_DIRECTORY", raising=False)
        yield


def pytest_configure() -> None:
    """What nohup or a shell's background job ignores is ignored here too, but not by the programs that tests start."""
    for number in (signal.SIGINT, signal.SIGQUIT, signal.SIGHUP, signal.SIGTERM):
        if signal.getsignal(number) is signal.SIG_IGN:
            signal.signal(number, _ignore)


def _ignore(number: int, frame: object) -> None:
    """A program inherits SIG_IGN, but no function."""


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> object:
    """Called by pytest-xdist."""
    from tests.support.sharing import FilesThatShare  # noqa: PLC0415 - without workers pytest-xdist is not needed

    return FilesThatShare(config, log)


def pytest_collection_finish() -> None:
    """A full collection among all that the tests have imported takes as long as a lease: it is left out of them."""
    gc.collect()
    gc.freeze()


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """What takes longest begins first, so that no worker begins it when the others are done.

    Files that wait stand beside files that compute, so that no core is idle; those that measure times do not.
    """
    has_workers = hasattr(config, "workerinput")
    items.sort(key=lambda item: (item.get_closest_marker("long") is None, _place(item, config) if has_workers else 0))


def _place(item: pytest.Item, config: pytest.Config) -> int:
    """Any, that is the same in each worker and for all tests of a file; those that measure times stay as they are."""
    if item.get_closest_marker("quiet"):
        return 0
    return zlib.crc32(item.path.relative_to(config.rootpath).as_posix().encode())
