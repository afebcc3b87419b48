"""Oracle: what must hold in every run, by docs/driving.md and docs/robot.md. It knows no code of the product.

Each command has a velocity of its own, so each velocity that is written to a board tells its command. All times are of
one clock. A promise about a time allows what the daemon's loop and line cannot avoid: a turn of the loop, a beat after
it was late, the wait for a slow UART.
"""

import bisect
import itertools
from collections import Counter, defaultdict
from collections.abc import Sequence
from typing import NamedTuple

from tests.support.simulation.journal import (
    Answered,
    Appeared,
    Began,
    Counted,
    Ended,
    Given,
    Interrupted,
    Left,
    Obeyed,
    Opened,
    Paused,
    Rebooted,
    Record,
    Stuck,
    Written,
)  # fmt: skip

LEASE_S = 0.5
BEAT_S = 0.1  # within which the daemon notices that its loop was late
UNORDERED_S = 0.1  # between two arrivals whose order is not known
HANG_S = 1.0  # after which the guardian stops the robots of a daemon that hangs
STILL_M_S, STILL_RAD_S = 0.01, 0.04  # slower may be called at rest: poses tell a speed later than the robot has it
PACED_S = 0.1  # a velocity waits for a UART of 3840 bytes a second, with what the device asked for
TURNS = 30  # of the loop, that something may take: with many links, work is done in turns


def judge(records: Sequence[Record], *, turn_s: float = 0.0) -> list[str]:
    """Return the broken promises."""
    history = History(records, turn_s)
    broken: list[tuple[float, str]] = []
    for promise in (leases, zeros, locks, interruptions, beginnings, streams, answers):
        broken += promise(history)
    return [f"{at_s:.3f} {text}" for at_s, text in sorted(broken)]


class History:
    """Records by what they tell, each with its place in the order of all."""

    def __init__(self, records: Sequence[Record], turn_s: float) -> None:
        self.records = records
        self.slack_s = 0.01 + TURNS * turn_s
        self.commands: dict[int, tuple[int, Given]] = {}  # by number
        self.given: dict[tuple[int, str], list[tuple[int, Given]]] = defaultdict(list)  # by source and robot
        self.written: dict[int, list[tuple[int, Written]]] = defaultdict(list)  # by connection
        self.opened: dict[int, Opened] = {}
        self.ended: dict[int, tuple[int, Ended]] = {}
        self.pauses: list[Paused] = []
        self.stuck: dict[int, list[Stuck]] = defaultdict(list)
        self.begun: list[tuple[int, Began]] = []
        self.left: dict[int, tuple[int, Left]] = {}
        self.robots = frozenset(each.robot for each in records if isinstance(each, Opened))
        for order, record in enumerate(records):
            match record:
                case Given():
                    self.given[record.source, record.robot].append((order, record))
                    if record.number:
                        self.commands[record.number] = order, record
                case Written():
                    self.written[record.connection].append((order, record))
                case Opened():
                    self.opened[record.connection] = record
                case Ended():
                    self.ended[record.connection] = order, record
                case Paused():
                    self.pauses.append(record)
                case Stuck():
                    self.stuck[record.connection].append(record)
                case Began():
                    self.begun.append((order, record))
                case Left():
                    self.left[record.source] = order, record

    def meant(self, interrupted: Interrupted) -> frozenset[str]:
        """Return the robots that a stop, a lock or an unlock means."""
        return frozenset((interrupted.robot,)) if interrupted.robot else self.robots

    def is_late(self, since_s: float, until_s: float) -> bool:
        """Whether the loop did not run at some time between them, or shortly before."""
        return any(pause.began_s < until_s and pause.at_s > since_s - BEAT_S for pause in self.pauses)

    def tolerance_s(self, since_s: float, until_s: float) -> float:
        """Return by how much the daemon may be wrong about times between these."""
        return self.slack_s + (BEAT_S if self.is_late(since_s, until_s) else 0.0)

    def awake_s(self, at_s: float, given_s: float) -> float:
        """Return the time; the end of the pause in which it is, if a command was given before: its frame may wait."""
        pauses = (each for each in self.pauses if given_s <= each.began_s <= at_s < each.at_s)
        return max((each.at_s for each in pauses), default=at_s)

    def is_stuck(self, connection: int, since_s: float, until_s: float) -> bool:
        """Whether a connection took nothing at some time between them."""
        was_stuck, began_s = False, 0.0
        for each in self.stuck[connection]:
            if was_stuck and began_s <= until_s and each.at_s >= since_s:
                return True
            was_stuck, began_s = each.is_stuck, each.at_s
        return was_stuck and began_s <= until_s

    def end_of(self, connection: int) -> float:
        """Return the end of a connection, at the latest that of its daemon."""
        opened, found = self.opened[connection], self.ended.get(connection)
        ends = [each.at_s for _, each in self.begun if not each.is_begun and each.at_s > opened.at_s]
        return min([*ends, float("inf") if found is None else found[1].at_s])


def leases(history: History) -> list[tuple[float, str]]:
    """No velocity is written later than a lease after its command has arrived, or was sent as far as that is known."""
    broken = []
    quickest: dict[tuple[int, str], float] = {}  # by source and robot
    numbers = sorted(history.commands)
    limit_s: dict[int, float] = {}
    for _, command in sorted(history.commands[number] for number in numbers):
        limit_s[command.number] = command.arrived_s + LEASE_S
        if command.tells_sent:
            key = command.source, command.robot
            quickest[key] = least_s = min(quickest.get(key, float("inf")), command.arrived_s - command.sent_s)
            limit_s[command.number] = min(limit_s[command.number], command.sent_s + least_s + LEASE_S + 0.05)
    for written in history.written.values():
        for _, each in written:
            if not each.number:
                continue
            if each.number not in history.commands:
                broken.append((each.at_s, f"{each.robot} is sent a velocity that nobody has commanded: {each.number}"))
                continue
            end_s = limit_s[each.number]
            command = history.commands[each.number][1]
            allowed_s = history.awake_s(end_s, command.at_s) + history.tolerance_s(command.arrived_s, each.at_s)
            if each.at_s > allowed_s:
                text = f"{each.robot} is sent {each.number} {each.at_s - end_s:.3f} s after its lease"
                broken.append((each.at_s, text))
    return broken


def zeros(history: History) -> list[tuple[float, str]]:
    """Each drive ends with a zero at a connected board: a lease after its last command, at once if its source left."""
    broken = []
    for connection, records in history.written.items():
        end_s = history.end_of(connection)
        written = sorted(records, key=lambda each: each[1].at_s)  # the guardian writes while the daemon hangs
        for place, (order, each) in enumerate(written):
            if not each.number or each.number not in history.commands:
                continue
            next_s = written[place + 1][1].at_s if place + 1 < len(written) else float("inf")
            command = history.commands[each.number][1]
            due_s, cause = command.at_s + LEASE_S, "its lease"
            left = history.left.get(command.source)
            if left is not None and left[0] > order and left[1].at_s < due_s:
                due_s, cause = left[1].at_s, "its source has left"
            until_s = min(next_s, end_s)
            allowed_s = due_s + history.tolerance_s(each.at_s, until_s) + PACED_S + history.opened[connection].held_s
            for pause in history.pauses:
                if pause.began_s <= allowed_s and due_s < pause.at_s:
                    noticed_s = min(pause.at_s, pause.began_s + HANG_S)
                    allowed_s = max(allowed_s, noticed_s + history.slack_s + BEAT_S)
            if until_s > allowed_s and not history.is_stuck(connection, each.at_s, until_s):
                text = f"{each.robot} has no zero {min(until_s, 1e9) - due_s:.3f} s after {cause} ({each.number})"
                broken.append((allowed_s, text))
    return broken


def locks(history: History) -> list[tuple[float, str]]:
    """No velocity reaches a robot while it is locked."""
    broken = []
    locked = set[str]()
    for record in history.records:
        match record:
            case Interrupted(what="lock"):
                locked |= history.meant(record)
            case Interrupted(what="unlock"):
                locked -= history.meant(record)
            case Began():
                locked.clear()
            case Written() if record.number and record.robot in locked:
                broken.append((record.at_s, f"{record.robot} is sent {record.number} while it is locked"))
    return broken


class Interruption(NamedTuple):
    """After it, who was driving must let go before a robot moves for it."""

    order: int
    at_s: float
    came_s: float  # what arrived earlier is from before it
    what: str


def interruptions(history: History) -> list[tuple[float, str]]:
    """After a stop, a lock, a pause or a new connection, who was driving must let go before a robot moves for it."""
    broken = []
    known = _interruptions_by_robot(history)
    for written in history.written.values():
        for order, each in written:
            found = history.commands.get(each.number)
            if found is None:
                continue
            commands = history.given[found[1].source, each.robot]
            for interruption in known[each.robot]:
                if interruption.order < order and not _may_drive(history, commands, found, interruption):
                    what = f"the {interruption.what} at {interruption.at_s:.3f}"
                    text = f"{each.robot} is sent {each.number} although its source has not let go since {what}"
                    broken.append((each.at_s, text))
                    break
    return broken


def _interruptions_by_robot(history: History) -> dict[str, list[Interruption]]:
    known: dict[str, list[Interruption]] = defaultdict(list)
    locked, appeared = set[str](), set[str]()  # a robot that the daemon does not know yet is not stopped
    for order, record in enumerate(history.records):
        match record:
            case Interrupted():
                meant = history.meant(record) & appeared
                for robot in meant & locked if record.what == "unlock" else meant:
                    known[robot].append(Interruption(order, record.at_s, record.arrived_s, record.what))
                locked = (
                    locked | meant if record.what == "lock" else locked - meant if record.what == "unlock" else locked
                )
            case Began():
                locked.clear()
                appeared.clear()
            case Paused() if record.at_s - record.began_s > LEASE_S + 0.001:
                for robot in history.robots:
                    known[robot].append(Interruption(order, record.began_s, record.began_s, "pause"))
            case Appeared():
                late = [each.began_s for each in history.pauses if each.began_s <= record.at_s <= each.at_s + 0.5]
                came_s = min([record.at_s, *late])
                appeared.add(record.robot)
                known[record.robot].append(Interruption(order, record.at_s, came_s, "connection"))
    return known


def _may_drive(
    history: History, commands: list[tuple[int, Given]], found: tuple[int, Given], interruption: Interruption
) -> bool:
    """Whether a command may move the robot after an interruption: its source was quiet, has let go, or knows of it."""
    given_order, command = found
    stop_order, stop_s, came_s, what = interruption
    if given_order < stop_order:
        return False
    if command.learned_s is not None:
        return command.learned_s >= stop_s
    slack_s = history.tolerance_s(came_s - 1.0, command.at_s)
    place = bisect.bisect_left(commands, (stop_order,))
    last = commands[place - 1][1] if place else None
    is_driving = last is not None and last.number > 0 and last.at_s > stop_s - LEASE_S + slack_s
    last_s, last_sent_s = stop_s, last.sent_s if last is not None else 0.0
    for order, each in commands[place:]:
        if each.number and each.arrived_s < came_s - UNORDERED_S - slack_s:
            is_driving = True
        elif not each.number:
            is_driving = False
        elif each.learned_s is not None:
            is_driving = each.learned_s < stop_s
        elif each.arrived_s >= last_s + LEASE_S - slack_s - (BEAT_S if what == "pause" else 0.0):
            is_driving &= each.tells_sent and each.sent_s < last_sent_s + LEASE_S - slack_s
        if order >= given_order:
            return not is_driving
        last_s, last_sent_s = max(each.at_s, stop_s), each.sent_s
    return not is_driving


def beginnings(history: History) -> list[tuple[float, str]]:
    """The first velocity on a connection is zero."""
    return [
        (written[0][1].at_s, f"{written[0][1].robot} is sent {written[0][1].number} before a zero on a new connection")
        for written in history.written.values()
        if written[0][1].number
    ]


def streams(history: History) -> list[tuple[float, str]]:
    """No message of one source is overtaken; on an intact connection none is lost."""
    broken = []
    newest: dict[tuple[str, int], Counted] = {}
    lines: Counter[str] = Counter()  # of each robot so far
    gaps: Counter[tuple[str, int]] = Counter()
    is_clean = {opened.robot: opened.is_clean for opened in history.opened.values()}
    has_appeared: set[str] = set()  # since its connection was opened: a board may announce itself again on it
    for record in history.records:
        match record:
            case Opened():
                lines[record.robot] += 1
                has_appeared.discard(record.robot)
            case Appeared():
                lines[record.robot] += record.robot in has_appeared
                has_appeared.add(record.robot)
            case Counted() if not record.stream.startswith("text") and is_clean[_robot_in(record.stream)]:
                before = newest.get((record.stream, record.connection))
                newest[record.stream, record.connection] = record
                if before is None or record.number == before.number + 1:
                    continue
                text = f"{record.stream}: {record.number} after {before.number}"
                if record.number <= before.number:
                    broken.append((record.at_s, text))
                elif record.stream.startswith("hub"):
                    gaps[record.stream, record.connection] += 1  # one when the board connects or announces again
                    if gaps[record.stream, record.connection] >= lines[_robot_in(record.stream)]:
                        broken.append((record.at_s, f"{text} on an intact connection"))
    return broken + _texts(history, is_clean)


def _robot_in(stream: str) -> str:
    return next(word for word in stream.split() if word.startswith("robot_"))


def _texts(history: History, is_clean: dict[str, bool]) -> list[tuple[float, str]]:
    """Compare the texts that boards got with those that the daemon was given."""
    broken = []
    given: dict[str, dict[int, Counted]] = defaultdict(dict)  # by robot and number
    arrived: dict[tuple[str, int, int], list[Counted]] = defaultdict(list)  # by robot, connection and source
    reboots: dict[str, list[float]] = defaultdict(list)
    for record in history.records:
        if isinstance(record, Rebooted):
            reboots[record.robot].append(record.at_s)
        if isinstance(record, Counted) and record.stream.startswith("text"):
            robot = _robot_in(record.stream)
            if record.stream.startswith("text given"):
                given[robot][record.number] = record
            elif is_clean[robot]:
                arrived[robot, record.connection, given[robot][record.number].connection].append(record)
    for (robot, connection, source), texts in arrived.items():
        for before, after in itertools.pairwise(texts):
            if after.number <= before.number:
                broken.append((after.at_s, f"{robot} text: {after.number} after {before.number}"))
            if any(before.at_s <= at_s <= after.at_s for at_s in reboots[robot]):
                continue  # it may have read a part of the texts between them
            broken += [
                (each.at_s, f"{robot} text: {each.number} is lost on an intact connection")
                for each in map(given[robot].get, range(before.number + 1, after.number))
                if each is not None
                and each.connection == source
                and not history.is_stuck(connection, each.at_s - 10.0, texts[-1].at_s)
            ]
    return broken


def answers(history: History) -> list[tuple[float, str]]:
    """A robot that is said to be stopped was at rest since the stop."""
    broken = []
    moves = {robot: [(0.0, False)] for robot in history.robots}  # time, whether it moves from then on
    for record in history.records:
        match record:
            case Obeyed():
                is_moving = abs(record.linear_m_s) > STILL_M_S or abs(record.angular_rad_s) > STILL_RAD_S
                moves[record.robot].append((record.at_s, is_moving))
            case Answered(state="stopped") if record.robot in moves:  # else a name that two boards shared for a moment
                known = moves[record.robot]
                place = bisect.bisect_right(known, (record.began_s, True))
                if all(is_moving for _, is_moving in known[place - 1 :]):
                    broken.append((record.at_s, f"{record.robot} is said to be stopped, and never was"))
    return broken
