"""LinkMonitor: time request intervals, revivals, recent counts and oversized messages."""

import errno
import math
import random
import struct

import pytest

from hostlink.core.diagnosis.evidence import MIN_WALL_NS, Complaint, HostClock, port_finding
from hostlink.core.diagnosis.link_monitor import LinkMonitor
from hostlink.core.diagnosis.rules import diagnose
from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind
from hostlink.core.protocol.events import DeviceLogged, Event, TimeRequested, TopicsNegotiated, TopicsRequested
from hostlink.core.protocol.rosserial.control import encode_topic_info
from hostlink.core.protocol.rosserial.frame import TOPICS_REQUEST, Id, encode
from hostlink.core.protocol.rosserial.session import Session
from hostlink.errors import FrameTooLarge

TWIST = DeviceEndpoint(
    EndpointKind.SUBSCRIBER, 100, "/cmd_vel", "geometry_msgs/Twist", "9f195f881246fdfa2798d1d3eebca84a", 48
)


def session() -> Session:
    return Session(check=lambda _: 48)


def test_time_intervals_exclude_provoked_requests() -> None:
    monitor = LinkMonitor(session(), now_s=0.0)
    for now_s in (0.1, 2.6, 5.1):
        monitor.observe(TopicsRequested("connected") if now_s == 0.1 else TimeRequested(), now_s)
    monitor.observe(TimeRequested(), 7.6)
    monitor.observe(TopicsRequested("unknown_id"), 8.0)
    monitor.observe(TimeRequested(), 8.1)
    monitor.observe(TimeRequested(), 10.6)
    evidence = monitor.evidence(11.0, silent_s=0.0)
    assert evidence.time_intervals_s == (2.5,)  # the one at 2.6 s answered the topic request, as the one at 8.1 s did
    assert evidence.time_requested_s == pytest.approx(0.4)


def test_board_that_answers_after_silence_has_revived() -> None:
    monitor = LinkMonitor(session(), now_s=0.0)
    monitor.observe(TimeRequested(), 2.5)
    for start_s in (10.0, 20.0):
        monitor.observe(TopicsRequested("no_time_requests"), start_s)
        monitor.observe(TimeRequested(), start_s + 0.1)
        monitor.observe(TimeRequested(), start_s + 2.6)
    assert monitor.evidence(23.0, silent_s=0.0).revivals == 2
    assert monitor.evidence(81.0, silent_s=0.0).revivals == 1


def test_recent_counts_cover_thirty_seconds() -> None:
    negotiated = session()
    monitor = LinkMonitor(negotiated, now_s=0.0)
    negotiated.open(now_s=0.0)
    negotiated.receive(b"noise" * 10, now_s=0.5)
    for now_s in range(1, 41):
        monitor.sample(float(now_s))
        if now_s == 20:
            negotiated.receive(b"more " * 2, now_s=20.5)
    evidence = monitor.evidence(40.0, silent_s=1.0)
    assert (evidence.total.skipped_bytes, evidence.recent.skipped_bytes) == (60, 10)
    assert evidence.skipped == b"more more "


def test_syncs_inside_intact_messages_are_not_damage() -> None:
    """An int16 of -257 is `ff fe`. A message full of them was received intact."""
    negotiated = session()
    monitor = LinkMonitor(negotiated, now_s=0.0)
    negotiated.open(now_s=0.0)
    negotiated.receive(encode(Id.TIME, bytes(8)) + encode(125, struct.pack("<24h", *[-257] * 24)) * 400, now_s=0.5)
    evidence = monitor.evidence(1.0, silent_s=0.5)
    assert (evidence.recent.frames, evidence.recent.bad_checksums) == (401, 0)
    assert "damaged" not in {found.code for found in diagnose(evidence)}


def test_too_small_buffers_are_found_by_announcement_refusal_and_log() -> None:
    negotiated = session()
    monitor = LinkMonitor(negotiated, now_s=0.0)
    negotiated.open(now_s=0.0)
    negotiated.receive(encode(Id.SUBSCRIBER, encode_topic_info(TWIST)), now_s=0.1)
    negotiated.tick(now_s=1.0)
    with pytest.raises(FrameTooLarge):
        negotiated.publish("/cmd_vel", bytes(48))
    monitor.observe(DeviceLogged(3, "Message from device dropped: message larger than buffer."), 1.1)
    assert monitor.evidence(2.0, silent_s=0.0).too_small == (
        "/cmd_vel: a frame of 56 bytes, the device takes 48",
        "/cmd_vel: frame of 56 bytes, the device takes 48",
        "Message from device dropped: message larger than buffer.",
    )


@pytest.mark.parametrize(
    ("least_bytes", "found"),
    [
        (705, ("/odom: a message of at least 705 bytes, the device sends at most 512",)),
        (512, ()),
        (0, ()),
    ],
)
def test_publisher_whose_messages_never_fit_its_buffer_is_found(least_bytes: int, found: tuple[str, ...]) -> None:
    negotiated = Session(check=lambda _: None)
    monitor = LinkMonitor(negotiated, now_s=0.0, least_bytes=lambda _: least_bytes)
    negotiated.open(now_s=0.0)
    odometry = DeviceEndpoint(EndpointKind.PUBLISHER, 125, "/odom", "nav_msgs/Odometry", "0" * 32, 512)
    negotiated.receive(encode(Id.PUBLISHER, encode_topic_info(odometry)), now_s=0.1)
    negotiated.tick(now_s=1.0)
    assert monitor.evidence(2.0, silent_s=0.0).too_small == found


STALLED = "left wheel stalled: no edge at PWM 4095; off until a zero"


@pytest.mark.parametrize(
    ("level", "text", "is_kept"),
    [
        (3, STALLED, True),
        (2, STALLED, False),
        (3, "left wheel stalled", True),
        (3, "the left wheel stalled", False),
        (3, "left wheel stalled\x1b[2J", False),
        (3, "left wheel stalled: " + "x" * 200, False),
    ],
)
def test_error_line_of_a_wheel_is_kept_unchanged(level: int, text: str, is_kept: bool) -> None:
    monitor = LinkMonitor(session(), now_s=0.0)
    monitor.observe(DeviceLogged(level, text), 5.0)
    evidence = monitor.evidence(12.0, silent_s=0.0)
    assert evidence.complaints == ({"wheel_stalled": Complaint(text, 7.0)} if is_kept else {})


def test_last_error_line_of_a_wheel_is_kept() -> None:
    monitor = LinkMonitor(session(), now_s=0.0)
    for at_s, side in ((1.0, "left"), (2.0, "right")):
        monitor.observe(DeviceLogged(3, f"{side} wheel runs away: 250 of 100 ticks/s"), at_s)
    found = monitor.evidence(3.0, silent_s=0.0).complaints
    assert found == {"wheel_runaway": Complaint("right wheel runs away: 250 of 100 ticks/s", 1.0)}


def test_battery_restart_and_signal_are_read_from_the_log() -> None:
    monitor = LinkMonitor(session(), now_s=0.0)
    monitor.observe(DeviceLogged(3, "battery low: 10.2 V, below 10.5 V"), 1.0)
    monitor.observe(DeviceLogged(3, "started by its watchdog: the loop had not turned for 500 ms"), 1.0)
    monitor.observe(DeviceLogged(0, "WiFi signal -67 dBm"), 1.0)
    monitor.observe(DeviceLogged(0, "WiFi signal 67 dBm"), 2.0)
    evidence = monitor.evidence(3.0, silent_s=0.0)
    assert evidence.complaints["battery_low"] == Complaint("battery low: 10.2 V, below 10.5 V", 2.0)
    assert "watchdog_restart" in evidence.complaints
    assert evidence.signal_dbm == -67
    assert monitor.evidence(151.0, silent_s=0.0).signal_dbm is None


@pytest.mark.parametrize(
    ("text", "firmware"),
    [
        ("firmware rover 1.4.2", "rover 1.4.2"),
        ("firmware hostlink-due v2", "hostlink-due v2"),
        ("firmware update failed", None),
        ("firmware rover", None),
        ("firmware rover 1.4 is old", None),
        ("the firmware rover 1.4", None),
        (f"firmware {'r' * 41} 1.4", None),
    ],
)
def test_the_firmware_is_read_from_the_log(text: str, firmware: str | None) -> None:
    monitor = LinkMonitor(session(), now_s=0.0)
    monitor.observe(DeviceLogged(1, text), 1.0)
    assert monitor.firmware == firmware


def test_refused_topics_have_their_reason() -> None:
    def refuse(info: DeviceEndpoint) -> int | None:
        raise FrameTooLarge(info.name, 2, 1)

    negotiated = Session(check=refuse)
    negotiated.open(now_s=0.0)
    negotiated.receive(encode(Id.SUBSCRIBER, encode_topic_info(TWIST)), now_s=0.1)
    assert LinkMonitor(negotiated, now_s=0.0).evidence(1.0, silent_s=0.0).refused == (
        "/cmd_vel: frame of 2 bytes, the device takes 1",
    )


def test_host_clock_reports_unset_and_stepped_clocks() -> None:
    clock = HostClock()
    second_ns = 1_000_000_000
    assert clock.check(0.0, MIN_WALL_NS - 1) == "its clock is not set"
    assert clock.check(1.0, MIN_WALL_NS + 3600 * second_ns) == "its clock was set by +3599.0 s"
    assert clock.check(30.0, MIN_WALL_NS + 3629 * second_ns) == "its clock was set by +3599.0 s"
    assert clock.check(31.1, MIN_WALL_NS + 3630 * second_ns) == ""


@pytest.mark.parametrize(
    ("number", "code"),
    [
        (errno.EACCES, "serial_permission"),
        (errno.ENOENT, "serial_missing"),
        (errno.EBUSY, "serial_busy"),
        (errno.ENOTTY, "serial_unusable"),
    ],
)
def test_port_that_cannot_be_opened_is_a_finding(number: int, code: str) -> None:
    found = port_finding(OSError(number, "/dev/ttyACM0: why"))
    assert (found.code, found.detail) == (code, "/dev/ttyACM0: why")


def test_changed_baud_rate_drops_earlier_counts() -> None:
    negotiated = session()
    negotiated.open(now_s=0.0)
    monitor = LinkMonitor(negotiated, now_s=0.0)
    negotiated.receive(b"noise" * 10, now_s=0.5)
    monitor.set_baud(115200, now_s=1.0)
    negotiated.receive(b"more", now_s=1.5)
    monitor.sample(2.0)
    evidence = monitor.evidence(2.0, silent_s=0.5)
    assert (evidence.baud, evidence.total.skipped_bytes, evidence.recent.skipped_bytes) == (115200, 54, 4)


def test_was_negotiated_after_the_first_negotiation() -> None:
    negotiated = session()
    monitor = LinkMonitor(negotiated, now_s=0.0)
    assert not monitor.was_negotiated
    monitor.observe(TopicsNegotiated((TWIST,), is_changed=True, gap_at=None), 1.0)
    assert monitor.was_negotiated


def requested(monitor: LinkMonitor, *times_s: float, has_waited: bool = False) -> tuple[float, ...]:
    for now_s in times_s:
        monitor.observe(TimeRequested(), now_s, has_waited=has_waited)
    return monitor.evidence(times_s[-1], silent_s=0.0).time_intervals_s


def test_time_requests_that_arrive_together_give_no_interval() -> None:
    """The requests waited in the device's WiFi module, or in the kernel while the host was paused."""
    monitor = LinkMonitor(session(), now_s=0.0)
    monitor.observe(TopicsRequested("connected"), 0.0)
    assert requested(monitor, 0.01, 0.01, 0.02, 0.02, 0.9) == ()
    assert requested(monitor, 2.5) == ()  # the one before had waited too, so its sending time is unknown
    assert requested(monitor, 5.0, 7.5) == (2.5, 2.5)
    assert requested(monitor, 15.1, 15.1, 15.1, 17.0) == pytest.approx((2.5, 2.5, 7.6))
    assert requested(monitor, 19.5) == pytest.approx((2.5, 2.5, 7.6, 2.5))


def test_time_requests_after_a_host_pause_give_no_interval() -> None:
    monitor = LinkMonitor(session(), now_s=0.0)
    assert requested(monitor, 2.5, 5.0) == (2.5,)
    assert requested(monitor, 8.7, has_waited=True) == (2.5,)
    assert requested(monitor, 10.0) == (2.5,)  # 1.3 s after one that was sent at 7.5 s
    assert requested(monitor, 12.5) == (2.5, 2.5)


def test_losses_during_a_host_pause_are_not_damage() -> None:
    negotiated = session()
    negotiated.open(now_s=0.0)
    monitor = LinkMonitor(negotiated, now_s=0.0)
    negotiated.receive(b"noise", now_s=0.5)
    monitor.sample(1.0)
    assert monitor.sampled_at_s == 1.0
    negotiated.receive(b"waited" * 100, now_s=9.0)
    monitor.exclude_waited()
    negotiated.receive(b"later", now_s=11.5)
    monitor.sample(12.0)
    evidence = monitor.evidence(12.0, silent_s=0.5)
    assert evidence.total.skipped_bytes == 10
    assert evidence.recent.skipped_bytes == 10
    assert evidence.total.bytes_from_device == 610


def test_running_device_has_no_boot_message_after_a_host_start() -> None:
    """The first bytes are the end of a long frame, and gaps in the waiting bytes. No board restarted."""
    running = session()
    running.open(now_s=0.0)
    monitor = LinkMonitor(running, now_s=0.0)
    announcement = encode(Id.SUBSCRIBER, encode_topic_info(TWIST._replace(buffer_bytes=512))) + encode(
        Id.TIME, bytes(8)
    )
    half = encode(125, b"x = 1, y = 2 " * 40)[260:]
    for data in (half + encode(125, bytes(24)) + half + encode(125, bytes(24)), announcement):
        for event in running.receive(data, now_s=0.5):
            monitor.observe(event, 0.5)
    for now_s in (1.0, 2.0, 3.0, 4.0):
        monitor.sample(now_s)
        assert diagnose(monitor.evidence(now_s, silent_s=0.5)) == []


def test_stamps_of_messages_that_waited_are_not_a_wrong_clock() -> None:
    negotiated, second_ns = session(), 1_000_000_000
    monitor = LinkMonitor(negotiated, now_s=0.0)
    codes = []
    for tenth in range(300):
        now_s = tenth / 10
        behind_s = 9.0 if now_s < 0.5 else 0.0  # for half a second, bytes are read that waited for 9 s
        stamp_ns, at_ns = round((100 + now_s - behind_s) * second_ns), round((100 + now_s) * second_ns)
        negotiated.device_clock.update(stamp_ns, at_ns=at_ns, now_s=now_s)
        if tenth % 10 == 0:
            monitor.sample(now_s)
            codes += [each.code for each in diagnose(monitor.evidence(now_s, silent_s=0.0))]
    assert "clock_trouble" not in codes


def test_stamps_that_stay_wrong_are_a_wrong_clock() -> None:
    negotiated, second_ns = session(), 1_000_000_000
    monitor = LinkMonitor(negotiated, now_s=0.0)
    for second in range(15):
        negotiated.device_clock.update((91 + second) * second_ns, at_ns=(100 + second) * second_ns, now_s=float(second))
        monitor.sample(float(second))
    (found,) = (each for each in diagnose(monitor.evidence(15.0, silent_s=0.0)) if each.code == "clock_trouble")
    assert found.detail == "its stamps are 9.0 s behind"


def test_device_without_answers_during_a_host_pause_did_not_reboot() -> None:
    monitor = LinkMonitor(session(), now_s=0.0)
    monitor.observe(TimeRequested(), 2.5)
    for start_s in (10.0, 30.0, 50.0):
        monitor.sample(start_s - 1.0)
        monitor.exclude_waited()
        monitor.observe(TopicsRequested("no_time_requests"), start_s)
        monitor.observe(TimeRequested(), start_s + 0.1)
        monitor.observe(TimeRequested(), start_s + 2.6)
    assert monitor.evidence(53.0, silent_s=0.0).revivals == 0


ODOMETRY = DeviceEndpoint(EndpointKind.PUBLISHER, 125, "/odom", "nav_msgs/Odometry", "0" * 32, 512)
TICK_S = 0.05  # odometry of 20 Hz


class RhythmBoard:
    """A rosserial board that publishes without a pause, and requests the time in a rhythm of its own.

    After a restart it is silent until its topics are requested, as ros_lib is.
    """

    def __init__(self, period_s: float, *, asks_with_topics: bool, first_s: float = 0.0) -> None:
        self.session = session()
        self.monitor = LinkMonitor(self.session, now_s=0.0)
        self._period_s, self._asks_with_topics = period_s, asks_with_topics
        self._time_due_s = first_s + period_s
        self._is_configured, self._boots_until_s = False, 0.0
        self._observe(self.session.open(now_s=0.0), 0.0)

    def run(self, seconds: float, restarts_s: tuple[float, ...] = ()) -> list[str]:
        """Return every code that was found at any time."""
        codes: set[str] = set()
        waiting_s = list(restarts_s)
        for number in range(1, round(seconds / TICK_S)):
            now_s = number * TICK_S
            if waiting_s and now_s >= waiting_s[0]:
                self._is_configured, self._boots_until_s = False, waiting_s.pop(0) + 1.5
            self._turn(now_s)
            if number % 20 == 0:
                self.monitor.sample(now_s)
                silent_s = now_s - self.session.negotiation.received_at_s
                codes |= {each.code for each in diagnose(self.monitor.evidence(now_s, silent_s=silent_s))}
        return sorted(codes)

    def _turn(self, now_s: float) -> None:
        data = encode(125, bytes(48)) if self._is_configured else b""
        self._observe(self.session.tick(now_s=now_s), now_s)
        while (outgoing := self.session.pop_frame(now_s=now_s, wall_ns=0)) is not None:
            if outgoing.frame is TOPICS_REQUEST and now_s >= self._boots_until_s:
                self._is_configured = True
                data += encode(Id.PUBLISHER, encode_topic_info(ODOMETRY))
                data += encode(Id.TIME, b"") if self._asks_with_topics else b""
        if self._is_configured and now_s >= self._time_due_s:
            self._time_due_s = now_s + self._period_s
            data += encode(Id.TIME, b"")
        if data:
            self._observe(self.session.receive(data, now_s=now_s), now_s)

    def _observe(self, found: list[Event], now_s: float) -> None:
        for event in found:
            self.monitor.observe(event, now_s)


@pytest.mark.parametrize("number", range(24))
def test_device_that_publishes_all_the_time_did_not_reboot_in_any_rhythm(number: int) -> None:
    """The device requests the time every 0.5 to 30 s, only with its announcement, or never."""
    draw = random.Random(number)
    period_s = math.inf if number % 6 == 0 else draw.uniform(0.5, 30.0) if number % 2 else draw.uniform(4.0, 8.0)
    board = RhythmBoard(period_s, asks_with_topics=draw.random() < 0.5, first_s=draw.uniform(0.0, 3.0))
    assert "reboots" not in board.run(120.0), period_s
    assert board.monitor.evidence(120.0, silent_s=0.0).revivals == 0


@pytest.mark.parametrize("period_s", [1.0, 2.5, 3.5, 4.5, 7.0])
def test_device_that_restarts_again_and_again_is_found_in_any_rhythm(period_s: float) -> None:
    board = RhythmBoard(period_s, asks_with_topics=True)
    found = board.run(90.0, restarts_s=(12.0, 26.0, 39.0, 53.0, 67.0))
    assert "reboots" in found
