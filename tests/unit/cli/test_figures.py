"""The figures of top: rates from two looks, and the cells that show them."""

from typing import Any

import pytest

from hostlink.cli.figures import (
    LINK_COLUMNS,
    ROBOT_COLUMNS,
    Snapshot,
    advice,
    figures,
    link_rows,
    robot_table,
    speed_text,
)

FINDING = {"code": "damaged", "cause": "why", "next_step": "do", "detail": "3 of 4"}


def link(number: int = 1, **counts: Any) -> dict[str, Any]:
    return {
        "number": number,
        "peer": "10.0.0.2:5000",
        "silent_s": 0.1,
        "seconds": 4.0,
        "topics": [{}, {}],
        "diagnosis": [],
        "frames_from_device": 0,
        "frames_to_device": 0,
        "bytes_from_device": 0,
        "skipped_bytes": 0,
        **counts,
    }


def sample(at_s: float, *links: dict[str, Any], robots: list[dict[str, Any]] | None = None) -> Snapshot:
    return Snapshot(at_s, {"links": list(links), "ended": [], "ports": []}, robots or [])


def robot(**state: Any) -> dict[str, Any]:
    return {"name": "robot_0", "link": 1, "holder": None, "locked": False, "odometry": None, **state}


def test_protocol_of_a_link_is_shown_where_it_is_not_the_usual_one() -> None:
    boards = link(1, protocol="rosserial"), link(2, protocol="micro-ROS"), link(3)
    shown = figures(sample(10.0), sample(12.0, *boards))
    assert [row[1] for row in link_rows(shown)] == ["10.0.0.2:5000", "10.0.0.2:5000 micro-ROS", "10.0.0.2:5000"]
    assert [each["peer"] for each in shown["links"]] == ["10.0.0.2:5000"] * 3


def test_rates_are_of_the_time_between_two_samples() -> None:
    now = link(frames_from_device=60, frames_to_device=20, bytes_from_device=2000, skipped_bytes=100)
    shown = figures(sample(10.0, link(frames_from_device=20)), sample(12.0, now, robots=[robot()]))
    assert link_rows(shown) == [
        ("1", "10.0.0.2:5000", "robot_0", "2", "20.0", "10.0", "1000", "5.0", "0.1", "healthy")
    ]  # fmt: skip
    assert len(LINK_COLUMNS) == len(link_rows(shown)[0])


@pytest.mark.parametrize(("skipped_bytes", "shown_percent"), [(0, "20.0"), (300, "20.0"), (800, "40.0")])
def test_share_of_lost_messages_is_shown_if_it_is_larger_than_that_of_bytes(
    skipped_bytes: int, shown_percent: str
) -> None:
    before = link(frames_from_device=1000, lost_messages=5)
    now = link(frames_from_device=1160, lost_messages=45, bytes_from_device=2000, skipped_bytes=skipped_bytes)
    shown = figures(sample(10.0, before), sample(12.0, now))
    assert shown["links"][0]["lost_messages_percent"] == 20.0
    assert link_rows(shown)[0][LINK_COLUMNS.index("lost %")] == shown_percent


def test_a_link_that_was_not_there_before_counts_from_its_beginning() -> None:
    shown = figures(sample(10.0), sample(12.0, link(frames_from_device=60)))
    assert shown["links"][0]["frames_from_device_s"] == 15.0
    assert shown["links"][0]["skipped_percent"] == 0.0


def test_a_robot_is_shown_with_and_without_odometry() -> None:
    pose = {"x_m": 1.0, "y_m": -0.5, "theta_rad": 3.14159}
    odometry = {"pose": pose, "twist": {"linear_m_s": 0.2, "angular_rad_s": 0.0}, "rate_hz": 10.0, "age_s": 0.05}
    robots = [robot(odometry=odometry, holder="client 1"), robot(link=None, locked=True)]
    columns, rows = robot_table(figures(sample(0.0), sample(1.0, robots=robots)))
    assert rows[0] == ("robot_0", "1", "client 1", "+0.20", "+0.00", "+1.00", "-0.50", "+180", "10.0", "0.1")
    assert rows[1] == ("robot_0", "gone", "locked", *("-",) * 7)
    assert columns == ROBOT_COLUMNS
    assert len(columns) == len(rows[0])


def test_device_columns_are_shown_if_any_robot_has_a_value() -> None:
    told = {"battery_v": 11.42, "battery_percent": 62.4, "device_errors": ["battery_low", "weak_signal"]}
    robots = [robot(), robot(name="robot_1", **told), robot(name="robot_2", firmware="rover 1.4")]
    columns, rows = robot_table({"robots": robots})
    assert columns[len(ROBOT_COLUMNS) :] == ("battery", "errors", "firmware")
    assert [row[len(ROBOT_COLUMNS) :] for row in rows] == [
        ("-", "-", "-"),
        ("11.4 V 62 %", "battery_low, weak_signal", "-"),
        ("-", "-", "rover 1.4"),
    ]


@pytest.mark.parametrize(("left_m_s", "text"), [(0.0, "+0.20"), (-0.004, "+0.20"), (-0.1, "+0.20 y -0.10")])
def test_speed_to_the_left_is_shown_where_it_is_not_zero(left_m_s: float, text: str) -> None:
    assert speed_text({"linear_m_s": 0.2, "linear_y_m_s": left_m_s}) == text


def test_advice_is_about_links_ports_and_those_that_ended() -> None:
    ended = {"number": 3, "peer": "p", "end": "idle", "seconds": 11.2, "ended_ago_s": 4.0, "diagnosis": [FINDING]}
    now = sample(1.0, link(diagnosis=[FINDING]))
    now.links["ports"].append({"name": "/dev/ttyACM0", "diagnosis": [FINDING | {"detail": ""}]})
    now.links["ended"].append(ended)
    assert advice(figures(sample(0.0), now)) == [
        "link 1 damaged: why (3 of 4)",
        "  next: do",
        "/dev/ttyACM0 damaged: why",
        "  next: do",
        "link 3 p ended: idle after 11 s, 4 s ago; damaged",
    ]
    now.links["ended"][0]["protocol"] = "micro-ROS"
    assert advice(figures(sample(0.0), now))[-1] == "link 3 p micro-ROS ended: idle after 11 s, 4 s ago; damaged"
