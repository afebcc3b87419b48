"""How much the property tests try, and how workers share the tests.

HYPOTHESIS_PROFILE=fuzz: fifty times the usual examples; ci: the same examples each time.
"""

import os

import pytest
from hypothesis import HealthCheck, settings
from xdist.scheduler import LoadScopeScheduling

_EXAMPLES = 100
_COMMON = {"deadline": None, "suppress_health_check": [HealthCheck.too_slow]}

settings.register_profile("default", max_examples=_EXAMPLES, **_COMMON)
settings.register_profile("ci", max_examples=_EXAMPLES, derandomize=True, print_blob=True, **_COMMON)
settings.register_profile("fuzz", max_examples=_EXAMPLES * 50, **_COMMON)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "default"))

SHARING = ("test_diagnoses.py", "test_page.py", "test_page_states.py")  # their tests share a daemon or a browser


class FilesThatShare(LoadScopeScheduling):
    """Each test goes to the next worker that is free, but the tests of a file that share a fixture stay together."""

    def _split_scope(self, nodeid: str) -> str:
        path = nodeid.partition("::")[0]
        return path if path.endswith(SHARING) else nodeid


def pytest_xdist_make_scheduler(config: pytest.Config, log: object) -> FilesThatShare:
    """Asked by pytest-xdist; its own `loadgroup` does nothing beside pytest 9.2."""
    return FilesThatShare(config, log)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """What takes longest begins first, so that no worker begins it when the others are done."""
    items.sort(key=lambda item: item.get_closest_marker("long") is None)
