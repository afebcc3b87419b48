"""How much the property tests try. HYPOTHESIS_PROFILE=fuzz: fifty times the usual; ci: the same examples each time."""

import os

import pytest
from hypothesis import HealthCheck, settings

_EXAMPLES = 100
_COMMON = {"deadline": None, "suppress_health_check": [HealthCheck.too_slow]}

settings.register_profile("default", max_examples=_EXAMPLES, **_COMMON)
settings.register_profile("ci", max_examples=_EXAMPLES, derandomize=True, print_blob=True, **_COMMON)
settings.register_profile("fuzz", max_examples=_EXAMPLES * 50, **_COMMON)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "default"))


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """What takes longest begins first, so that no worker begins it when the others are done."""
    items.sort(key=lambda item: item.get_closest_marker("long") is None)
