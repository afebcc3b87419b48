"""Diagnosis rules: evidence -> findings (no bytes, reboots, odometry that leaps ...), the likeliest cause first.

These are for every device. What the messages of one protocol show is judged by its own rules (`Evidence.explain`).
Each threshold names its source. Codes and texts are in findings.toml. The numbers of a case are in the finding's
detail.
"""

from collections.abc import Callable

from hostlink.core.diagnosis.evidence import RECENT_S, Evidence
from hostlink.core.diagnosis.finding import Finding, finding, words
from hostlink.core.diagnosis.motion_monitor import NO_POSE
from hostlink.core.protocol.link_evidence import JUDGED_S, UNEXPLAINED_BYTES, WENT_SILENT_S, excerpt

NO_BYTES_S = 5.0  # topics are requested at 0, 2 and 4 s; an answer arrives within 2 s
REBOOTS = 3  # in a minute
SHORT_LIFE_S = 30.0  # a link that lasted longer did not end in a boot loop
STAMPS_BEHIND_S = 1.0  # a device adds one round trip to the time that it receives, some tens of milliseconds
WHEEL_CODES = ("wheel_stalled", "wheel_runaway")
WHEEL_S = 600.0  # a wheel shows its fault only while it is driven, and a person may be repairing it
WEAK_DBM = -80  # same limit as firmware/esp8266: below it packets are lost and sent again
FLAWED = 3  # messages: one may be damage that the checksum let pass
MOST = 0.5  # of the messages: before the first time answer a device has no time
JUMPS = 2  # in RECENT_S; one is a reset by the device itself
UNSENT_S = 15.0  # the slowest odometry is sent every second, and the first after some time answers
FULL = 0.95  # of the line's bytes: messages then wait in the device, or are left out
BITS_A_BYTE = 10  # with start and stop bit
ANOTHER_CLOCK_S = 1e6  # 12 days: no clock of a device is so wrong, but a count of seconds since its start
SECONDS_A_DAY = 86_400

Rule = Callable[[Evidence], str | None]  # returns the detail; None if the rule does not apply


def diagnose(evidence: Evidence) -> list[Finding]:
    """Return the faults of a link, the likeliest cause first; empty if there are none."""
    found = {code: each.text for code, each in evidence.complaints.items() if each.ago_s < WHEEL_S}
    found |= {code: detail for code, detail in evidence.noted.items() if detail}
    if evidence.end in _ENDS:
        found[_ENDS[evidence.end]] = ""
    for code, rule in _RULES.items():
        detail = rule(evidence)
        if detail is not None:
            found[code] = detail
    found = {**evidence.explain(evidence.of_link(is_shared="serial_shared" in found)), **found}
    return [finding(code, found[code]) for code in words() if code in found]


# -- serial ports -----------------------------------------------------------------------------------------------------


def _serial_shared(evidence: Evidence) -> str | None:
    """Detect another program at the port by what it took, by what it may have damaged, or because it is a login."""
    sharing, recent = evidence.sharing, evidence.recent
    has_taken = sharing.lost_reads > 0 or sharing.has_changed_settings
    is_damaged = recent.skipped_bytes >= UNEXPLAINED_BYTES or recent.bad_checksums > 0 or _no_bytes(evidence)
    if not has_taken and not sharing.has_login and not (sharing.names and is_damaged):
        return None
    facts = [", ".join(sharing.names) or "a program that this user cannot see"]
    if sharing.lost_reads:
        facts.append(f"{sharing.lost_reads} reads were lost to it")
    if sharing.has_changed_settings:
        facts.append("it changed the port's settings")
    return "; ".join(facts)


# -- what the session counted -----------------------------------------------------------------------------------------


def _no_bytes(evidence: Evidence) -> str | None:
    is_so = evidence.total.bytes_from_device == 0 and evidence.age_s >= NO_BYTES_S
    return f"{evidence.age_s:.0f} s" if is_so else None


def _went_silent(evidence: Evidence) -> str | None:
    is_silent = evidence.silent_s >= WENT_SILENT_S or evidence.end == "idle"  # the hub may end a link earlier
    return f"for {evidence.silent_s:.0f} s" if evidence.negotiated_s is not None and is_silent else None


def _reboots(evidence: Evidence) -> str | None:
    short = [link for link in evidence.earlier if link.was_negotiated and link.seconds < SHORT_LIFE_S]
    if len(short) >= REBOOTS:
        ends = ", ".join(sorted({link.end for link in short}))
        return f"{len(short)} links in the last minute; ends: {ends}"
    return f"{evidence.revivals} restarts in the last minute" if evidence.revivals >= REBOOTS else None


def _weak_signal(evidence: Evidence) -> str | None:
    dbm = evidence.signal_dbm
    return f"{dbm} dBm" if dbm is not None and dbm < WEAK_DBM else None


def _clock_trouble(evidence: Evidence) -> str | None:
    if evidence.host_clock:
        return f"this computer: {evidence.host_clock}"
    behind_s = evidence.stamps_behind_s
    if behind_s is not None and STAMPS_BEHIND_S <= abs(behind_s) < ANOTHER_CLOCK_S:
        return f"its stamps are {abs(behind_s):.1f} s {'behind' if behind_s > 0 else 'ahead'}"
    return None


# -- what the robot says of its motion --------------------------------------------------------------------------------


def _on(evidence: Evidence, text: str) -> str:
    return f"{text} of {evidence.motion.messages} messages on {evidence.motion.topic}"


def _flawed(evidence: Evidence, flaw: str, text: str) -> str | None:
    """Return the detail of a flaw that most messages have: a single one is damage that the checksum let pass."""
    count = evidence.motion.counts.get(flaw, 0)
    return _on(evidence, f"{count} {text}") if count >= FLAWED and evidence.motion.share(flaw) >= MOST else None


def _bad_pose(evidence: Evidence) -> str | None:
    counts = {flaw: evidence.motion.counts.get(flaw, 0) for flaw in ("not_finite", "too_far")}
    found = ", ".join(f"{count} {NO_POSE[flaw]}" for flaw, count in counts.items() if count)
    return _on(evidence, found) if sum(counts.values()) >= FLAWED else None


def _bad_quaternion(evidence: Evidence) -> str | None:
    if _heading_in_z(evidence) is not None:  # at a heading of 0 all four numbers are zeros
        return None
    for flaw in ("zero_quaternion", "bad_quaternion"):
        if (detail := _flawed(evidence, flaw, NO_POSE[flaw])) is not None:
            return detail
    return None


def _heading_in_z(evidence: Evidence) -> str | None:
    count = evidence.motion.counts.get("heading_in_z", 0)
    return _on(evidence, f"{count} {NO_POSE['heading_in_z']}") if count >= FLAWED else None


def _pose_sent_back(evidence: Evidence) -> str | None:
    count = evidence.motion.counts.get("sent_back", 0)
    return _on(evidence, f"{count} {NO_POSE['sent_back']}") if count >= FLAWED else None


def _slash_frame(evidence: Evidence) -> str | None:
    found = _flawed(evidence, "slash_frame", "frames with a slash")
    return found and f'"{excerpt(evidence.motion.frame_id.encode())}"; {found}'


def _zero_covariance(evidence: Evidence) -> str | None:
    return _flawed(evidence, "zero_covariance", "covariances of zeros")


def _bad_stamp(evidence: Evidence) -> str | None:
    behind_s = evidence.stamps_behind_s
    if behind_s is not None and abs(behind_s) >= ANOTHER_CLOCK_S and not evidence.host_clock:
        return f"its stamps are {abs(behind_s) / SECONDS_A_DAY:.0f} days {'behind' if behind_s > 0 else 'ahead'}"
    return _flawed(evidence, "zero_stamp", "stamps of 0")


def _line_full(evidence: Evidence) -> str | None:
    """Detect a UART that has no time left. A faster one is a USB port, whose baud rate means nothing."""
    if evidence.baud is None or evidence.age_s < RECENT_S + JUDGED_S or evidence.silent_s > 1:
        return None
    bytes_s, most_bytes_s = evidence.recent.bytes_from_device / RECENT_S, evidence.baud / BITS_A_BYTE
    if not FULL <= bytes_s / most_bytes_s <= 1 / FULL:
        return None
    motion = evidence.motion
    rate = f"; {motion.topic} has {motion.messages / RECENT_S:.1f} messages/s" if motion.messages else ""
    return f"{bytes_s:.0f} of {most_bytes_s:.0f} bytes/s at {evidence.baud} baud{rate}"


def _odometry_jumps(evidence: Evidence) -> str | None:
    count = evidence.motion.jumps
    return _on(evidence, f"{count} leaps") if count >= JUMPS else None


def _odometry_disagrees(evidence: Evidence) -> str | None:
    if any(evidence.complaints[code].ago_s < WHEEL_S for code in WHEEL_CODES if code in evidence.complaints):
        return None  # the device has named the wheel, and has switched its motors off
    return evidence.motion.disagreement or None


def _odometry_unsent(evidence: Evidence) -> str | None:
    motion, negotiated_s = evidence.motion, evidence.negotiated_s
    if not motion.topic or motion.total or negotiated_s is None or evidence.silent_s >= WENT_SILENT_S:
        return None
    return f"nothing on {motion.topic} for {negotiated_s:.0f} s" if negotiated_s >= UNSENT_S else None


_ENDS = {"refused": "too_many_robots", "crashed": "host_fault", "unanswerable": "unanswerable"}  # of the link
_RULES: dict[str, Rule] = {
    "serial_shared": _serial_shared,
    "no_bytes": _no_bytes,
    "reboots": _reboots,
    "went_silent": _went_silent,
    "weak_signal": _weak_signal,
    "clock_trouble": _clock_trouble,
    "bad_pose": _bad_pose,
    "heading_in_z": _heading_in_z,
    "bad_quaternion": _bad_quaternion,
    "pose_sent_back": _pose_sent_back,
    "line_full": _line_full,
    "odometry_unsent": _odometry_unsent,
    "odometry_jumps": _odometry_jumps,
    "odometry_disagrees": _odometry_disagrees,
    "bad_stamp": _bad_stamp,
    "slash_frame": _slash_frame,
    "zero_covariance": _zero_covariance,
}
