"""Stops, locks and unlocks that other daemons have not obeyed yet: which are kept, repeated, moved and forgotten."""

from collections import Counter

import pytest

from hostlink.components.zenoh import fleet_orders
from hostlink.components.zenoh.fleet_messages import FleetAnswer, Lock, RobotMessage, Sender, State, Stop, Unlock
from hostlink.components.zenoh.fleet_orders import ANSWER_TIMEOUT_S, EAGER_S, REPEAT_S, FleetOrders
from hostlink.components.zenoh.roster import FleetRoster

A, B, A_AGAIN = Sender("a", "1"), Sender("b", "2"), Sender("a", "3")
LATER_S = 100.0


def robot(name: str, *, link: int | None = 1) -> RobotMessage:
    return RobotMessage(
        name=name,
        link=link,
        velocity_topic=f"/{name}/cmd_vel",
        odometry_topic=f"/{name}/odometry",
        odometry_type="nav_msgs/Odometry",
    )


class Fleet:
    """Daemon `a` has robot_1, `b` has robot_2; both are heard at 0 s."""

    def __init__(self, *, link: int | None = 1) -> None:
        self.roster = FleetRoster(Counter(), forget_after_s=600.0)
        self.orders = FleetOrders(self.roster)
        for sender, name in ((A, "robot_1"), (B, "robot_2")):
            self.come(sender, name, link=link)

    def come(self, sender: Sender, *names: str, now_s: float = 0.0, link: int | None = 1) -> None:
        self.roster.appear(sender, now_s)
        self.state(sender, *names, now_s=now_s, link=link)

    def state(self, sender: Sender, *names: str, now_s: float, link: int | None = 1, is_last: bool = False) -> None:
        robots = tuple(robot(name, link=link) for name in names)
        self.roster.receive(sender, State(sent_s=0.0, topics=0, robots=robots, is_last=is_last), now_s)

    def give(self, request: Stop | Lock | Unlock, now_s: float = 0.0) -> fleet_orders.Order:
        missing = {"1": "a"} if isinstance(request, Unlock) else self.orders.receivers(request)
        return self.orders.add(request, "order", missing, now_s)

    def repeated_to(self, now_s: float) -> list[str]:
        return [zid for request in self.orders.tick(now_s)[1] for zid in request.to]

    def obey(self, sender: Sender, number: int, *names: str) -> None:
        assert self.orders.receive(sender, FleetAnswer(number=number, robots=tuple(map(robot, names))))


STOP, LOCK = Stop(number=1), Lock(number=1, robot="robot_1", reason="smoke")


@pytest.mark.parametrize("request_", [STOP, LOCK])
@pytest.mark.parametrize("is_silent", [False, True])
def test_order_concerns_a_daemon_that_is_out_of_sight_or_silent(request_: Stop | Lock, *, is_silent: bool) -> None:
    fleet = Fleet()
    if is_silent:
        fleet.roster.watch(LATER_S)
    else:
        fleet.roster.leave("1", 1.0)
    assert fleet.orders.receivers(request_)["1"] == "a"


def test_stop_concerns_only_daemons_where_the_robot_was_last_connected() -> None:
    fleet = Fleet(link=None)
    assert fleet.orders.receivers(Stop(number=1, robot="robot_1")) == {}
    assert fleet.orders.receivers(LOCK) == {"1": "a"}
    assert Fleet().orders.receivers(Stop(number=1, robot="robot_2")) == {"2": "b"}


@pytest.mark.parametrize("request_", [STOP, Lock(number=1, robot=None, reason="smoke")])
def test_stop_or_lock_of_all_concerns_each_daemon_because_it_may_have_boards(request_: Stop | Lock) -> None:
    fleet = Fleet(link=None)
    fleet.state(A, now_s=1.0)  # it has no robot any longer
    assert fleet.orders.receivers(request_) == {"1": "a", "2": "b"}
    fleet.state(A, now_s=2.0, is_last=True)
    fleet.roster.leave("1", 2.0)
    assert fleet.orders.receivers(request_) == {"2": "b"}


def test_lock_of_all_is_obeyed_by_a_daemon_without_robots_and_withdrawn_by_an_unlock() -> None:
    fleet = Fleet()
    order = fleet.give(Lock(number=1, robot=None, reason="smoke"))
    fleet.obey(A, 1)
    assert order.missing == {"2": "b"}
    assert fleet.repeated_to(0.6) == ["2"]
    fleet.orders.withdraw_locks(None)
    assert fleet.repeated_to(2.0) == []


def test_daemon_that_said_that_it_ends_is_not_missed_by_a_stop() -> None:
    fleet = Fleet()
    fleet.state(A, "robot_1", now_s=1.0, link=None, is_last=True)
    fleet.roster.leave("1", 1.0)
    assert fleet.orders.receivers(STOP) == {"2": "b"}
    assert fleet.roster.unheard() == ()


def test_order_is_repeated_only_to_who_is_missing_and_there() -> None:
    fleet = Fleet()
    fleet.give(STOP)
    assert fleet.repeated_to(0.1) == ["1", "2"]
    fleet.obey(B, 1)
    assert fleet.repeated_to(0.2) == ["1"]
    fleet.roster.leave("1", 1.0)
    assert fleet.repeated_to(LATER_S) == []


def test_order_without_an_answer_is_repeated_seldom_and_eagerly_when_a_daemon_appears() -> None:
    fleet = Fleet()
    fleet.give(LOCK)
    times_s = [0.1 * number for number in range(1, 100)]
    sent_s = [now_s for now_s in times_s if fleet.repeated_to(now_s)]
    assert len([now_s for now_s in sent_s if now_s < EAGER_S]) >= 9
    assert 8 <= len([now_s for now_s in sent_s if now_s > EAGER_S]) <= 9 / REPEAT_S
    fleet.orders.greet(LATER_S)
    assert all(fleet.repeated_to(LATER_S + 0.1 * number) for number in range(9))


def test_order_is_overdue_once_and_kept() -> None:
    fleet = Fleet()
    order = fleet.give(LOCK)
    assert fleet.orders.tick(0.1)[0] == []
    assert fleet.orders.tick(3 * ANSWER_TIMEOUT_S)[0] == [order]
    assert fleet.orders.tick(LATER_S)[0] == []
    assert fleet.orders.fresh() == []
    assert fleet.orders.lock_reason("robot_1") == "smoke"
    fleet.obey(A, 1, "robot_1")
    assert order.is_settled.is_set()
    assert fleet.orders.lock_reason("robot_1") is None


@pytest.mark.parametrize("request_", [STOP, LOCK])
def test_order_is_given_to_a_daemon_that_was_restarted(request_: Stop | Lock) -> None:
    fleet = Fleet()
    fleet.give(request_)
    fleet.obey(B, 1, "robot_1")
    fleet.roster.leave("1", 1.0)
    fleet.come(A_AGAIN, now_s=50.0)
    assert fleet.repeated_to(50.0) == ["3"]


def test_restarted_daemon_that_does_not_know_the_robot_yet_has_not_locked_it() -> None:
    fleet = Fleet()
    fleet.roster.leave("1", 1.0)
    fleet.give(LOCK, 2.0)
    fleet.come(A_AGAIN, now_s=50.0)
    assert fleet.repeated_to(50.0) == ["3"]
    fleet.obey(A_AGAIN, 1)
    assert fleet.repeated_to(60.0) == ["3"]
    fleet.obey(A_AGAIN, 1, "robot_1")
    assert fleet.repeated_to(70.0) == []


def test_daemons_of_one_name_at_one_time_do_not_replace_each_other() -> None:
    fleet = Fleet()
    fleet.come(A_AGAIN, "robot_3")
    fleet.roster.leave("1", 1.0)
    assert fleet.orders.receivers(STOP) == {"1": "a", "2": "b", "3": "a"}


def test_lock_follows_a_robot_to_another_daemon() -> None:
    fleet = Fleet()
    fleet.roster.leave("1", 1.0)
    fleet.give(LOCK, 2.0)
    fleet.orders.tick(4.0)
    fleet.state(B, "robot_1", "robot_2", now_s=5.0)
    assert fleet.repeated_to(6.0) == ["2"]


def test_order_is_forgotten_with_the_daemon() -> None:
    fleet = Fleet()
    fleet.give(LOCK)
    fleet.roster.leave("1", 1.0)
    fleet.roster.forget(1000.0)
    assert fleet.repeated_to(1000.0) == []
    assert fleet.orders.lock_reason("robot_1") is None


def test_unlock_withdraws_the_lock_and_is_not_repeated() -> None:
    fleet = Fleet()
    fleet.give(LOCK)
    fleet.orders.withdraw_locks("robot_1")
    fleet.give(Unlock(number=2, robot="robot_1"))
    assert fleet.repeated_to(0.1) == []
    assert fleet.orders.lock_reason("robot_1") is None
    assert [order.what for order in fleet.orders.tick(2.0)[0]] == ["order"]
    assert fleet.orders.tick(3.0) == ([], [])


def test_newer_order_of_a_kind_replaces_one_whose_caller_was_told() -> None:
    fleet = Fleet()
    fleet.give(LOCK)
    fleet.orders.tick(2.0)
    fleet.give(Lock(number=2, robot="robot_1", reason="fire"), 3.0)
    assert [request.number for request in fleet.orders.tick(3.1)[1]] == [2]
    assert fleet.orders.lock_reason("robot_1") == "fire"


def test_of_several_orders_of_a_kind_only_the_newest_is_repeated() -> None:
    fleet = Fleet()
    for number in range(1, 5):
        fleet.give(Stop(number=number))
    assert {request.number for request in fleet.orders.tick(0.1)[1]} == {4}


def test_orders_are_bounded_and_a_lock_stays_longest(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fleet_orders, "MAX_ORDERS", 3)
    fleet = Fleet()
    fleet.give(LOCK)
    for number in range(2, 9):
        fleet.give(Stop(number=number))
    assert [each.request.number for each in fleet.orders.fresh()] == [1, 7, 8]


def test_many_receivers_are_split_into_several_messages(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fleet_orders, "MAX_RECEIVERS", 1)
    fleet = Fleet()
    fleet.give(STOP)
    assert [request.to for request in fleet.orders.tick(0.1)[1]] == [("1",), ("2",)]
