"""Each rule with evidence that is just sufficient, and with evidence that is just not."""

from dataclasses import replace

import pytest

from hostlink.core.diagnosis.evidence import Complaint, EarlierLink, Evidence, PortSharing
from hostlink.core.diagnosis.finding import Finding, finding, words
from hostlink.core.diagnosis.motion_monitor import MotionEvidence
from hostlink.core.diagnosis.rules import diagnose
from hostlink.core.protocol.link_evidence import Tally
from hostlink.core.protocol.resampling import resample
from hostlink.core.protocol.rosserial.findings import explain
from hostlink.core.protocol.rosserial.frame import Id, encode

GOOD = Tally(bytes_from_device=3000, frames=100)
HEALTHY = Evidence(
    age_s=60.0,
    silent_s=0.1,
    total=GOOD,
    recent=GOOD,
    requests=1,
    negotiated_s=59.0,
    time_requested_s=1.0,
    time_intervals_s=(2.5,) * 8,
    explain=explain,
)
NEW = Evidence(age_s=6.0, silent_s=0.1, requests=3, explain=explain)
SLOW = resample(encode(Id.TIME, bytes(8)) * 60, ratio=2.0)[:512]
BOOT = resample(b"\r\n ets Jan  8 2013,rst cause:2, boot mode:(3,6)\r\n\r\nload 0x4010f000, len 3424\r\n", ratio=1.54)


STALLED = Complaint("left wheel stalled: no edge at PWM 4095", 42.0)


def non_rosserial(sample: bytes, *, frames: int = 0, of: int | None = None) -> Evidence:
    tally = Tally(bytes_from_device=len(sample) if of is None else of, frames=frames, skipped_bytes=len(sample))
    return replace(NEW, total=tally, recent=tally, skipped=sample)


def lives(count: int, *, seconds: float = 3.0, was_negotiated: bool = True) -> tuple[EarlierLink, ...]:
    return (EarlierLink("peer_closed", seconds, was_negotiated),) * count


SKIPPED = Tally(bytes_from_device=3000, frames=60, skipped_bytes=900, bad_checksums=9)
CAT = ("cat (pid 12)",)

CASES = [
    (
        "serial_shared",
        replace(HEALTHY, sharing=PortSharing(CAT, lost_reads=3)),
        "cat (pid 12); 3 reads were lost to it",
    ),
    (
        "serial_shared",
        replace(HEALTHY, sharing=PortSharing(lost_reads=1)),
        "a program that this user cannot see; 1 reads were lost to it",
    ),
    ("serial_shared", replace(HEALTHY, sharing=PortSharing(("agetty (pid 9)",), has_login=True)), "agetty (pid 9)"),
    (
        "serial_shared",
        replace(HEALTHY, sharing=PortSharing(CAT, has_changed_settings=True)),
        "cat (pid 12); it changed the port's settings",
    ),
    # what the other program leaves looks like another baud rate or damage
    ("serial_shared", replace(HEALTHY, recent=SKIPPED, sharing=PortSharing(CAT)), "cat (pid 12)"),
    ("serial_shared", replace(non_rosserial(SLOW), baud=115200, sharing=PortSharing(CAT)), "cat (pid 12)"),
    ("no_bytes", replace(NEW, age_s=5.0), "5 s"),
    ("no_topics", replace(NEW, total=GOOD, recent=GOOD), "3 topic requests, 100 frames"),
    ("protocol_1", replace(non_rosserial(b"\xff\xff" * 40), is_outdated=True), ""),
    ("text_on_line", non_rosserial(b"speed 0.25 m/s\r\n" * 10), '"speed 0.25 m/s"'),
    (
        "text_on_line",
        replace(HEALTHY, recent=GOOD._replace(skipped_bytes=32), skipped=b"x = 1\r\n" * 5),
        '"x = 1"',
    ),
    ("boot_noise", non_rosserial(b"rst:0x1 (POWERON_RESET),boot:0x13 (SPI_FAST)\r\n" * 2), '"rst:0x1 (POWERON_RESET)'),
    ("wrong_baud", replace(non_rosserial(SLOW), baud=115200), "likely sent at 57600; 512 of 512 bytes in no frame"),
    ("no_sync", non_rosserial(bytes(range(128, 256)) * 3), "384 of 384 bytes in no frame"),
    ("wrong_md5", replace(HEALTHY, refused=("/odom: wanted a, got b",)), "/odom: wanted a, got b"),
    ("wrong_size", replace(HEALTHY, recent=GOOD._replace(wrong_sizes=3)), "3 frames"),
    ("buffer_too_small", replace(HEALTHY, too_small=("/cmd: too long",)), "/cmd: too long"),
    ("unknown_ids", replace(HEALTHY, recent=GOOD._replace(unknown_ids=10)), "10 frames"),
    ("reboots", replace(HEALTHY, earlier=lives(3)), "3 links in the last minute; ends: peer_closed"),
    ("reboots", replace(HEALTHY, revivals=3), "3 restarts in the last minute"),
    ("went_silent", replace(HEALTHY, silent_s=6.0), "for 6 s"),
    ("time_stopped", replace(HEALTHY, time_requested_s=8.0), "for 8 s"),
    ("time_stopped", replace(HEALTHY, time_requested_s=None, negotiated_s=9.0), "for 9 s"),
    (
        "wheel_stalled",
        replace(HEALTHY, complaints={"wheel_stalled": STALLED}),
        "left wheel stalled: no edge at PWM 4095",
    ),
    (
        "wheel_runaway",
        replace(HEALTHY, complaints={"wheel_runaway": Complaint("right wheel runs away", 599.0)}),
        "right wheel runs away",
    ),
    (
        "battery_low",
        replace(HEALTHY, complaints={"battery_low": Complaint("battery low: 10.2 V", 599.0)}),
        "battery low: 10.2 V",
    ),
    (
        "watchdog_restart",
        replace(HEALTHY, complaints={"watchdog_restart": Complaint("started by its watchdog", 1.0)}),
        "by its watchdog",
    ),
    ("weak_signal", replace(HEALTHY, signal_dbm=-81), "-81 dBm"),
    ("clock_trouble", replace(HEALTHY, time_intervals_s=(2.2, 2.2, 2.6)), "every 2.20 s instead of 2.5 s"),
    ("clock_trouble", replace(HEALTHY, time_intervals_s=(1.9,) * 4), "every 1.90 s instead of 2.5 s"),
    ("clock_trouble", replace(HEALTHY, time_intervals_s=(1.25,) * 4), "every 1.25 s instead of 2.5 s"),
    ("clock_trouble", replace(HEALTHY, stamps_behind_s=-3600.0), "its stamps are 3600.0 s ahead"),
    ("clock_trouble", replace(HEALTHY, host_clock="its clock is not set"), "this computer: its clock is not set"),
    ("damaged", replace(HEALTHY, recent=GOOD._replace(bad_checksums=3)), "3 bad checksums and 100 good frames"),
    ("too_many_robots", replace(HEALTHY, end="refused"), ""),
    (
        "flashed_alike",
        replace(HEALTHY, noted={"flashed_alike": "robot_0 is another device's name"}),
        "another device's name",
    ),
    ("host_fault", replace(HEALTHY, end="crashed"), ""),
    ("unanswerable", replace(HEALTHY, end="unanswerable"), ""),
]


@pytest.mark.slow
@pytest.mark.parametrize(("code", "evidence", "detail"), CASES)
def test_sufficient_evidence_gives_the_finding(code: str, evidence: Evidence, detail: str) -> None:
    found = diagnose(evidence)
    assert [each.code for each in found] == [code]
    assert detail in found[0].detail


@pytest.mark.parametrize(
    "evidence",
    [
        HEALTHY,
        replace(NEW, age_s=4.9),
        replace(NEW, requests=2, total=GOOD, recent=GOOD),
        non_rosserial(b"x = 1\r\n" * 4),
        replace(non_rosserial(bytes(range(128, 256)) * 3), age_s=2.9),
        replace(non_rosserial(b"\x80\x90" * 40, frames=100, of=3000), negotiated_s=1.0),
        replace(non_rosserial(b"\x80\x90" * 40), age_s=2.9, negotiated_s=1.0),
        replace(HEALTHY, recent=GOOD._replace(wrong_sizes=2, bad_checksums=2, unknown_ids=9)),
        replace(HEALTHY, negotiated_s=4.9, recent=GOOD._replace(unknown_ids=10)),
        replace(HEALTHY, earlier=lives(2)),
        replace(HEALTHY, earlier=lives(3, seconds=31.0)),
        replace(HEALTHY, earlier=lives(9, was_negotiated=False)),
        replace(HEALTHY, revivals=2),
        replace(HEALTHY, complaints={"wheel_stalled": STALLED._replace(ago_s=600.0)}),
        replace(HEALTHY, signal_dbm=-80),
        replace(HEALTHY, complaints={"battery_low": Complaint("battery low: 10.2 V", 600.0)}),
        replace(HEALTHY, silent_s=5.9),
        replace(HEALTHY, time_requested_s=7.9),
        replace(HEALTHY, time_requested_s=None, negotiated_s=7.9),
        replace(HEALTHY, time_requested_s=None, negotiated_s=60.0, never_requests_time=True),
        replace(HEALTHY, time_intervals_s=(2.2, 2.2)),
        *(
            replace(HEALTHY, time_intervals_s=(rhythm_s,) * 8)
            for rhythm_s in (0.1, 0.3, 0.5, 1.0, 1.03, 1.5, 2.0, 2.03)
        ),
        replace(HEALTHY, stamps_behind_s=0.9),
        replace(HEALTHY, time_intervals_s=(2.53, 2.6, 3.5)),
        replace(HEALTHY, end="peer_closed"),
    ],
)
def test_insufficient_evidence_gives_no_finding(evidence: Evidence) -> None:
    assert diagnose(evidence) == []


def test_burst_before_the_topics_is_boot_noise_while_it_is_recent() -> None:
    tally = GOOD._replace(skipped_bytes=len(BOOT))
    evidence = replace(HEALTHY, total=tally, recent=tally, skipped=BOOT, early_noise=BOOT)
    assert [each.code for each in diagnose(evidence)] == ["boot_noise"]
    assert diagnose(replace(evidence, recent=GOOD, skipped=b"")) == []


def test_wheel_that_the_device_names_explains_odometry_that_disagrees() -> None:
    disagrees = replace(HEALTHY, motion=MotionEvidence("odom", 9, disagreement="the odometry does not change"))
    assert [each.code for each in diagnose(disagrees)] == ["odometry_disagrees"]
    for code, text in (("wheel_stalled", STALLED.text), ("wheel_runaway", "right wheel runs away")):
        named = replace(disagrees, complaints={code: Complaint(text, 599.0)})
        assert [each.code for each in diagnose(named)] == [code]
        assert [each.code for each in diagnose(replace(named, complaints={code: Complaint(text, 600.0)}))] == [
            "odometry_disagrees"
        ]


def test_findings_are_in_the_order_of_their_texts() -> None:
    found = diagnose(replace(HEALTHY, refused=("a",), silent_s=7.0, too_small=("b",)))
    assert [each.code for each in found] == ["wrong_md5", "buffer_too_small", "went_silent"]


@pytest.mark.parametrize("code", words())
def test_every_text_of_a_finding_is_one_line(code: str) -> None:
    assert set(words()[code]) == {"symptom", "cause", "next_step"}
    assert all(text and "\n" not in text and "|" not in text for text in words()[code].values())
    assert finding(code, "x") == Finding(code, words()[code]["cause"], words()[code]["next_step"], "x")
