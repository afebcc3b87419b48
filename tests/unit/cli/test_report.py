"""Report of doctor on a daemon's links: ended links that explain more, and healthy ones."""

from typing import Any

from hostlink.cli.doctor import report_lines, report_of

FOUND = {"code": "text_on_line", "cause": "text", "next_step": "remove it", "detail": ""}


def live(number: int, peer: str, robot: str | None, *, seconds: float = 100.0, **changes: Any) -> dict[str, Any]:
    counts = {"frames_from_device": 3000, "frames_to_device": 1000, "bytes_from_device": 10_000, "skipped_bytes": 0}
    topics = [{"name": f"/{robot}/odometry"}]
    link = {"number": number, "transport": "tcp", "peer": peer, "robot": robot, "diagnosis": []}
    counts |= {"seconds": seconds, "silent_s": 0.05}
    return {**link, **counts, "topics": topics, **changes}


def ended(number: int, peer: str, robot: str | None, *, ago_s: float = 5.0, found: bool = False) -> dict[str, Any]:
    diagnosis = [FOUND] if found else []
    link = {"number": number, "transport": "tcp", "peer": peer, "robot": robot, "diagnosis": diagnosis}
    return {**link, "end": "idle", "seconds": 9.0, "ended_ago_s": ago_s}


def numbers(links: list[dict[str, Any]], gone: list[dict[str, Any]]) -> list[int]:
    report = report_of({"links": links, "ended": gone, "ports": []}, "here")
    return [link["number"] for link in report["links"]]


def test_a_robot_that_is_gone_shows_beside_another_of_its_address() -> None:
    assert numbers([live(2, "10.0.0.2:1", "robot_0")], [ended(1, "10.0.0.2:2", "robot_1")]) == [2, 1]


def test_a_robot_that_is_back_has_no_earlier_link_also_from_another_address() -> None:
    assert numbers([live(2, "10.0.0.3:1", "robot_0")], [ended(1, "10.0.0.2:2", "robot_0")]) == [2]


def test_a_young_link_shows_what_was_wrong_before() -> None:
    young = live(2, "10.0.0.2:1", "robot_0", seconds=3.0)
    assert numbers([young], [ended(1, "10.0.0.2:2", "robot_0", found=True)]) == [2, 1]
    assert numbers([live(2, "10.0.0.2:1", "robot_0")], [ended(1, "10.0.0.2:2", "robot_0", found=True)]) == [2]


def test_a_link_that_ended_before_its_device_was_known_belongs_to_its_address() -> None:
    assert numbers([live(2, "10.0.0.2:1", "robot_0")], [ended(1, "10.0.0.2:2", None)]) == [2]
    assert numbers([live(2, "10.0.0.3:1", "robot_0")], [ended(1, "10.0.0.2:2", None)]) == [2, 1]


def test_only_the_latest_of_a_device_and_what_is_recent() -> None:
    gone = [ended(3, "10.0.0.2:3", "robot_1"), ended(2, "10.0.0.2:2", "robot_1"), ended(1, "x:1", "mule", ago_s=99.0)]
    assert numbers([], gone) == [3]


def test_protocol_is_said_where_it_is_not_the_usual_one() -> None:
    boards = [live(1, "10.0.0.2:1", "a", protocol="rosserial"), live(2, "10.0.0.3:1", "b", protocol="micro-ROS")]
    lines = report_lines(report_of({"links": boards, "ended": [], "ports": []}, "here"))
    assert [line.partition("  (")[0] for line in lines if line.startswith("link")] == [
        "link 1  10.0.0.2:1  a",
        "link 2  10.0.0.3:1 micro-ROS  b",
    ]
    gone = ended(3, "10.0.0.4:1", "c") | {"protocol": "micro-ROS"}
    (line,) = report_lines(report_of({"links": [], "ended": [gone], "ports": []}, "here"))
    assert line == "link 3  10.0.0.4:1 micro-ROS  c  (ended: idle, 0 topics)  nothing was wrong"


def test_healthy_link_is_reported() -> None:
    robots = [{"link": 2, "odometry": {"rate_hz": 30.0, "age_s": 0.02}, "holder": "client 7"}]
    view = {"links": [live(2, "10.0.0.2:1", "robot_0")], "ended": [], "ports": []}
    assert report_lines(report_of(view, "here", robots)) == [
        "link 2  10.0.0.2:1  robot_0  (100 s, 1 topic)  healthy",
        "  30.0 frames/s from it, 10.0 to it, nothing lost, last heard 50.0 ms ago",
        "  odometry 30.0 Hz, 20.0 ms old; driven by client 7",
        "  topics /robot_0/odometry",
    ]


def test_findings_precede_healthy_links() -> None:
    wrong = live(2, "10.0.0.2:1", None, diagnosis=[FOUND], skipped_bytes=500)
    lines = report_lines(report_of({"links": [wrong], "ended": [], "ports": [{"diagnosis": [FOUND]}]}, "here"))
    assert lines[0] == "text_on_line: text"
    assert lines[2:6] == [
        "link 2  10.0.0.2:1  (100 s, 1 topic)",
        "  text_on_line: text",
        "    next: remove it",
        "  30.0 frames/s from it, 10.0 to it, 5.0 % of its bytes lost, last heard 50.0 ms ago",
    ]


def test_lost_messages_are_counted_as_in_the_finding() -> None:
    found = {**FOUND, "code": "best_effort_lost", "detail": "23 of 200 messages (11.5%) in 30 s"}
    board = live(1, "10.0.0.3:1", "b", protocol="micro-ROS", diagnosis=[found], lost_messages=23)
    lines = report_lines(report_of({"links": [board], "ended": [], "ports": []}, "here"))
    assert "  30.0 frames/s from it, 10.0 to it, 23 messages lost, last heard 50.0 ms ago" in lines
    both = live(1, "10.0.0.3:1", "b", protocol="micro-ROS", skipped_bytes=500, lost_messages=1)
    lines = report_lines(report_of({"links": [both], "ended": [], "ports": []}, "here"))
    assert "  30.0 frames/s from it, 10.0 to it, 5.0 % of its bytes and 1 message lost, last heard 50.0 ms ago" in lines
