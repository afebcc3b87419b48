"""Name of the driver in the output."""

import pytest

from hostlink.cli.names import driver, named


@pytest.mark.parametrize(
    ("name", "address", "shown"),
    [
        ("client 3", "10.0.0.5", "client 3 (10.0.0.5)"),
        ("client 3 (phone)", "10.0.0.5", "client 3 (phone, 10.0.0.5)"),
        ("rest 10.0.0.5", "10.0.0.5", "rest 10.0.0.5"),
        ("rest phone", "fe80::1", "rest phone (fe80::1)"),
        ("demo", "", "demo"),
    ],
)
def test_the_address_stands_beside_the_name(name: str, address: str, shown: str) -> None:
    assert named(name, address) == shown
    assert driver({"holder": name, "holder_address": address}) == shown


def test_driver_without_a_holder_or_an_address() -> None:
    assert driver({"holder": None}) is None
    assert driver({"holder": "client 1"}) == "client 1"


def test_a_robot_that_is_played_is_driven_by_a_recording() -> None:
    assert driver({"holder": None, "played": True}) == "a recording"
    assert driver({"holder": None, "played": False}) is None
