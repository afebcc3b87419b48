"""IncidentRules: events that are incidents."""

from typing import Any

import pytest

from hostlink.components.recorder.incident import AGAIN_S, MAX_NAMES, IncidentRules
from hostlink.core.robot.events import EventKind, RobotEvent
from hostlink.core.robot.velocity import ZERO, PlanarVelocity

FAST = PlanarVelocity(0.2)


def event(kind: EventKind, at_s: float = 0.0, robot: str = "robot_0", **facts: Any) -> RobotEvent:
    return RobotEvent(kind, robot, at_s, 0, facts)


def commanded(limited: PlanarVelocity) -> RobotEvent:
    return event(EventKind.COMMANDED, owner="pilot", priority=50, velocity=limited, limited=limited)


def stopped(reason: str) -> RobotEvent:
    return event(EventKind.STOPPED, reason=reason, owner="pilot")


def causes(*events: RobotEvent) -> list[str]:
    rules = IncidentRules()
    return [found.cause for found in map(rules.observe, events) if found is not None]


def test_expired_lease_of_a_driven_robot_is_an_incident() -> None:
    assert causes(commanded(FAST), stopped("no command came")) == ["lease"]
    assert causes(commanded(FAST), commanded(ZERO), stopped("no command came")) == []
    assert causes(stopped("no command came")) == []


def test_leaving_driver_is_not_an_incident() -> None:
    assert causes(commanded(FAST), stopped("the driver left"), stopped("no command came")) == []


def test_robot_that_a_silent_program_drove_is_an_incident() -> None:
    rules = IncidentRules()
    rules.observe(commanded(FAST))
    found = rules.observe(stopped("the program made no call for 10.1 s"))
    assert found is not None
    assert (found.cause, found.detail) == ("lease", "pilot stopped it: the program made no call for 10.1 s")


@pytest.mark.parametrize(
    ("happened", "cause"),
    [
        (event(EventKind.LOCKED, reason="a hand"), ["locked"]),
        (event(EventKind.GONE, was_moving=True), ["gone"]),
        (event(EventKind.GONE, was_moving=False), []),
        (event(EventKind.DIAGNOSED, link=1, code="noise", cause="noise.", next_step="", detail=""), ["diagnosed"]),
        (event(EventKind.LOGGED, link=1, level=2, text="no command for 500 ms: stopped"), ["watchdog"]),
        (event(EventKind.LOGGED, link=1, level=3, text="the left motor is stuck"), ["device_error"]),
        (event(EventKind.LOGGED, link=1, level=2, text="warm"), []),
        (event(EventKind.UNLOCKED, reason="a hand"), []),
        (event(EventKind.APPEARED, link=1, peer="here"), []),
    ],
)
def test_event_is_an_incident(happened: RobotEvent, cause: list[str]) -> None:
    assert causes(happened) == cause


def test_event_without_a_robot_is_not_an_incident() -> None:
    assert causes(event(EventKind.DIAGNOSED, robot="", link=1, code="noise", cause="noise.", detail="")) == []


def test_repeated_cause_of_a_robot_is_one_incident() -> None:
    def locked(at_s: float, robot: str = "robot_0") -> RobotEvent:
        return event(EventKind.LOCKED, at_s, robot, reason="a hand")

    assert len(causes(locked(0.0), locked(AGAIN_S - 1), locked(AGAIN_S + 1))) == 2
    assert len(causes(locked(0.0), locked(1.0, "robot_1"))) == 2
    assert len(causes(locked(0.0), event(EventKind.GONE, 1.0, was_moving=True))) == 2


@pytest.mark.parametrize("code", ["went_silent", "time_stopped"])
def test_one_silence_of_a_device_is_one_incident(code: str) -> None:
    silent = event(EventKind.DIAGNOSED, 7.0, link=1, code=code, cause="it is silent", next_step="", detail="")
    gone = event(EventKind.GONE, 11.0, was_moving=True)
    assert causes(silent, gone) == ["diagnosed"]
    assert causes(gone._replace(at_s=5.0), silent) == ["gone"]
    assert causes(gone, silent._replace(at_s=11.0 + AGAIN_S)) == ["gone", "diagnosed"]


def test_pause_of_the_host_is_one_incident_that_names_the_host() -> None:
    rules = IncidentRules()
    rules.observe(commanded(FAST))
    found = rules.observe(stopped("hostlink did not run"))
    assert (found.cause, found.detail) == ("lease", "hostlink did not run while pilot drove")
    assert rules.observe(event(EventKind.LOGGED, 0.1, link=1, level=2, text="no command for 500 ms: stopped")) is None


def test_removed_robot_leaves_no_data() -> None:
    rules = IncidentRules()
    rules.observe(commanded(FAST))
    rules.observe(event(EventKind.LOCKED, reason="a hand"))
    rules.forget("robot_0")
    assert rules.observe(event(EventKind.LOCKED, 1.0, reason="a hand")) is not None


def test_data_of_short_lived_names_is_bounded() -> None:
    rules = IncidentRules()
    for number in range(MAX_NAMES + 10):
        rules.observe(event(EventKind.COMMANDED, robot=f"/topic_{number}", limited=FAST))
        rules.observe(event(EventKind.LOCKED, robot=f"/topic_{number}", reason="a cat"))
    assert len(rules) == MAX_NAMES
