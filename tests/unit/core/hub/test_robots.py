"""RetentionPolicy: who has left, and is forgotten."""

from hostlink.core.hub.robots import MAX_AWAY, RetentionPolicy


def test_disconnected_robot_is_forgotten_after_a_while() -> None:
    away = RetentionPolicy(10.0)
    away.put("a", 0.0)
    away.put("b", 5.0)
    assert away.next_s() == 10.0
    assert away.pop_forgotten(9.9) == []
    assert away.pop_forgotten(10.0) == ["a"]
    assert away.pop_forgotten(100.0) == ["b"]
    assert away.pop_forgotten(100.0) == []


def test_robot_that_left_first_is_forgotten_for_later_ones() -> None:
    away = RetentionPolicy()
    for number in range(MAX_AWAY):
        away.put(f"robot_{number}", 0.0)
    for name in ("robot_0", "new"):
        away.put(name, 0.0)
    assert away.pop_forgotten(0.0) == ["robot_1"]
    assert len(away) == MAX_AWAY
    assert away.pop_first() == "robot_2"


def test_reconnected_robot_is_not_forgotten() -> None:
    away = RetentionPolicy(10.0)
    away.put("a", 0.0)
    away.remove("a")
    away.remove("a")
    assert away.pop_forgotten(100.0) == []
    assert away.pop_first() is None
