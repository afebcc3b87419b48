"""What is compiled once for all tests."""

import pytest

from tests.firmware import esp8266


@pytest.fixture(scope="session")
def esp8266_built() -> None:
    """Compiled before the clock of the first test runs."""
    esp8266.build()
