"""MotionMonitor: what is wrong with the messages that tell how a robot moves. Pure: readings and times are arguments.

The readers name the flaws of each message (`Flaw`); here they are counted over the last RECENT_S.
"""

from collections import Counter, deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

RECENT_S = 30.0
BUCKET_S = 5.0  # a thousand links would notice thirty counters each
_MESSAGES, _JUMPS = "messages", "jumps"  # keys besides the flaws
NO_POSE = {  # flaws that leave no pose, and what they are called
    "not_finite": "poses with NaN or infinity",
    "too_far": "poses farther than 1000 km away",
    "zero_quaternion": "orientations that are four zeros",
    "heading_in_z": "orientations of which only z is set, to a heading",
    "bad_quaternion": "orientations of a length far from 1",
    "sent_back": "poses that it was given",
}

LEAST_M_S, LEAST_RAD_S = 0.1, 0.3  # slower commands do not turn the wheels of every robot
SAME_COMMAND = 0.2  # a command that differs by more than this share is another one
OPPOSITE_SHARE = 0.5  # of the command, in the other direction
TOO_FAST_FACTOR = 2.5  # a float32 in cm/s, ticks/s or degrees is farther off
STILL_SHARE = 0.02  # of the command: the odometry does not change
OPPOSITE_S, STILL_S = 2.0, 5.0  # of one command; a heavy robot has begun to move by then
COMPARE_S = 0.25  # between two comparisons for the same command: the motion of each pose need not be estimated


class Speed(NamedTuple):
    """Velocity of a robot along its path and around its axis."""

    x_m_s: float = 0.0
    yaw_rad_s: float = 0.0


@dataclass(frozen=True, slots=True)
class MotionEvidence:
    """Evidence of the readings of the last RECENT_S; `total` counts them since the link opened."""

    topic: str = ""  # empty: the link has no robot whose motion is known
    total: int = 0
    counts: Mapping[str, int] = field(default_factory=dict)  # by flaw; `messages` and `jumps`
    frame_id: str = ""
    disagreement: str = ""

    @property
    def messages(self) -> int:
        """Number of recent messages."""
        return self.counts.get(_MESSAGES, 0)

    @property
    def jumps(self) -> int:
        """Number of recent poses to where no robot can be by then."""
        return self.counts.get(_JUMPS, 0)

    def share(self, flaw: str) -> float:
        """Share of the recent messages with a flaw."""
        return self.counts.get(flaw, 0) / max(1, self.messages)

    @property
    def without_pose(self) -> str:
        """Reason why the recent messages gave no pose, such as "10 poses with NaN or infinity"; empty if they did."""
        found = [f"{self.counts[flaw]} {text}" for flaw, text in NO_POSE.items() if self.counts.get(flaw)]
        return ", ".join(found)


NO_MOTION = MotionEvidence()


class MotionMonitor:
    """Gatherer of the evidence of one link's odometry."""

    __slots__ = (
        "_at_s", "_command", "_command_at_s", "_compared_s", "_disagreement", "_disagrees_since_s", "_kind", "_now",
        "_past", "_total", "frame_id", "topic",
    )  # fmt: skip

    def __init__(self) -> None:
        self.topic = ""
        self.frame_id = ""
        self._total = 0
        self._now: Counter[str] = Counter()  # since the last bucket
        self._past: deque[tuple[float, Counter[str]]] = deque()
        self._at_s = 0.0
        self._command, self._command_at_s, self._compared_s = Speed(), 0.0, float("-inf")
        self._kind, self._disagrees_since_s = "", 0.0
        self._disagreement = ("", float("-inf"))

    def observe(self, flaws: tuple[str, ...], now_s: float, *, frame_id: str = "", is_jump: bool = False) -> None:
        """Note a message. `is_jump`: its pose is where no robot can be by then."""
        self._total += 1
        self._now[_MESSAGES] += 1
        self._at_s = now_s
        if flaws:
            self._now.update(flaws)
            self.frame_id = frame_id or self.frame_id
        if is_jump:
            self._now[_JUMPS] += 1

    def is_due(self, commanded: Speed, now_s: float) -> bool:
        """Whether the command must be compared: it is another one, or was compared COMPARE_S ago."""
        return now_s >= self._compared_s + COMPARE_S or not _is_same(commanded, self._command)

    def compare(self, commanded: Speed, measured: Speed, now_s: float) -> None:
        """Compare the velocity that the device was sent with the one that it reports.

        Only a command that stays the same for seconds is judged: a robot follows with a delay of its own.
        """
        self._compared_s = now_s
        if not _is_same(commanded, self._command):
            self._command, self._command_at_s, self._kind = commanded, now_s, ""
            return
        kind = _disagreement(commanded, measured)
        if kind != self._kind:
            self._kind, self._disagrees_since_s = kind, now_s
        wait_s = STILL_S if kind == _STILL else OPPOSITE_S
        if kind and now_s - self._disagrees_since_s >= wait_s:
            text = (
                f"{kind}: commanded {commanded.x_m_s:+.2f} m/s {commanded.yaw_rad_s:+.2f} rad/s, "
                f"measured {measured.x_m_s:+.2f} m/s {measured.yaw_rad_s:+.2f} rad/s"
            )
            self._disagreement = text, now_s

    def sample(self, now_s: float) -> None:
        """Keep the counts of the last seconds. Call it once a second."""
        if not self._past or now_s >= self._past[-1][0] + BUCKET_S:
            self._past.append((now_s, self._now))
            self._now = Counter()
        while self._past and self._past[0][0] <= now_s - RECENT_S:
            self._past.popleft()

    def evidence(self, now_s: float) -> MotionEvidence:
        """Return the evidence of the RECENT_S before the last sample, and of what came since."""
        counts = Counter(self._now)
        for _, each in self._past:
            counts.update(each)
        text, at_s = self._disagreement
        disagreement = text if now_s - at_s < RECENT_S else ""
        return MotionEvidence(self.topic, self._total, counts, self.frame_id, disagreement)


_STILL = "the odometry does not change"


def _is_same(one: Speed, other: Speed) -> bool:
    if one == other:
        return True
    return all(abs(a - b) <= SAME_COMMAND * max(abs(a), abs(b)) for a, b in zip(one, other, strict=True))


def _disagreement(commanded: Speed, measured: Speed) -> str:
    """Return how the measured velocity contradicts the commanded one; empty if it does not."""
    judged = [
        (wanted, found, "backwards" if least == LEAST_M_S else "the other way round")
        for wanted, found, least in zip(commanded, measured, (LEAST_M_S, LEAST_RAD_S), strict=True)
        if abs(wanted) >= least
    ]
    for wanted, found, way in judged:
        if wanted * found < 0 and abs(found) >= OPPOSITE_SHARE * abs(wanted):
            return f"the odometry runs {way}"
        if abs(found) > TOO_FAST_FACTOR * abs(wanted):
            return "the odometry is too fast"
    is_still = bool(judged) and all(abs(found) <= STILL_SHARE * abs(wanted) for wanted, found, _ in judged)
    return _STILL if is_still else ""
