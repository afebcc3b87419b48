"""Fixtures that compile once for all tests, and a time limit that includes compiling."""

import os
from pathlib import Path

import pytest

from tests.firmware import esp8266

TIMEOUT_S = 400  # a worker may wait for another one that compiles


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Give each test here its time limit, unless it has its own."""
    folder = f"{Path(__file__).parent}{os.sep}"  # a comparison of paths for each of all tests would last longer
    for item in items:
        if str(item.path).startswith(folder) and not item.get_closest_marker("timeout"):
            item.add_marker(pytest.mark.timeout(TIMEOUT_S))


@pytest.fixture(scope="session")
def esp8266_built() -> None:
    """Compile before a test starts a daemon."""
    esp8266.build()
