"""Cost of a faulty link: lost messages, gaps and times to recover, outside the cuts and at them."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

from tests.support.virtual_device import TWIST
from tests.support.virtual_world import LEAST_STEP_M_S, NUMBERS

IN_FLIGHT_S = 0.2  # what was sent so shortly before a cut was on its way


@dataclass(frozen=True)
class Window:
    """A cut, and when odometry came in and a command was obeyed again."""

    cut_at_s: float
    odometry_at_s: float
    command_at_s: float

    @property
    def recovery_s(self) -> float:
        """From the cut until both work."""
        return max(self.odometry_at_s, self.command_at_s) - self.cut_at_s

    def covers(self, at_s: float) -> bool:
        """Whether what was sent then belongs to the cut."""
        return self.cut_at_s - IN_FLIGHT_S <= at_s <= self.cut_at_s + self.recovery_s


@dataclass
class Account:
    """Sent and received messages with times of one clock; commands and poses by their number."""

    poses_sent: list[tuple[float, int]] = field(default_factory=list)
    poses_received: list[tuple[float, int]] = field(default_factory=list)
    commands_sent: list[tuple[float, int]] = field(default_factory=list)
    commands_obeyed: list[tuple[float, int]] = field(default_factory=list)
    faults: list[tuple[float, str]] = field(default_factory=list)

    def obeyed(self, commands: Iterable[tuple[float, bytes]]) -> None:
        """Add the commands of the robot; the zeros of a stop have no number."""
        for at_s, payload in commands:
            number = round(TWIST.unpack(payload)[0] / LEAST_STEP_M_S) - 1
            if number >= 0:
                self.commands_obeyed.append((at_s, number))

    def windows(self) -> list[Window]:
        """The cuts, in order."""
        cuts = [at_s for at_s, kind in self.faults if kind in ("cut", "half-open", "reboot", "close")]
        return [
            Window(
                at_s, _first_after(at_s + IN_FLIGHT_S, self.poses_received), _first_after(at_s, self.commands_obeyed)
            )
            for at_s in cuts
        ]

    def lost(self) -> dict[str, tuple[int, int]]:
        """(outside the cuts, at the cuts), for each direction."""
        windows = self.windows()
        found = {}
        for name, sent, observed in (
            ("odometry", self.poses_sent, self.poses_received),
            ("commands", self.commands_sent, self.commands_obeyed),
        ):
            times = _missing(sent, observed)
            at_cuts = sum(any(window.covers(at_s) for window in windows) for at_s in times)
            found[name] = (len(times) - at_cuts, at_cuts)
        return found

    def largest_gap_s(self, times: Sequence[tuple[float, int]], *, at_cuts: bool) -> float:
        """Between two that followed each other, outside the cuts or over them."""
        windows = self.windows()
        gaps = [
            later - earlier
            for (earlier, _), (later, _) in pairwise(times)
            if at_cuts
            == any(earlier <= window.cut_at_s + IN_FLIGHT_S and later > window.cut_at_s for window in windows)
        ]
        return max(gaps, default=0.0)

    def row(self) -> dict[str, object]:
        """All of it, for a table."""
        lost = self.lost()
        return {
            "messages": len(self.poses_sent) + len(self.commands_sent),
            "lost outside cuts": sum(outside for outside, _ in lost.values()),
            "lost at cuts": sum(inside for _, inside in lost.values()),
            "recovery_s": [round(window.recovery_s, 2) for window in self.windows()],
            "largest gap odometry_s": [
                round(self.largest_gap_s(self.poses_received, at_cuts=at_cuts), 2) for at_cuts in (False, True)
            ],
            "largest gap commands_s": [
                round(self.largest_gap_s(self.commands_obeyed, at_cuts=at_cuts), 2) for at_cuts in (False, True)
            ],
        }


def _first_after(at_s: float, events: Sequence[tuple[float, int]]) -> float:
    return next((time_s for time_s, _ in events if time_s > at_s), float("inf"))


def _missing(sent: Sequence[tuple[float, int]], observed: Sequence[tuple[float, int]]) -> list[float]:
    """Return when each lost message was sent. Numbers repeat after NUMBERS messages, so the search is in order."""
    missing, at = [], 0
    for sent_at_s, number in sent:
        while at < len(observed) and observed[at][1] != number and _is_before(observed[at][1], number):
            at += 1
        if at == len(observed) or observed[at][1] != number:
            missing.append(sent_at_s)
    return missing


def _is_before(one: int, other: int) -> bool:
    return (other - one) % NUMBERS < NUMBERS // 2
