"""Daemons of the fleet, their robots, and the place of a name."""

from collections import Counter

import msgspec

from hostlink.components.zenoh.fleet_messages import Live, PoseState, RobotMessage, RobotMotion, Sender, State
from hostlink.components.zenoh.roster import (
    MAX_DAEMONS,
    MAX_GONE,
    MAX_NAMESAKES,
    MAX_REMOTE_ROBOTS,
    SILENT_S,
    FleetRoster,
)

A, B = Sender("a", "1"), Sender("b", "2")


def state(*names: str, link: int | None = 1) -> State:
    robots = tuple(
        RobotMessage(
            name=name,
            link=link,
            velocity_topic=f"/{name}/cmd_vel",
            odometry_topic=f"/{name}/odometry",
            odometry_type="nav_msgs/Odometry",
        )
        for name in names
    )
    return State(sent_s=0.0, topics=0, robots=robots)


def roster(*senders: Sender, forget_after_s: float = 600.0) -> tuple[FleetRoster, Counter[str]]:
    counts: Counter[str] = Counter()
    known = FleetRoster(counts, forget_after_s=forget_after_s)
    for sender in senders:
        assert known.appear(sender, 0.0)
    return known, counts


def test_a_robot_is_where_it_is_connected() -> None:
    known, _ = roster(A, B)
    known.receive(A, state("r", link=None), 0.0)
    assert known.receive(B, state("r"), 0.0) == {"r"}
    place = known.place("r")
    assert (place.neighbour.sender, place.is_connected, place.also_at) == (B, True, ())


def test_one_name_at_two_daemons_is_noted() -> None:
    known, _ = roster(A, B)
    known.receive(B, state("r"), 0.0)
    known.receive(A, state("r"), 0.0)
    place = known.place("r")
    assert (place.neighbour.sender, place.also_at) == (A, ("b",))
    assert known.connected_at("r") == ("a", "b")


def test_the_daemons_of_one_name_are_bounded_and_one_more_is_known_when_another_is_gone() -> None:
    senders = [Sender(f"host-{number}", str(number)) for number in range(MAX_NAMESAKES + 1)]
    known, counts = roster(*senders)
    for sender in senders:
        known.receive(sender, state("r"), 0.0)
    assert len(known.connected_at("r")) == MAX_NAMESAKES
    assert counts["excess_robots"] == 1
    known.receive(senders[0], state(), 1.0)
    known.receive(senders[-1], state("r"), 1.0)
    assert known.connected_at("r") == tuple(sender.name for sender in senders[1:])


def test_the_robots_of_a_daemon_that_is_gone_are_known_and_not_connected() -> None:
    known, _ = roster(A)
    known.receive(A, state("r"), 0.0)
    assert known.leave("1", 5.0) == {"r"}
    place = known.place("r")
    assert not place.is_connected
    assert known.forget(604.0) == set()
    assert known.forget(605.0) == {"r"}
    assert known.place("r") is None


def test_a_daemon_that_is_reached_again_has_connected_robots_once_it_sends() -> None:
    known, _ = roster(A)
    known.receive(A, state("r", "s"), 0.0)
    known.leave(A.zid, 1.0)
    assert known.appear(A, 2.0)
    assert known.connected_at("r") == ()
    known.receive(A, state("r"), 2.1)
    assert known.connected_at("r") == ("a",)
    assert (known.place("r") is None, known.place("s") is None) == (False, True)
    assert known.forget(1000.0) == set()


def test_a_daemon_that_is_silent_has_no_connected_robots_until_it_sends_again() -> None:
    known, _ = roster(A)
    known.receive(A, state("r"), 0.0)
    assert known.watch(SILENT_S) == set()
    assert known.watch(SILENT_S + 0.1) == {"r"}
    assert known.connected_at("r") == ()
    known.receive(A, state("r"), SILENT_S + 0.2)
    assert known.connected_at("r") == ("a",)


def test_a_state_without_a_token_counts_for_nothing() -> None:
    known, counts = roster(A)
    assert known.receive(B, state("r"), 0.0) == set()
    assert known.receive(Sender("b", A.zid), state("r"), 0.0) == set()
    assert known.receive_motions(B, Live(robots=()), 0.0) == set()
    assert counts["unannounced"] == 3


def test_a_robot_that_is_listed_no_more_is_forgotten() -> None:
    known, _ = roster(A)
    known.receive(A, state("r", "s"), 0.0)
    assert known.receive(A, state("s"), 0.0) == {"r", "s"}
    assert (known.place("r") is None, known.place("s") is None) == (True, False)


def test_a_motion_changes_only_robots_that_are_listed() -> None:
    known, _ = roster(A)
    known.receive(A, state("r"), 0.0)
    pose = PoseState(x_m=1, y_m=2, theta_rad=0, linear_m_s=0, angular_rad_s=0, stamp_ns=0, age_s=0, rate_hz=10, count=7)
    live = Live(robots=(RobotMotion("r", (0.1, 0.0), pose), RobotMotion("s", (0.1, 0.0), None)))
    assert known.receive_motions(A, live, 0.0) == {"r"}
    place = known.place("r")
    assert (place.state.pose, place.state.velocity, place.state.link) == (pose, (0.1, 0.0), 1)
    assert known.place("s") is None


def test_a_robot_with_another_robot_s_topics_is_refused() -> None:
    known, counts = roster(A)
    (robot,) = state("r").robots
    robots = tuple(
        msgspec.structs.replace(robot, **change)
        for change in ({"name": "s"}, {"reset_topic": "/tf"}, {"odometry_topic": "/rx/odom"})
    )
    known.receive(A, State(sent_s=0.0, topics=0, robots=robots), 0.0)
    assert [known.place(name) for name in ("r", "s")] == [None, None]
    assert counts["foreign_topics"] == 3


def test_the_number_of_daemons_is_bounded() -> None:
    known, counts = roster(*(Sender("x", str(number)) for number in range(MAX_DAEMONS)))
    assert not known.appear(A, 0.0) or known.find(A) is not None
    assert not known.appear(Sender("y", "y"), 0.0)
    assert counts["excess_daemons"] >= 1


def test_the_number_of_robots_is_bounded() -> None:
    senders = [Sender("x", str(number)) for number in range(17)]
    known, counts = roster(*senders)
    for number, sender in enumerate(senders):
        known.receive(sender, state(*(f"r_{number}_{robot}" for robot in range(256))), 0.0)
    names = [f"r_{number}_{robot}" for number in range(17) for robot in range(256)]
    assert sum(known.place(name) is not None for name in names) == MAX_REMOTE_ROBOTS
    assert counts["excess_robots"] == 17 * 256 - MAX_REMOTE_ROBOTS


def test_daemons_that_come_and_go_are_forgotten() -> None:
    known, _ = roster()
    for number in range(10 * MAX_GONE):
        sender = Sender("x", str(number))
        known.appear(sender, 0.0)
        known.receive(sender, state(f"r_{number}"), 0.0)
        known.leave(sender.zid, 0.0)
    assert sum(known.place(f"r_{number}") is not None for number in range(10 * MAX_GONE)) == MAX_GONE
    assert known.leave("none", 0.0) == set()
