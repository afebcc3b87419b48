"""A run of chaos: starts daemon, honest robot and generator, plays step after step, and judges after each."""

import asyncio
import contextlib
import dataclasses
import json
import shutil
import signal
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tests.support.chaos.children import Daemon, Talker, daemon, talker
from tests.support.chaos.daemon_record import MIB, DaemonRecord
from tests.support.chaos.drive_record import DriveRecord, percentile
from tests.support.chaos.keeper import DaemonKeeper
from tests.support.chaos.limits import Limits
from tests.support.chaos.noise import Noise
from tests.support.chaos.plan import PHASE_STEPS
from tests.support.chaos.violation import Violation
from tests.support.chaos.watch import REQUEST_TIMEOUT_S, Watch
from tests.support.core_part import part_of_a_core

BASELINE_COMMANDS = 80  # without other peers: what the harness itself measures
STEP_MARGIN_S = 30.0  # after which the generator itself hangs
# Zenoh keeps a stranger for 10 s that does not finish its handshake, and accepts ten a second while handshakes fail
# (eclipse-zenoh/zenoh#2685), also those that have left.
SETTLE_S = 60.0
DEATH_S = 2.0
POLL_S = 0.1
JUDGE_S = 1.0
LAST_WORD_S = 0.4  # in which a zero reaches the robot after the daemon has died
DRIVE_BEFORE_END_S = 0.7
SERVED_S = 20.0
HANDSHAKE_S = 5.0
TAIL_BYTES = 4000
CALL_IS_ANSWERED = "a device that calls is answered"


@dataclass(frozen=True, kw_only=True)
class Wanted:
    """Parameters of a run."""

    seed: int
    seconds: float
    limits: Limits = field(default_factory=Limits)
    kinds: tuple[str, ...] = ()  # none named: all
    steps: int | None = None
    first_step: int = 0
    keeps_going: bool = False
    has_udp: bool = True
    quota: float | None = None  # of a core, for the daemon and its guardian
    log: Path | None = None  # where the daemon's log is kept

    @property
    def patience(self) -> float:
        """Factor for all time limits."""
        return 1.0 if self.quota is None else max(1.0, 1 / self.quota)

    def command(self) -> str:
        """Return the command that repeats the run."""
        words = ["python tools/chaos_daemon.py", f"--seed {self.seed}", f"--seconds {self.seconds:g}"]
        words += [f"--kind {kind}" for kind in self.kinds]
        words += [f"--first-step {self.first_step}"] if self.first_step else []
        words += [f"--steps {self.steps}"] if self.steps is not None else []
        words += ["--keep-going"] if self.keeps_going else []
        words += [] if self.quota is None else [f"--quota {self.quota:g}"]
        words += [] if self.has_udp else ["--no-udp"]
        for each in dataclasses.fields(Limits):
            if (value := getattr(self.limits, each.name)) != each.default:
                words.append(f"--limit-{each.name.replace('_', '-')} {value:g}")
        return " ".join(words)


@dataclass
class Outcome:
    """Result of a run."""

    wanted: Wanted
    violations: list[Violation] = field(default_factory=list)
    figures: dict[str, Any] = field(default_factory=dict)
    steps: int = 0
    log_tail: str = ""


class Conductor:
    """One run on a running daemon."""

    def __init__(self, wanted: Wanted, running: Daemon, honest: Talker, player: Talker, log: Callable[[str], None]):
        self.outcome = Outcome(wanted)
        self._wanted, self._daemon, self._honest, self._player, self._log = wanted, running, honest, player, log
        noise = Noise(stretch_most=wanted.limits.stretch_most * wanted.patience)
        # With a part of a core, a daemon that is late refuses commands that may be old: the robot stops meanwhile.
        limits = dataclasses.replace(wanted.limits, p99_s=wanted.limits.p99_s * wanted.patience)
        self._drive, self._record = DriveRecord(limits, noise), DaemonRecord(limits, noise)
        self._noise = noise
        self._watch = Watch(running, self._record, patience_s=REQUEST_TIMEOUT_S * wanted.patience)
        self._keeper = DaemonKeeper(running, noise, self._drive, wanted.limits, self._note)
        self._under_way: dict[int, str] = {}
        self._recent: list[tuple[int, str]] = []  # what began in this phase
        self._began: list[str] = []  # in this step
        self._calls: dict[str, float] = {}
        self._done = asyncio.Event()
        self._left = asyncio.Event()
        self._is_moving = asyncio.Event()
        self._step = -1
        self._drive_judged_s = 0.0
        self._is_ending = False
        self._p99s_s: list[float] = []

    async def run(self) -> Outcome:
        """Baseline, steps, the end; to the first violation unless it keeps going."""
        async with asyncio.TaskGroup() as tasks:
            running = [
                tasks.create_task(self._watch.sample_all()),
                tasks.create_task(self._watch.poll_health()),
                tasks.create_task(self._read_honest()),
                tasks.create_task(self._read_player()),
                tasks.create_task(self._keeper.run()),
            ]
            try:
                await self._play()
            finally:
                for task in running:
                    task.cancel()
        self._note_figures()
        return self.outcome

    async def _play(self) -> None:
        await self._measure_baseline()
        began_s, number = time.monotonic(), self._wanted.first_step
        while not self._is_over(number, time.monotonic() - began_s):
            await self._play_step(number)
            number += 1
        await self._keeper.finish()
        if self._goes_on():
            await self._end()
        else:
            await self._sample_once_more()

    async def _sample_once_more(self) -> None:
        """Judge again after a first violation, which may be the beginning of the daemon's end."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(DEATH_S):
                await self._daemon.child.wait()
        self._judge()
        if self._daemon.child.returncode is not None:
            await self._judge_last_velocity()

    async def _measure_baseline(self) -> None:
        """Measure the honest robot before any hostile peer connects."""
        async with asyncio.timeout(SERVED_S):
            while self._drive.commands < BASELINE_COMMANDS and self._goes_on():
                await asyncio.sleep(POLL_S)
                self._judge()
        self._drive.baseline_s = self.outcome.figures["baseline_p99_s"] = self._drive.latest_p99_s

    def _is_over(self, number: int, played_s: float) -> bool:
        steps = self._wanted.steps
        is_enough = number - self._wanted.first_step >= steps if steps is not None else played_s >= self._wanted.seconds
        return is_enough or not self._goes_on()

    def _goes_on(self) -> bool:
        is_alive = not self._has_died() and not self._watch.is_deadly
        return is_alive and (self._wanted.keeps_going or not self.outcome.violations)

    def _has_died(self) -> bool:
        return self._daemon.child.returncode is not None and not self._daemon.is_away

    async def _play_step(self, number: int) -> None:
        self._step = number
        self._done.clear()
        self._began.clear()
        if number % PHASE_STEPS == 0:
            self._recent = [each for each in self._recent if each[0] in self._under_way]
        self._player.send({"step": number})
        deadline_s = time.monotonic() + STEP_MARGIN_S
        while not self._done.is_set():
            await _wait(self._done, POLL_S)
            self._judge()
            if not self._goes_on():
                return
            if time.monotonic() > deadline_s:
                raise TimeoutError(f"the generator did not end step {number}")
        self._log_step()

    def _judge(self) -> None:
        """Note what did not hold."""
        now_s = time.monotonic()
        found = self._drive.check(now_s) if self._drive_is_due(now_s) else []
        found += self._record.check() + self._overdue_calls(now_s)
        status = self._daemon.child.returncode
        if self._has_died() and not self._is_ending:
            self._is_ending = True  # it is logged once
            self._watch.scan(now_s)
            dead = Violation("the daemon lives", 0, 0, f"exit status {status}", at_s=now_s)
            found = [*found, dead, *self._record.check()]
        self._note(found)

    def _drive_is_due(self, now_s: float) -> bool:
        """Whether the honest robot's record is due to be judged, once a second."""
        if now_s < self._drive_judged_s + JUDGE_S:
            return False
        self._drive_judged_s = now_s
        return True

    def _note(self, found: list[Violation]) -> None:
        for each in found:
            named = dataclasses.replace(each, step=self._step, under_way=self._situation())
            self.outcome.violations.append(named)
            self._log(f"  ! {named}")

    def _situation(self) -> tuple[str, ...]:
        """Return the actions of this phase, the newest last."""
        return tuple(f"{'' if number in self._under_way else '(over) '}{what}" for number, what in self._recent[-12:])

    # -- lines of the children ---------------------------------------------------------------------------------------

    async def _read_honest(self) -> None:
        while True:
            event = await self._honest.receive()
            self._drive.add(event)
            if event[0] == "velocity" and event[2]:
                self._is_moving.set()
            if event[0] == "began":
                self._is_moving.clear()

    async def _read_player(self) -> None:
        while True:
            facts = await self._player.receive()
            if "began" in facts:
                self._under_way[facts["began"]] = facts["kind"]
                if facts["may_drive"]:
                    self._drive.rival_began(facts["began"], facts["at_s"])
            elif "what" in facts:
                kind = self._under_way.get(facts["action"], "")
                self._began.append(f"{kind}: {facts['what']}")
                self._recent.append((facts["action"], self._began[-1]))
            elif "daemon" in facts:
                if facts["daemon"] == "restart":
                    self._calls.clear()  # over UDP no device hears that its daemon is another one
                self._keeper.request(facts)
            elif "broken" in facts:
                self._note([Violation(facts["broken"], 0, 0, facts["detail"], at_s=time.monotonic())])
            elif "ended" in facts:
                self._under_way.pop(facts["ended"], None)
                self._drive.rival_ended(facts["ended"], facts["at_s"])
            elif "calls" in facts:
                self._calls[facts["calls"]] = facts["began_s"]
            elif "called" in facts:
                self._judge_call(facts)
            elif "done" in facts:
                self._done.set()
            elif "left" in facts:
                self._left.set()

    def _judge_call(self, facts: dict[str, Any]) -> None:
        """A call has ended; whether it lasted too long is found while it waits."""
        began_s = self._calls.pop(facts["called"], None)
        if began_s is not None and facts["outcome"] not in ("answered", "the link ended"):
            detail = f"{facts['called']}: {facts['outcome']}"
            limit_s = self._wanted.limits.requested_s
            self._note([Violation(CALL_IS_ANSWERED, facts["waited_s"], limit_s, detail, at_s=began_s)])

    def _overdue_calls(self, now_s: float) -> list[Violation]:
        """Return the calls without an answer in time, each once."""
        found = []
        for what, began_s in list(self._calls.items()):
            limit_s = self._wanted.limits.requested_s * self._noise.stretch(began_s, now_s)
            limit_s += self._noise.paused_s(began_s, now_s)
            if now_s - began_s > limit_s:
                del self._calls[what]
                found.append(Violation(CALL_IS_ANSWERED, now_s - began_s, limit_s, what, at_s=began_s))
        return found

    # -- the end ------------------------------------------------------------------------------------------------------

    async def _end(self) -> None:
        """Everybody hostile leaves, memory settles, and SIGTERM ends the daemon while the honest robot is driven."""
        await self._wait_for_calls()
        self._player.send({"leave": True})
        await self._left.wait()
        await self._settle()
        if not self._goes_on():
            return
        self._is_moving.clear()
        self._honest.send({"last": True})
        if not await _wait(self._is_moving, SERVED_S):
            self._note([Violation("the robot is driven once everybody has left", SERVED_S, SERVED_S)])
        await asyncio.sleep(DRIVE_BEFORE_END_S)
        self._judge()
        if self._goes_on():
            await self._terminate()

    async def _wait_for_calls(self) -> None:
        while self._calls and self._goes_on():
            await asyncio.sleep(POLL_S)
            self._judge()

    async def _settle(self) -> None:
        deadline_s = time.monotonic() + SETTLE_S
        while (found := self._record.settle()) and time.monotonic() < deadline_s and self._goes_on():
            await asyncio.sleep(POLL_S)
            self._judge()
        self.outcome.figures["settled_growth_mib"] = self._record.growth_mib
        self._note(found)

    async def _terminate(self) -> None:
        limits = self._wanted.limits
        self._is_ending = True
        began_s = time.monotonic()
        self._watch.stop_requests()
        self._daemon.child.send_signal(signal.SIGTERM)
        try:
            async with asyncio.timeout(5 * limits.end_s * self._wanted.patience):
                status = await self._daemon.child.wait()
        except TimeoutError:
            most_s = 5 * limits.end_s * self._wanted.patience
            self._note([Violation("SIGTERM ends the daemon, s", most_s, limits.end_s, "it still runs")])
            return
        lasted_s = time.monotonic() - began_s
        self.outcome.figures["end_s"] = lasted_s
        limit_s = limits.end_s * self._noise.stretch(began_s, time.monotonic())
        found = []
        if lasted_s > limit_s:
            found.append(Violation("SIGTERM ends the daemon, s", lasted_s, limit_s))
        if status != 0:
            found.append(Violation("SIGTERM ends the daemon with status 0", status, 0))
        self._watch.scan(time.monotonic())
        self._note(found + self._record.check())
        await self._judge_last_velocity()

    async def _judge_last_velocity(self) -> None:
        """However the daemon ended, the last frame of the robot must have been a zero."""
        await asyncio.sleep(LAST_WORD_S)
        last = self._drive.velocity_before_close
        if last != (0.0, 0.0):
            self._note([Violation("the last velocity is zero", 0, 0, f"it was {last}")])

    # -- output -------------------------------------------------------------------------------------------------------

    def _log_step(self) -> None:
        self.outcome.steps += 1
        self._p99s_s.append(self._drive.latest_p99_s)
        kinds = ", ".join(what.partition(":")[0] for what in self._began)
        record = self._record
        costs = f"memory {record.last_memory_bytes / MIB:5.0f} MiB  log {record.most_log_bytes / 1024:7.0f} KiB"
        self._log(f"step {self._step:3}  p99 {1000 * self._drive.latest_p99_s:6.1f} ms  {costs}  {kinds}")

    def _note_figures(self) -> None:
        zeros_s = self._drive.zeros_s
        self.outcome.figures |= {
            "commands": self._drive.commands,
            "worst_step_p99_s": max(self._p99s_s, default=0.0),
            "median_step_p99_s": percentile(self._p99s_s, 0.5) if self._p99s_s else 0.0,
            "ends": len(zeros_s),
            "longest_zero_s": max(zeros_s, default=0.0),
            "oldest_velocity_s": self._drive.oldest_s,
            **self._keeper.counts,
            "longest_lag_s": self._noise.lag_s(0.0, time.monotonic()),
            "daemon_waited_s": self._noise.waited_s(0.0, time.monotonic()),
            "most_memory_mib": self._record.most_memory_bytes / MIB,
            "log_kib": self._record.most_log_bytes / 1024,
            "most_robots": self._record.most_robots,
            "slowest_healthz_s": self._record.slowest_s,
        }


async def _wait(event: asyncio.Event, seconds: float) -> bool:
    """Whether it came in that time."""
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(seconds):
            await event.wait()
    return event.is_set()


async def run(wanted: Wanted, log: Callable[[str], None]) -> Outcome:
    """Play it on a daemon of its own; nothing of it is left afterwards."""
    with tempfile.TemporaryDirectory(prefix="chaos") as folder, contextlib.ExitStack() as stack:
        part = None if wanted.quota is None else stack.enter_context(part_of_a_core(wanted.quota))
        async with daemon(Path(folder), has_udp=wanted.has_udp, part=part) as running:
            ports = [str(running.tcp[1]), str(running.api[1]), str(running.udp[1] if running.udp else 0)]
            stage = {
                "tcp": running.tcp,
                "micro_ros": running.micro_ros,
                "api": running.api,
                "fleet": running.fleet,
                "wrong_certificate": [str(path) for path in running.wrong_certificate],
            } | ({"udp": running.udp} if running.udp else {})
            async with (
                talker("honest", str(wanted.seed), *ports, str(HANDSHAKE_S * wanted.patience)) as honest,
                talker("player", str(wanted.seed), json.dumps(stage), *wanted.kinds) as player,
            ):
                outcome = await Conductor(wanted, running, honest, player, log).run()
            if outcome.violations:
                outcome.log_tail = _tail(running.log)
            if wanted.log is not None:
                shutil.copy(running.log, wanted.log)
    return outcome


def _tail(log: Path) -> str:
    with log.open("rb") as file:
        file.seek(max(0, log.stat().st_size - TAIL_BYTES))
        return file.read().decode(errors="replace")
