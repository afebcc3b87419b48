"""Number of hypothesis examples, order of the tests, tests that cannot run here, and signals of the tests' programs.

A test of tests/property draws 30 examples, any other test 20. HYPOTHESIS_PROFILE=ci draws 100 and 20, the same ones
each time, `same` (of `make test`) 20, the same ones each time, and fuzz 5000 for each test.
"""

import gc
import os
import shutil
import signal
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

from tests.support import requirements

pytest_plugins = ["tests.support.workers"]

_EXAMPLES, _CI_EXAMPLES, _FUZZ_EXAMPLES, _FEWER_EXAMPLES = 30, 100, 5000, 20
_COMMON: dict[str, Any] = {"deadline": None, "suppress_health_check": [HealthCheck.too_slow]}
_FUZZ = settings(max_examples=_FUZZ_EXAMPLES, **_COMMON)
_PROFILE = os.environ.get("HYPOTHESIS_PROFILE", "default")

settings.register_profile("default", max_examples=_EXAMPLES, **_COMMON)
settings.register_profile("default_fewer", max_examples=_FEWER_EXAMPLES, **_COMMON)
settings.register_profile("ci", max_examples=_CI_EXAMPLES, derandomize=True, print_blob=True, **_COMMON)
settings.register_profile("ci_fewer", settings.get_profile("ci"), max_examples=_FEWER_EXAMPLES)
settings.register_profile("same", settings.get_profile("ci"), max_examples=_FEWER_EXAMPLES)
settings.register_profile("same_fewer", settings.get_profile("same"))
settings.register_profile("fuzz", _FUZZ)
settings.register_profile("fuzz_fewer", _FUZZ)
settings.load_profile(_PROFILE)


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the choice of `make test`: tests that need Python and the extra `test` only."""
    parser.addoption("--python-only", action="store_true", help="only tests without requirements")


class _NotCollected(pytest.File):
    """File of tests that cannot be imported here: one test that is skipped, so that a report names it."""

    reason = ""

    def collect(self) -> Iterator[pytest.Item]:
        """Yield the skipped test."""
        item = _NotRun.from_parent(self, name="all of its tests")
        item.add_marker(pytest.mark.skip(reason=self.reason))
        yield item


class _NotRun(pytest.Item):
    def runtest(self) -> None:
        """Fail: it is always skipped."""
        raise AssertionError(self.nodeid)


def pytest_pycollect_makemodule(module_path: Path, parent: pytest.Collector) -> pytest.File | None:
    """Replace a file of tests whose Python packages are not installed."""
    name = module_path.relative_to(requirements.ROOT).as_posix()
    absent = [each for each in requirements.missing() if any(need.startswith("import ") for need in each.needs)]
    for reason in requirements.reasons(name, (), absent):
        found: _NotCollected = _NotCollected.from_parent(parent, path=module_path)
        found.reason = reason
        return found
    return None


def pytest_collectstart(collector: pytest.Collector) -> None:
    """Give other tests fewer examples than property tests. `make fuzz` gives all of them the same number."""
    if isinstance(collector, pytest.Module):
        has_fewer = "/tests/property/" not in collector.path.as_posix()
        settings.load_profile(f"{_PROFILE}_fewer" if has_fewer else _PROFILE)


@pytest.fixture(autouse=True, scope="session")
def _state_of_its_own(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Keep the recordings of tests apart from those of the user."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        patch.delenv("STATE_DIRECTORY", raising=False)
        yield


@pytest.fixture(autouse=True)
def _robots_without_names(_state_of_its_own: None) -> None:
    """Forget which device was robot_0 in an earlier test: another one of that name would be robot_0_2."""
    for folder in ("names", "boards"):
        shutil.rmtree(Path(os.environ["XDG_STATE_HOME"], "hostlink", folder), ignore_errors=True)


def pytest_configure() -> None:
    """Replace an inherited SIG_IGN (nohup, a shell's background job), so that programs of tests do not inherit it."""
    for number in (signal.SIGINT, signal.SIGQUIT, signal.SIGHUP, signal.SIGTERM):
        if signal.getsignal(number) is signal.SIG_IGN:
            signal.signal(number, _ignore)


def _ignore(number: int, frame: object) -> None:
    """Do nothing. A program that is started inherits SIG_IGN, but no function."""


def pytest_sessionstart() -> None:
    """Collect no garbage while tests are collected: it takes a fifth of that time and finds nothing."""
    gc.disable()


def pytest_collection_finish() -> None:
    """Exclude what the tests have imported from garbage collections: a full one would last as long as a lease."""
    gc.collect()
    gc.freeze()
    gc.enable()


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Skip what needs something that is missing, or leave it out by --python-only, and mix the order of the files.

    Workers take the files in a mixed order: files that wait run with files that compute, and no core is idle. Files
    that measure times keep their order.
    """
    is_python_only = config.option.python_only
    absent = requirements.REQUIREMENTS if is_python_only else requirements.missing()
    runs: dict[bool, list[pytest.Item]] = {True: [], False: []}
    for item in items:
        reasons = list(requirements.reasons(item.nodeid, getattr(item, "fixturenames", ()), absent))
        runs[not (is_python_only and reasons)].append(item)
        for reason in reasons:
            item.add_marker(pytest.mark.skip(reason=reason))
    items[:] = runs[True]
    if runs[False]:
        config.hook.pytest_deselected(items=runs[False])
    if config.option.workers:
        items.sort(key=_place)


def _file(item: pytest.Item) -> str:
    """Return the path of its file, relative to the repository."""
    return item.nodeid.partition("::")[0]


def _place(item: pytest.Item) -> int:
    """Return a place that is the same in each worker and for all tests of a file; 0 for a test that measures times."""
    return 0 if item.get_closest_marker("quiet") else zlib.crc32(_file(item).encode())
