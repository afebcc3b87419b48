"""Fixtures that compile once for all tests."""

import pytest

from tests.firmware import esp8266


@pytest.fixture(scope="session")
def esp8266_built() -> None:
    """Compiled before the time limit of the first test starts."""
    esp8266.build()
