"""Arrivals of the last minute that are not robots, and the findings of the daemon."""

from pathlib import Path

import pytest

from hostlink.core.diagnosis.arrivals import (
    MAX_ARRIVALS,
    RECENT_S,
    REFUSALS,
    Arrival,
    RefusedLately,
    connection_text,
    daemon_findings,
    newest,
)
from hostlink.core.diagnosis.finding import finding

SERVICE = Path(__file__).parents[4] / "docs" / "service.md"
LISTENING = "listening on TCP 127.0.0.1:40001"


def refused(cause: str, count: int = 1) -> Arrival:
    return Arrival("tcp", "10.0.0.5", cause, REFUSALS[cause], 1.0, count)


def test_refusals_are_counted_by_address_and_cause_for_a_minute() -> None:
    lately = RefusedLately()
    for at_s in (0.0, 10.0):
        lately.note("tcp", "10.0.0.5", "not_allowed", at_s)
    lately.note("udp", "10.0.0.6", "too_fast", 15.0)
    lately.note("tcp", "10.0.0.5", "not_allowed", 20.0)
    found = [(each.way, each.peer, each.cause, each.count, each.ago_s) for each in lately.recent(30.0)]
    assert found == [("udp", "10.0.0.6", "too_fast", 1, 15.0), ("tcp", "10.0.0.5", "not_allowed", 3, 10.0)]
    assert lately.recent(20.0 + RECENT_S) == []


def test_refusal_after_a_quiet_minute_is_the_first_again() -> None:
    lately = RefusedLately()
    lately.note("tcp", "10.0.0.5", "not_allowed", 0.0)
    lately.note("tcp", "10.0.0.5", "not_allowed", RECENT_S)
    assert [each.count for each in lately.recent(RECENT_S)] == [1]


def test_refusals_of_many_addresses_are_bounded_and_the_newest_remain() -> None:
    lately = RefusedLately()
    for number in range(10 * MAX_ARRIVALS):
        lately.note("tcp", f"10.0.0.{number}", "not_allowed", float(number) / 100)
    found = lately.recent(2.0)
    assert len(found) == MAX_ARRIVALS
    assert found[-1].peer == f"10.0.0.{10 * MAX_ARRIVALS - 1}"


def test_every_cause_of_the_documents_has_a_text() -> None:
    rows = [line.split("|")[1] for line in SERVICE.read_text(encoding="utf-8").splitlines() if line.startswith("| `")]
    documented = {cause.strip(" `") for row in rows for cause in row.split(",")}
    assert set(REFUSALS) - {"not_rosserial", "not_micro_ros", "other_session"} <= documented
    assert {"not_allowed", "wrong_key", "unverified"} <= documented


@pytest.mark.parametrize(
    ("counts", "end", "text"),
    [
        ((0, 0, 0), None, "connected, sent nothing"),
        ((78, 0, 0), "peer_closed", "sent 78 bytes without a frame; the connection ended: peer closed"),
        ((90, 3, 0), None, "connected, sent 3 frames and announced no topics"),
        ((90, 3, 2), None, "connected, announces 2 topics, but no velocity and no odometry of a robot"),
    ],
)
def test_connection_text_says_what_was_received(counts: tuple[int, int, int], end: str | None, text: str) -> None:
    assert connection_text(*counts, end) == text


def test_connections_of_one_address_with_the_same_end_are_one_arrival() -> None:
    old = Arrival("tcp", "10.0.0.5", "idle", "sent nothing", 30.0)
    young = Arrival("tcp", "10.0.0.5", "idle", "sent 3 bytes", 2.0)
    other = Arrival("tcp", "10.0.0.5", "idle", "sent nothing", 4.0, findings=(finding("no_bytes"),))
    assert newest([old, other, young]) == [
        Arrival("tcp", "10.0.0.5", "idle", "sent 3 bytes", 2.0, count=2),
        other,
    ]
    many = [Arrival("tcp", f"10.0.0.{number}", "idle", "", float(number)) for number in range(50)]
    assert newest(many) == many[:MAX_ARRIVALS]


def test_daemon_without_a_device_reports_where_it_listens() -> None:
    found = daemon_findings([], [refused("not_rosserial")], is_connected=False, listening=LISTENING)
    assert [(each.code, each.detail) for each in found] == [("no_device", LISTENING)]


def test_daemon_that_refuses_devices_reports_the_causes() -> None:
    refusals = [refused("not_allowed", 2), refused("wrong_key"), refused("not_allowed")]
    found = daemon_findings([], refusals, is_connected=False, listening=LISTENING)
    assert [(each.code, each.detail) for each in found] == [("not_let_in", "not_allowed 3, wrong_key 1")]


def test_daemon_with_a_device_or_a_port_that_cannot_be_opened_reports_only_the_ports() -> None:
    missing = finding("serial_missing")
    assert daemon_findings([], [refused("not_allowed")], is_connected=True, listening=LISTENING) == []
    assert daemon_findings([missing], [refused("not_allowed")], is_connected=False, listening=LISTENING) == [missing]


def test_finding_of_the_daemons_own_part_is_reported_with_and_without_a_device() -> None:
    taken = finding("recordings_taken")
    assert daemon_findings([], [], [taken], is_connected=True, listening=LISTENING) == [taken]
    found = daemon_findings([], [], [taken], is_connected=False, listening=LISTENING)
    assert [each.code for each in found] == ["no_device", "recordings_taken"]


def in_other_session(peer: str = "10.0.0.5", count: int = 3, seconds: float = 5.0) -> Arrival:
    return Arrival("udp", peer, "other_session", REFUSALS["other_session"], 1.0, count, seconds=seconds)


@pytest.mark.parametrize("is_connected", [False, True])
def test_board_in_the_session_of_another_host_is_named_by_its_address(is_connected: bool) -> None:
    boards = [in_other_session(f"10.0.0.{number}", 150) for number in range(5)]
    found = daemon_findings([], boards[:1], is_connected=is_connected, listening=LISTENING)
    assert [(each.code, each.detail) for each in found] == [("session_unknown", "10.0.0.0: 150 messages")]
    (found_all,) = daemon_findings([], boards, is_connected=is_connected, listening=LISTENING)
    assert found_all.detail == ("10.0.0.0: 150 messages; 10.0.0.1: 150 messages; 10.0.0.2: 150 messages; and 2 more")


@pytest.mark.parametrize("arrival", [in_other_session(count=2), in_other_session(seconds=4.9)])
def test_late_messages_of_a_board_that_begins_anew_are_not_a_finding(arrival: Arrival) -> None:
    assert daemon_findings([], [arrival], is_connected=True, listening=LISTENING) == []
    (found,) = daemon_findings([], [arrival], is_connected=False, listening=LISTENING)
    assert (found.code, found.detail) == ("no_device", LISTENING)


@pytest.mark.parametrize("is_connected", [False, True])
def test_device_that_gets_less_than_it_needs_is_named_with_the_setting_that_helps(is_connected: bool) -> None:
    arrivals = [refused("unverified", 3)]
    (found,) = daemon_findings([], arrivals, is_connected=is_connected, listening=LISTENING)
    assert (found.code, found.detail) == ("address_unverified", "10.0.0.5: 3 times")
    assert 'trusted = ["192.168.4.0/24"] in [micro_ros.udp]' in found.next_step
    assert daemon_findings([], [refused("unverified", 2)], is_connected=True, listening=LISTENING) == []


def test_board_that_begins_a_session_is_no_longer_in_another() -> None:
    lately = RefusedLately()
    for at_s in (0.0, 3.0, 6.0):
        lately.note_session("udp", "10.0.0.5", at_s)
    lately.note_session("udp", "10.0.0.6", 6.0)
    assert [(each.count, each.seconds) for each in lately.recent(6.0)] == [(3, 6.0), (1, 0.0)]
    lately.forget_session("udp", "10.0.0.5")
    lately.forget_session("udp", "10.0.0.7")
    assert [each.peer for each in lately.recent(6.0)] == ["10.0.0.6"]
