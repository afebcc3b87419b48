"""DriveRecord: what the honest program sent and the honest robot heard; says which promises did not hold. Pure.

The honest process writes events as lists: a kind, a monotonic time, and what belongs to it.
"""

import math
from collections import deque
from dataclasses import dataclass
from typing import Any

from tests.support.chaos.limits import Limits
from tests.support.chaos.noise import Noise
from tests.support.chaos.violation import Violation

STEP_M_S = 0.0001  # a command is known by its speed, in steps of 0.1 mm/s
NUMBERS = 9000  # commands that can be told apart
HONEST_RAD_S = 0.125  # how fast every honest command turns: by it alone it differs from everybody else's
LEAST_COMMANDS = 100  # of which a 99th percentile is made
OVERDUE_S = 0.25  # a command that nothing has answered for so long counts as late as it is by now
WAITED_S = 0.2  # a driven robot hears its velocity eight times a second
YOUNG_S = 0.4  # a command that is younger holds the robot: its lease is 0.5 s
SAME_S = 1.0  # velocities of another driver within this time are one violation
RIVAL_REST_S = 1.5  # what another commanded may still move the robot: its lease, and a flood's delay
ON_ITS_WAY_S = 0.25  # a velocity that waited for longer between gate and robot has waited for its lease's end, too
ENDS_AFTER_S = 2.0  # links of a daemon that is gone: its guardian waits half a second for devices that still read


@dataclass
class _End:
    """The honest driver's end; `stood_s` is None while the robot moves by its commands."""

    at_s: float
    how: str
    stood_s: float | None
    is_judged: bool = False


class DriveRecord:
    """Feed it events in the order of time; `check` judges what is complete."""

    def __init__(self, limits: Limits, noise: Noise) -> None:
        self.last_velocity: tuple[float, float] | None = None
        self.velocity_before_close: tuple[float, float] | None = None  # of the connection that closed last
        self.latest_p99_s = 0.0
        self.baseline_s = 0.0  # the 99th percentile without hostile peers: of the machine and the harness
        self.zeros_s: list[float] = []  # of each end, how long the robot moved on
        self.commands = 0
        self.oldest_s = 0.0  # of the velocities that the robot obeyed
        self._limits, self._noise = limits, noise
        self._found: list[Violation] = []
        self._waiting: deque[tuple[int, float]] = deque()
        self._latencies: deque[tuple[float, float]] = deque(maxlen=10 * LEAST_COMMANDS)  # (when sent, how long)
        self._new = 0  # latencies since the last check
        self._is_driving = self._is_served = False
        self._way = ""  # of the present drive, or the last
        self._end: _End | None = None
        self._opened_s: float | None = None  # a connection whose first velocity has not come
        self._honest_s = (-math.inf, -math.inf)  # when an honest velocity came last, and when it was sent
        self._sent_s: dict[int, float] = {}
        self._unowned_s = -math.inf  # when one that was not allowed was found last
        self._requested: dict[str, float] = {}
        self._rivals: dict[object, tuple[float, float]] = {}
        self._paused_s: float | None = None  # since when the daemon is stopped by a signal
        self._absent_s = (math.inf, math.inf)  # from when to when the daemon was away last
        self._old_s = -math.inf  # when a velocity that was too old was found last

    def daemon_paused(self, at_s: float) -> None:
        """A signal stops the daemon from now on."""
        self._paused_s = at_s

    def daemon_resumed(self, at_s: float) -> None:
        """Note that the daemon continues: by now its guardian has stopped a moving robot, if there was time."""
        began_s, self._paused_s = self._paused_s, None
        if began_s is None or self.last_velocity in (None, (0.0, 0.0)):
            return
        limit_s = self._limits.hang_s + self._lag(began_s)
        if at_s - max(began_s, self._honest_s[0]) > limit_s:
            self._fail("a daemon that hangs leaves no robot moving", began_s, at_s, limit_s)

    def daemon_left(self, at_s: float, how: str) -> None:
        """Note that the daemon ends and restarts."""
        self._absent_s = (at_s, math.inf)
        self._waiting.clear()
        self._requested.clear()
        if self._is_driving and self._end is None:
            stands = self.last_velocity is None or not _is_honest(*self.last_velocity)
            self._end = _End(at_s, f"{how} of the daemon", at_s if stands else None)

    def daemon_came(self, at_s: float) -> None:
        """Note that the daemon listens again."""
        self._absent_s = (self._absent_s[0], at_s)
        self._requested.clear()
        if self._opened_s is not None:  # by datagrams, without a receiver
            self._opened_s = at_s

    def _is_without_daemon(self, at_s: float) -> bool:
        """Whether links and requests end then because of a restart."""
        return self._absent_s[0] <= at_s <= self._absent_s[1] + ENDS_AFTER_S

    def rival_began(self, key: object, at_s: float) -> None:
        """Note that a rival may drive the robot from now on, while the honest program does not."""
        self._rivals[key] = (at_s, math.inf)

    def rival_ended(self, key: object, at_s: float) -> None:
        """No more, once what it sent has passed."""
        if key in self._rivals:
            self._rivals[key] = (self._rivals[key][0], at_s + RIVAL_REST_S)

    def add(self, event: list[Any]) -> None:
        """Take one event."""
        kind, at_s, *rest = event
        getattr(self, f"_on_{kind}")(at_s, *rest)

    def check(self, now_s: float) -> list[Violation]:
        """Return the violations that are certain by now."""
        self._judge_end(now_s, is_over=False)
        self._judge_latency(now_s)
        for what, at_s in list(self._requested.items()):
            self._judge_answer(what, at_s, now_s)
        if self._opened_s is not None:
            limit_s = self._limits.reconnect_s * self._noise.stretch(self._opened_s, now_s) + self._lag(self._opened_s)
            limit_s += self._away_s(self._opened_s, now_s)
            if now_s - self._opened_s > limit_s:
                self._fail("the honest robot is served again", self._opened_s, now_s, limit_s)
                self._opened_s = None
        found, self._found = self._found, []
        return found

    # -- events -------------------------------------------------------------------------------------------------------

    def _on_lag(self, at_s: float, lag_s: float) -> None:
        self._noise.add_lag(at_s, lag_s)

    def _on_began(self, at_s: float, way: str) -> None:
        self._judge_end(at_s, is_over=True)
        self._is_driving, self._end, self._way = True, None, way

    def _on_sent(self, at_s: float, number: int) -> None:
        self.commands += 1
        self._sent_s[number] = at_s
        if self._is_served:
            self._waiting.append((number, at_s))

    def _on_released(self, _: float) -> None:
        """Take the driver's zero, after which anybody may drive until its next command."""
        self._honest_s = (-math.inf, -math.inf)

    def _on_ended(self, at_s: float, how: str) -> None:
        self._count_overdue(at_s)
        self._waiting.clear()
        stands = self.last_velocity is None or not _is_honest(*self.last_velocity)
        self._is_driving, self._end = False, _End(at_s, how, at_s if stands else None)

    def _on_velocity(self, at_s: float, linear: float, angular: float) -> None:
        self.last_velocity = (linear, angular)
        self._is_served = True
        is_zero = linear == angular == 0.0
        if self._opened_s is not None:
            if not is_zero:
                self._found.append(Violation("the first velocity of a connection is zero", linear, 0.0, at_s=at_s))
            self._opened_s = None
        if is_zero:
            self._stand(at_s)
        elif _is_honest(linear, angular):
            self._move(at_s, round(linear / STEP_M_S))
        else:
            self._judge_unowned(at_s, linear, angular)

    def _on_opened(self, at_s: float) -> None:
        self._opened_s = at_s

    def _on_closed(self, at_s: float, is_ours: bool) -> None:
        is_restart = self._is_without_daemon(at_s)
        if is_restart and not is_ours and self.last_velocity not in (None, (0.0, 0.0)):
            text = f"it was {self.last_velocity}"
            self._found.append(Violation("the last velocity of a daemon is zero", 0.0, 0.0, text, at_s=at_s))
        if not is_ours and not is_restart:
            self._found.append(Violation("the honest robot keeps its link", 0.0, 0.0, at_s=at_s))
        self._end, self._opened_s, self._is_served = None, None, False
        self._waiting.clear()
        self._requested.clear()
        self.velocity_before_close = self.last_velocity or self.velocity_before_close
        self.last_velocity = None

    def _on_requested(self, at_s: float, what: str) -> None:
        self._requested.setdefault(what, at_s)

    def _on_answered(self, at_s: float, what: str) -> None:
        requested_s = self._requested.get(what)
        if requested_s is not None:
            self._judge_answer(what, requested_s, at_s)
            self._requested.pop(what, None)

    def _on_refused(self, at_s: float, why: str) -> None:
        if not self._is_without_daemon(at_s):
            self._found.append(Violation("the honest program is served", 0.0, 0.0, why, at_s=at_s))

    # -- velocities ---------------------------------------------------------------------------------------------------

    def _stand(self, at_s: float) -> None:
        if self._end is not None and self._end.stood_s is None:
            self._end.stood_s = at_s

    def _move(self, at_s: float, number: int) -> None:
        sent_s = self._sent_s.get(number)
        self._honest_s = (at_s, -math.inf if sent_s is None else sent_s)
        if sent_s is not None:
            self._judge_age(at_s, at_s - sent_s)
        if any(number == waiting for waiting, _ in self._waiting):
            while self._waiting:
                waiting, sent_s = self._waiting.popleft()
                self._count(sent_s, at_s - sent_s)
                if waiting == number:
                    break
        end = self._end
        if end is None:
            return
        if end.is_judged:
            self._fail("no velocity after the driver's end", end.at_s, at_s, self._limits.zero_s, detail=end.how)
        end.stood_s = None

    def _judge_age(self, at_s: float, age_s: float) -> None:
        self.oldest_s = max(self.oldest_s, age_s)
        since_s = at_s - ON_ITS_WAY_S
        limit_s = self._limits.age_s + self._lag(at_s - age_s) + self._noise.waited_s(since_s, at_s)
        if age_s > limit_s and at_s > self._old_s + SAME_S:
            self._old_s = at_s
            text = f"by {self._way}"
            self._found.append(Violation("no velocity is obeyed after its lease", age_s, limit_s, text, at_s=at_s))

    def _judge_unowned(self, at_s: float, linear: float, angular: float) -> None:
        value = f"{linear:g} m/s, {angular:g} rad/s"
        came_s, sent_s = self._honest_s
        is_waited = self._is_driving and at_s - came_s < WAITED_S and at_s - sent_s < YOUNG_S
        if not is_waited and self._has_rival(at_s):
            self._stand(at_s)  # by the honest program's commands it moves no more
        elif at_s > self._unowned_s + SAME_S:
            promise = "nobody drives over a higher priority" if is_waited else "only who may drive drives"
            self._found.append(Violation(promise, 0.0, 0.0, value, at_s=at_s))
            self._unowned_s = at_s

    def _has_rival(self, at_s: float) -> bool:
        self._rivals = {key: span for key, span in self._rivals.items() if span[1] >= at_s - RIVAL_REST_S}
        return any(began_s <= at_s <= ended_s for began_s, ended_s in self._rivals.values())

    # -- judgements ---------------------------------------------------------------------------------------------------

    def _judge_end(self, now_s: float, *, is_over: bool) -> None:
        """Once its time is over, or the next drive begins."""
        end = self._end
        if end is None or end.is_judged:
            return
        limit_s = self._limits.zero_s + self._lag(end.at_s) + self._hindered_s(end.at_s, now_s)
        if not is_over and now_s < end.at_s + limit_s:
            return
        end.is_judged = True
        moved_s = (now_s if end.stood_s is None else end.stood_s) - end.at_s
        self.zeros_s.append(moved_s)
        if moved_s > limit_s:
            text = f"by {end.how}" + ("; it still moves" if end.stood_s is None else "")
            self._found.append(Violation("zero after the driver's end", moved_s, limit_s, text, at_s=end.at_s))

    def _judge_latency(self, now_s: float) -> None:
        overdue = self._overdue(now_s) if self._is_driving else []
        count = max(self._new + len(overdue), LEAST_COMMANDS)
        samples = [*self._latencies, *overdue][-count:]
        self._new = 0
        if len(samples) < LEAST_COMMANDS // 2:
            return
        began_s = samples[0][0]
        own_s = [self._own_s(sent_s, latency_s) for sent_s, latency_s in samples]
        self.latest_p99_s = percentile(own_s, 0.99)
        limit_s = self._limits.p99_s * self._noise.stretch(began_s, now_s) + self._lag(began_s) + self.baseline_s
        if self.latest_p99_s > limit_s:
            median_s = percentile(own_s, 0.5)
            detail = f"median {median_s:.4f} s of {len(samples)} commands, by {self._way}"
            self._found.append(Violation("command p99", self.latest_p99_s, limit_s, detail, at_s=began_s))
            self._latencies.clear()

    def _judge_answer(self, what: str, requested_s: float, now_s: float) -> None:
        limit_s = self._limits.answer_s * self._noise.stretch(requested_s, now_s) + self._lag(requested_s)
        limit_s += self._away_s(requested_s, now_s)
        if now_s - requested_s > limit_s:
            self._fail(f"the honest robot's {what} is answered", requested_s, now_s, limit_s)
            del self._requested[what]

    def _own_s(self, sent_s: float, latency_s: float) -> float:
        """Return a command's latency without the time in which the daemon could not run, or refuses after a pause."""
        if latency_s <= self._limits.p99_s:
            return latency_s
        until_s = sent_s + latency_s
        away_s = self._noise.refusing_s(sent_s, until_s) + self._noise.absent_s(sent_s, until_s)
        return max(0.0, latency_s - self._noise.waited_s(sent_s, until_s) - away_s)

    def _overdue(self, now_s: float) -> list[tuple[float, float]]:
        return [(sent_s, now_s - sent_s) for _, sent_s in self._waiting if now_s - sent_s > OVERDUE_S]

    def _count_overdue(self, now_s: float) -> None:
        for sent_s, latency_s in self._overdue(now_s):
            self._count(sent_s, latency_s)

    def _count(self, sent_s: float, latency_s: float) -> None:
        self._latencies.append((sent_s, latency_s))
        self._new += 1

    def _away_s(self, began_s: float, now_s: float) -> float:
        """For how long no daemon ran."""
        return self._noise.paused_s(began_s, now_s) + self._noise.absent_s(began_s, now_s)

    def _hindered_s(self, end_s: float, now_s: float) -> float:
        """Additional time for a zero: the time that the daemon waited, or hung until its guardian acted.

        In twice the time that a zero may take: without a bound a daemon that always waits would have for ever.
        """
        until_s = min(now_s, end_s + 2 * self._limits.zero_s)
        paused_s = self._noise.paused_s(end_s, end_s + 2 * self._limits.zero_s)
        return self._noise.waited_s(end_s, until_s) + min(paused_s, self._limits.hang_s)

    def _lag(self, since_s: float) -> float:
        return self._noise.lag_s(since_s, math.inf)

    def _fail(self, promise: str, began_s: float, now_s: float, limit: float, *, detail: str = "") -> None:
        self._found.append(Violation(promise, now_s - began_s, limit, detail, at_s=began_s))


def _is_honest(linear: float, angular: float) -> bool:
    number = linear / STEP_M_S
    return angular == HONEST_RAD_S and abs(number - round(number)) < 1e-6 and 0 < round(number) <= NUMBERS


def percentile(values: list[float], share: float) -> float:
    """The smallest value that so large a share of all does not exceed."""
    return sorted(values)[max(0, math.ceil(share * len(values)) - 1)]
