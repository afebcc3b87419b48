"""A device that falls silent is asked for its topics: soon, if it has shown that it asks for the time regularly."""

import pytest

from tests.support.session_host import LED, ODOMETRY, TIME, Host, wire


def regular_device() -> Host:
    host = Host(ODOMETRY, LED)
    host.hear(TIME, after_s=2.5)
    assert host.session.is_asking_time
    return host


@pytest.mark.parametrize("period_s", [1.0, 2.5, 3.9])
def test_time_requests_at_their_period_are_regular(period_s: float) -> None:
    host = Host(ODOMETRY)
    assert not host.session.is_asking_time  # two at once are part of a negotiation
    host.hear(TIME, after_s=period_s)
    assert host.session.is_asking_time


@pytest.mark.parametrize("period_s", [0.01, 0.9, 4.1, 60.0])
def test_time_requests_at_any_other_period_are_not(period_s: float) -> None:
    host = Host(ODOMETRY)
    for _ in range(5):
        host.hear(TIME, after_s=period_s)
    assert not host.session.is_asking_time


def test_a_silent_device_that_asked_regularly_is_asked_before_its_link_is_given_up() -> None:
    """It may have restarted behind a radio that keeps the connection: then it waits for exactly this."""
    host = regular_device()
    host.wait(3.4)
    assert host.asks() == []
    host.wait(0.2)
    assert host.asks() == ["no_time_requests"]
    host.hear(TIME + wire(ODOMETRY, LED) + TIME)
    host.wait(3.4)
    assert host.asks() == []


def test_a_device_that_goes_on_talking_has_five_seconds_for_its_next_time_request() -> None:
    host = regular_device()
    for _ in range(49):
        host.wait(0.09)
        host.hear(wire())
        assert host.asks() == []
    host.wait(0.6)
    assert host.asks() == ["no_time_requests"]


def test_a_device_that_never_asks_for_the_time_is_asked_after_five_seconds() -> None:
    host = Host(ODOMETRY)
    host.wait(4.9)
    assert host.asks() == []
    host.wait(0.2)
    assert host.asks() == ["no_time_requests"]
