"""RobotEvents: events of robots and links for an observing participant, such as a recorder."""

import asyncio

import pytest

from hostlink.core.hub.gates import TICK_S
from hostlink.core.hub.robot_events import MAX_LATER
from hostlink.core.robot.events import EventKind, RobotEvent
from hostlink.core.robot.velocity import PlanarVelocity
from hostlink.errors import BadRequest, CommandRefused
from tests.support.fake_device import robot_topics
from tests.support.participants import ROBOT, Scene, play
from tests.support.scripted_device import ScriptedDevice
from tests.support.virtual_loop import inside


def observed(made: Scene, robot: str = ROBOT) -> list[RobotEvent]:
    """The events of one robot, and of links, from now on."""
    events: list[RobotEvent] = []

    def receive(event: RobotEvent) -> None:
        if event.robot in (robot, ""):
            events.append(event)

    made.hub.join("recorder").observe(receive)
    return events


@inside(play)
async def test_a_command_is_told_with_who_gave_it_and_what_the_limits_made_of_it(made: Scene) -> None:
    events = observed(made)
    made.hub.join("pilot", priority=55).drive(made.hub.robots.find(ROBOT), PlanarVelocity(9.0))
    (event,) = events
    assert (event.kind, event.facts["owner"], event.facts["priority"]) == (EventKind.COMMANDED, "pilot", 55)
    assert (event.facts["velocity"], event.facts["limited"]) == (PlanarVelocity(9.0), PlanarVelocity(1.0))


@inside(play)
async def test_a_refused_command_is_told_with_its_reason(made: Scene) -> None:
    robot = made.hub.robots.find(ROBOT)
    made.hub.join("person", priority=60).drive(robot, PlanarVelocity(0.2))
    events = observed(made)
    with pytest.raises(CommandRefused):
        made.hub.join("program").drive(robot, PlanarVelocity(0.1))
    assert [event.kind for event in events] == [EventKind.REFUSED]
    assert "person" in str(events[0].facts["reason"])


@inside(play)
async def test_each_end_of_a_drive_is_told(made: Scene) -> None:
    robot, pilot = made.hub.robots.find(ROBOT), made.hub.join("pilot")
    events = observed(made)
    pilot.drive(robot, PlanarVelocity(0.2))
    await asyncio.sleep(1.0)
    pilot.drive(robot, PlanarVelocity(0.2))
    pilot.leave()
    ends = [(event.facts["reason"], event.facts["owner"]) for event in events if event.kind is EventKind.STOPPED]
    assert ends == [("no command came", "pilot"), ("the driver left", "pilot")]


@inside(play)
async def test_a_lock_and_its_release_are_told_once(made: Scene) -> None:
    events, robot = observed(made), made.hub.robots.find(ROBOT)
    robot.lock("a hand in the wheel")
    robot.unlock()
    robot.unlock()
    assert [(event.kind, event.facts["reason"]) for event in events] == [
        (EventKind.LOCKED, "a hand in the wheel"),
        (EventKind.UNLOCKED, "a hand in the wheel"),
    ]


@pytest.mark.parametrize("was_moving", [False, True])
@inside(play)
async def test_robot_that_appears_and_leaves_is_reported_with_whether_it_moved(
    made: Scene, *, was_moving: bool
) -> None:
    events = observed(made, "robot_2")
    device = ScriptedDevice(made.hub, robot_topics("robot_2"), address="10.0.0.3")
    await asyncio.sleep(0.5)
    if was_moving:
        made.hub.join("pilot").drive(made.hub.robots.find("robot_2"), PlanarVelocity(0.2))
    await device.aclose()
    await asyncio.sleep(0.1)
    kinds = [event.kind for event in events if event.kind is not EventKind.COMMANDED]
    assert kinds[:2] == [EventKind.LINK_OPENED, EventKind.APPEARED]
    assert set(kinds[2:]) >= {EventKind.GONE, EventKind.LINK_CLOSED}
    (gone,) = (event for event in events if event.kind is EventKind.GONE)
    assert gone.facts == {"link": device.link.number, "was_moving": was_moving}


@inside(play)
async def test_an_observer_that_fails_ends_alone_and_one_that_has_left_observes_nothing(made: Scene) -> None:
    failing, left = made.hub.join("failing"), made.hub.join("left")
    seen: list[RobotEvent] = []

    def fail(event: RobotEvent) -> None:
        raise RuntimeError(event.kind.value)

    failing.observe(fail)
    left.observe(seen.append)
    left.leave()
    assert made.hub.join("pilot").drive(made.hub.robots.find(ROBOT), PlanarVelocity(0.2)) == PlanarVelocity(0.2)
    assert failing.has_left
    assert seen == []
    with pytest.raises(BadRequest, match="has left"):
        left.observe(seen.append)


# -- commands that continue a drive -----------------------------------------------------------------------------------


@inside(play)
async def test_first_command_of_a_drive_is_told_at_once_and_the_next_with_the_tick(made: Scene) -> None:
    robot, pilot, loop = made.hub.robots.find(ROBOT), made.hub.join("pilot"), asyncio.get_running_loop()
    events = observed(made)
    pilot.drive(robot, PlanarVelocity(0.1))
    assert [event.facts["velocity"] for event in events] == [PlanarVelocity(0.1)]
    at_s = [loop.time()]
    for number in range(1, 5):
        await asyncio.sleep(TICK_S / 5)
        pilot.drive(robot, PlanarVelocity(number / 8))
        at_s.append(loop.time())
    assert len(events) == 1
    await asyncio.sleep(TICK_S)
    assert [event.facts["velocity"].x_m_s for event in events] == [0.1, 0.125, 0.25, 0.375, 0.5]
    assert [event.at_s for event in events] == at_s  # each has its own time
    assert {event.facts["owner"] for event in events} == {"pilot"}


@pytest.mark.parametrize("end", ["zero", "stop", "lock", "refused", "leave", "take over", "observer"])
@inside(play)
async def test_commands_are_told_before_what_follows_them(made: Scene, end: str) -> None:
    robot, pilot = made.hub.robots.find(ROBOT), made.hub.join("pilot")
    events = observed(made)
    pilot.drive(robot, PlanarVelocity(0.1))
    pilot.drive(robot, PlanarVelocity(0.2))
    if end == "zero":
        pilot.drive(robot, PlanarVelocity())
    elif end == "stop":
        robot.stop()
    elif end == "lock":
        robot.lock("smoke")
    elif end == "refused":
        with pytest.raises(CommandRefused):
            made.hub.join("other").drive(robot, PlanarVelocity(0.3))
    elif end == "leave":
        pilot.leave()
    elif end == "take over":
        made.hub.join("other").drive(robot, PlanarVelocity(0.3), take_over=True)
    else:
        made.hub.join("late").observe(lambda _: None)
    kinds = [event.kind for event in events]
    assert kinds[:2] == [EventKind.COMMANDED] * 2
    assert [event.facts["velocity"].x_m_s for event in events[:2]] == [0.1, 0.2]
    assert (len(kinds) > 2) is (end != "observer")


@inside(play)
async def test_observer_that_leaves_has_every_command_before_and_a_later_one_has_none(made: Scene) -> None:
    robot, pilot = made.hub.robots.find(ROBOT), made.hub.join("pilot")
    leaving, coming = made.hub.join("leaving"), list[RobotEvent]()
    events: list[RobotEvent] = []
    leaving.observe(events.append)
    for x_m_s in (0.1, 0.2, 0.3):
        pilot.drive(robot, PlanarVelocity(x_m_s))
    made.hub.join("coming").observe(coming.append)
    pilot.drive(robot, PlanarVelocity(0.4))
    leaving.leave()
    assert [event.facts["velocity"].x_m_s for event in events] == [0.1, 0.2, 0.3, 0.4]
    assert [event.facts["velocity"].x_m_s for event in coming] == [0.4]


@inside(play)
async def test_flood_of_commands_keeps_few_of_them_waiting(made: Scene) -> None:
    robot, pilot = made.hub.robots.find(ROBOT), made.hub.join("pilot")
    events = observed(made)
    for _ in range(MAX_LATER + 2):
        pilot.drive(robot, PlanarVelocity(0.1))
    assert len(events) == MAX_LATER + 1


@inside(play)
async def test_event_that_an_observer_causes_follows_the_commands_that_waited(made: Scene) -> None:
    robot, pilot = made.hub.robots.find(ROBOT), made.hub.join("pilot")
    pilot.drive(robot, PlanarVelocity(0.1))
    stopping = made.hub.join("stopping")
    stopping.observe(lambda event: robot.stop() if event.facts.get("velocity") == PlanarVelocity(0.2) else None)
    events = observed(made)
    pilot.drive(robot, PlanarVelocity(0.2))
    pilot.drive(robot, PlanarVelocity(0.3))
    await asyncio.sleep(TICK_S)
    told = [event.facts.get("velocity", event.kind) for event in events]
    assert told == [PlanarVelocity(0.2), PlanarVelocity(0.3), EventKind.STOPPED]
