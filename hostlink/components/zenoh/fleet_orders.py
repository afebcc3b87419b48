"""FleetOrders: stops, locks and unlocks that other daemons have not answered yet. Pure.

A stop or a lock holds for a daemon that cannot be reached: it is repeated when that daemon is seen again, also after a
restart. An unlock is sent once: a repetition would end a later lock.
"""

import asyncio
import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import msgspec

from hostlink.components.zenoh.fleet_messages import FleetAnswer, Lock, Sender, Stop, StopRequest, Unlock
from hostlink.components.zenoh.roster import FleetRoster
from hostlink.core.host import CommandEndpoint
from hostlink.core.runtime.logs import printable

ANSWER_TIMEOUT_S = 0.5  # as long as a command lasts
EAGER_S = 1.0  # after an order, or after a daemon appeared: orders are repeated in each tick
REPEAT_S = 1.0  # between later repetitions to a daemon that is there and does not answer
MAX_ORDERS = 4096  # of a stop or an unlock the oldest is forgotten, whose caller is told; then of a lock
MAX_RECEIVERS = 64  # ids in one message
_TEXT = 200


@dataclass(slots=True, eq=False)
class Order:
    """One order. `missing`: names of the daemons that have not obeyed it, by id."""

    request: Unlock | StopRequest
    what: str
    missing: dict[str, str]
    since_s: float
    obeyed: set[str] = field(default_factory=set)  # ids
    refusal: str = ""
    sent_at_s: float = -math.inf
    is_overdue: bool = False  # its caller was told
    is_settled: asyncio.Event = field(default_factory=asyncio.Event)
    boards: list[CommandEndpoint] = field(default_factory=list)  # of the daemons that obeyed: not a robot's

    @property
    def robot(self) -> str | None:
        """Name of its robot; None for every robot."""
        return self.request.robot


class FleetOrders:
    """Orders that are not obeyed yet, by number. Each stop or lock is kept until all have obeyed or are forgotten."""

    def __init__(self, roster: FleetRoster) -> None:
        self._roster = roster
        self._orders: dict[int, Order] = {}
        self._eager_until_s = -math.inf

    def add(self, request: Unlock | StopRequest, what: str, missing: dict[str, str], now_s: float) -> Order:
        """Add an order. An earlier one of the same kind for the same robot, which is overdue, is replaced."""
        missing = dict(missing)
        for number, each in list(self._orders.items()):
            if each.is_overdue and _kind(each.request) == _kind(request):
                missing |= each.missing
                del self._orders[number]
        order = Order(request, what, missing, now_s, sent_at_s=now_s)
        if not missing:
            order.is_settled.set()
            return order
        self._orders[request.number] = order
        if len(self._orders) > MAX_ORDERS:
            locks = [number for number, each in self._orders.items() if isinstance(each.request, Lock)]
            others = (number for number in self._orders if number not in set(locks))
            del self._orders[next(others, locks[0] if locks else request.number)]
        return order

    def receivers(self, request: StopRequest) -> dict[str, str]:
        """Return the names of all daemons that a stop or a lock concerns, by id, also of those out of sight.

        A stop concerns a daemon at which the robot is, or was last, connected; a lock each that knows the robot. One of
        all also concerns each daemon that has not ended: it may have boards that are not robots.
        """
        return {
            each.sender.zid: each.sender.name
            for each in self._roster.known()
            if (request.robot is None and (each.is_alive if isinstance(request, Stop) else not each.has_ended))
            or any(
                request.robot in (None, name) and (isinstance(request, Lock) or robot.link is not None)
                for name, robot in each.robots.items()
            )
        }

    def withdraw_locks(self, robot: str | None) -> None:
        """Withdraw the locks of a robot, or those of all, because it is unlocked here."""
        for number, each in list(self._orders.items()):
            if isinstance(each.request, Lock) and each.robot == robot:
                del self._orders[number]

    def lock_reason(self, robot: str) -> str | None:
        """Return the reason of the newest lock of a robot that a daemon has not obeyed yet."""
        reasons = (
            each.request.reason
            for each in reversed(self._orders.values())
            if isinstance(each.request, Lock) and each.robot == robot
        )
        return next(reasons, None)

    def greet(self, now_s: float) -> None:
        """A daemon has appeared: repeat all orders eagerly."""
        self._eager_until_s = now_s + EAGER_S

    def end(self) -> None:
        """The fleet ends here, and may be started again: what was not answered is repeated then, except an unlock."""
        self._orders = {number: each for number, each in self._orders.items() if not isinstance(each.request, Unlock)}
        for each in self._orders.values():
            each.is_overdue = True

    def fresh(self) -> list[Order]:
        """Return the orders for whose answers a caller waits."""
        return [each for each in self._orders.values() if not each.is_overdue]

    def receive(self, sender: Sender, answer: FleetAnswer) -> Order | None:
        """Note an answer. Return the order that it answers; None if it answers none."""
        order = self._orders.get(answer.number)
        if order is None:
            return None
        is_known = order.robot is None or any(each.name == order.robot for each in answer.robots)
        if isinstance(order.request, Lock) and not is_known and not answer.error:
            return order  # a daemon that was restarted does not know the robot yet
        order.obeyed.add(sender.zid)
        if order.missing.pop(sender.zid, None) is not None:
            order.boards += [each.at(sender.name) for each in answer.boards]
            if answer.error:
                order.refusal = printable(answer.reason, _TEXT)
        if not order.missing:
            order.is_settled.set()
            del self._orders[answer.number]
        return order

    def tick(self, now_s: float) -> tuple[list[Order], list[StopRequest]]:
        """Return the orders that are overdue now, and the requests to repeat, each with its receivers."""
        overdue: list[Order] = []
        repeated: list[StopRequest] = []
        newest = {_kind(each.request): number for number, each in self._orders.items()}
        for number, each in list(self._orders.items()):
            if now_s > each.since_s + 2 * ANSWER_TIMEOUT_S and not each.is_overdue:
                each.is_overdue = True
                overdue.append(each)
            if isinstance(each.request, Unlock):
                if each.is_overdue:
                    del self._orders[number]
                continue
            self._follow(each)
            if not each.missing:
                each.is_settled.set()
                del self._orders[number]
            elif number == newest[_kind(each.request)] and self._is_due(each, now_s):
                each.sent_at_s = now_s
                repeated += self._repetitions(each.request, each.missing)
        return overdue, repeated

    def _is_due(self, order: Order, now_s: float) -> bool:
        is_eager = now_s < max(order.since_s + EAGER_S, self._eager_until_s)
        return is_eager or now_s >= order.sent_at_s + REPEAT_S

    def _follow(self, order: Order) -> None:
        """Follow daemons that were restarted, a robot that has moved, and what is forgotten."""
        name = order.robot
        if isinstance(order.request, Lock) and name is not None and self._roster.place(name) is None:
            order.missing.clear()
        for zid in list(order.missing):
            known = self._roster.find_known(zid)
            if known is None or known.successor is not None:
                del order.missing[zid]
            if known is not None and known.successor is not None and known.successor.zid not in order.obeyed:
                order.missing[known.successor.zid] = known.successor.name
        if isinstance(order.request, Lock) and order.is_overdue:
            for each in self._roster.all():
                if name in each.robots and each.sender.zid not in order.obeyed:
                    order.missing[each.sender.zid] = each.sender.name

    def _repetitions(self, request: StopRequest, missing: dict[str, str]) -> Iterator[StopRequest]:
        there = iter([zid for zid in missing if self._roster.is_there(zid)])
        while receivers := tuple(itertools.islice(there, MAX_RECEIVERS)):
            yield msgspec.structs.replace(request, to=receivers)


def _kind(request: Unlock | StopRequest) -> tuple[type, str | None]:
    return type(request), request.robot
