"""Registrations and parameters of this node at the master, which may die, return or forget."""

import asyncio
import contextlib
from collections import OrderedDict
from collections.abc import Callable
from typing import Any

import structlog

from hostlink.components.ros1.graph_sync import GraphSync
from hostlink.components.ros1.local_node import LocalNode, RegistrationKind
from hostlink.components.ros1.names import NameResolver
from hostlink.components.ros1.xml_rpc import CallRefused, Unreachable
from hostlink.core.config import ParameterValue
from hostlink.core.mirror.reconciler import Close, Reconciler
from hostlink.core.runtime.logs import printable

SIM_TIME = "/use_sim_time"
PATIENCE_S = 0.5  # a device waits for a second, and does nothing else
MAX_KEYS = 256  # devices may request any names
MAX_ITEMS = 1024  # values below one key; rosserial's own parameters are a few numbers
MAX_CHARS = 65536  # of texts, keys included, below one key
MAX_PARTS = 64  # of the name of a parameter
_TOO_LARGE = object()  # marks a value that no device can receive; the value itself is not kept

CHECK_INTERVAL_S = 1.0  # how late a master that is back, or another node of this name, may be noticed
STATE_INTERVAL_S = 3.0  # how late a service of another node may be; the master makes a list of all for it
END_TIMEOUT_S = 1.0  # for one call to unregister
LONGEST_END_S = 3.0  # to unregister everything; the daemon's end is forced after eight seconds


class ParameterCache:
    """Parameters of the master that this node has subscribed to, and their updates.

    Values by the key that was subscribed to; one that is not set is None. The number is bounded: the oldest is dropped.

    Any node that reaches the slave API can send updates, so the values below one key have a bound. Over it the
    key reads as not set, and parameters below it as unknown: each can be subscribed to by itself.
    """

    def __init__(self) -> None:
        self._values: OrderedDict[str, Any] = OrderedDict()

    @property
    def keys(self) -> tuple[str, ...]:
        """Keys that are subscribed to."""
        return tuple(self._values)

    def put(self, key: str, value: Any) -> str | None:
        """Note the answer to a subscription. Return the key to unsubscribe when there are too many."""
        self._values[key] = _kept(value)
        self._values.move_to_end(key)
        return self._values.popitem(last=False)[0] if len(self._values) > MAX_KEYS else None

    def update(self, key: str, value: Any) -> None:
        """Apply a change that the master reports, of a key or below it; {} is a deleted parameter."""
        key = key.rstrip("/")
        for subscribed in self._values:
            if key == subscribed:
                self._values[subscribed] = _kept(value)
            elif key.startswith(f"{subscribed}/") and self._values[subscribed] is not _TOO_LARGE:
                path = key[len(subscribed) + 1 :].split("/", MAX_PARTS)
                is_deep = len(path) > MAX_PARTS
                before = self._values[subscribed]
                self._values[subscribed] = _TOO_LARGE if is_deep else _kept(_with(before, path, value))

    def find(self, name: str) -> tuple[bool, Any]:
        """Return whether a parameter is known, and its value; None if it is not set."""
        if name in self._values:
            value = self._values[name]
            return True, None if value is _TOO_LARGE else value
        for subscribed, value in self._values.items():
            if name.startswith(f"{subscribed}/") and value is not _TOO_LARGE:
                return True, _below(value, name[len(subscribed) + 1 :].split("/"))
        return False, None


def _kept(value: Any) -> Any:
    return None if value == {} else value if _is_small(value) else _TOO_LARGE


def _is_small(value: Any) -> bool:
    """Whether a value is within the bounds, however deeply it is nested."""
    items, chars, waiting = 0, 0, [value]
    while waiting and items + len(waiting) <= MAX_ITEMS and chars <= MAX_CHARS:
        each = waiting.pop()
        items += 1
        if isinstance(each, dict):
            chars += sum(map(len, each))
            waiting += each.values()
        elif isinstance(each, list):
            waiting += each
        elif isinstance(each, str | bytes):
            chars += len(each)
    return not waiting and chars <= MAX_CHARS


def _with(tree: Any, path: list[str], value: Any) -> Any:
    """Return the tree with another value at a path."""
    branch = dict(tree) if isinstance(tree, dict) else {}
    if len(path) > 1:
        branch[path[0]] = _with(branch.get(path[0]), path[1:], value)
    elif value == {}:
        branch.pop(path[0], None)
    else:
        branch[path[0]] = value
    return branch


def _below(tree: Any, path: list[str]) -> Any:
    for part in path:
        tree = tree.get(part) if isinstance(tree, dict) else None
    return tree


class MasterParameters:
    """Parameters for devices. One that was requested once is subscribed to, and then answered without the master."""

    def __init__(self, node: LocalNode, names: NameResolver, on_change: Callable[[], None]) -> None:
        self._node, self._names, self._on_change = node, names, on_change
        self._cache = ParameterCache()

    @property
    def is_sim_time(self) -> bool:
        """Whether the time is that of /clock; `rosparam set /use_sim_time 1` means it, too."""
        value = self._cache.find(SIM_TIME)[1]
        return isinstance(value, int) and bool(value)

    async def get(self, name: str) -> ParameterValue | None:
        """Return a parameter by the name that a device uses; None if it is not set, or unusable for devices."""
        key = self._names.resolve(name)
        is_known, value = self._cache.find(key)
        if not is_known:
            try:
                async with asyncio.timeout(PATIENCE_S):
                    value = await self._subscribe(key)
            except (TimeoutError, Unreachable, CallRefused):
                return None
        usable = _usable(value)
        if usable is None and value is not None:
            kind = type(value).__name__
            self._node.log_once("ros1.parameter_unusable", name=printable(key), kind=kind)
        return usable

    def update(self, key: str, value: Any) -> None:
        """Apply a change that the master reports."""
        self._cache.update(key, value)
        self._on_change()

    async def renew(self) -> None:
        """Subscribe again to all earlier keys and to those that every node needs, for a new master.

        Raises:
            Unreachable: the master does not answer.
        """
        for key in dict.fromkeys((SIM_TIME, self._names.node, *self._cache.keys)):
            await self._subscribe(key)
        self._on_change()

    @property
    def keys(self) -> tuple[str, ...]:
        """Keys that are subscribed to: the master keeps the node for them."""
        return self._cache.keys

    async def unsubscribe(self, key: str) -> None:
        """Cancel one subscription.

        Raises:
            Unreachable: the master does not answer.
        """
        with contextlib.suppress(CallRefused):
            await self._node.call_master("unsubscribeParam", self._node.uri, key)

    async def _subscribe(self, key: str) -> Any:
        value = await self._node.call_master("subscribeParam", self._node.uri, key)
        oldest = self._cache.put(key, value)
        if oldest is not None:
            await self.unsubscribe(oldest)
        return self._cache.find(key)[1]


def _usable(value: Any) -> ParameterValue | None:
    """Return a value that rosserial can send: numbers, texts, lists of one of them; otherwise None."""
    items = value if isinstance(value, list) else [value]
    return value if all(isinstance(item, bool | int | float | str) for item in items) else None


log = structlog.get_logger()


class Registrar:
    """Compares the wanted registrations with those of the master, and calls it for each difference."""

    def __init__(
        self,
        node: LocalNode,
        sync: GraphSync,
        parameters: MasterParameters,
        service_uri: str,
        *,
        on_services: Callable[[dict[str, str]], None],
        on_collision: Callable[[str], None],
    ) -> None:
        """`on_services`: the node of each service in the graph; `on_collision`: another node has this name."""
        self._node, self._sync, self._parameters, self._service_uri = node, sync, parameters, service_uri
        self._on_services, self._on_collision = on_services, on_collision
        self._registrations: Reconciler[tuple[RegistrationKind, str], str] = Reconciler(
            replaces=True, retry_s=STATE_INTERVAL_S
        )
        self._changed = asyncio.Event()
        self._is_reachable: bool | None = None  # None: it was not called yet
        self._state_at_s = float("-inf")

    def note_change(self) -> None:
        """Note that the wanted registrations may have changed."""
        self._changed.set()

    async def run(self) -> None:
        """Keep the node registered until cancelled."""
        while True:
            self._changed.clear()
            try:
                await self._check_node()
                await self._register()
                await self._read_state()
                self._note_master(is_reachable=True)
            except Unreachable as error:
                self._note_master(is_reachable=False, reason=printable(str(error), 200))
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(CHECK_INTERVAL_S):
                    await self._changed.wait()

    async def end(self) -> None:
        """Unregister all names, within LONGEST_END_S. A master that does not answer a call in time is given up."""
        now_s = asyncio.get_running_loop().time
        keys, last = dict.fromkeys(self._registrations.open), self._registrations.next(now_s())
        if last is not None:
            keys[last.key] = None  # `run` may have been cancelled after the call, before the answer
        with contextlib.suppress(TimeoutError, Unreachable):
            async with asyncio.timeout(LONGEST_END_S):
                for key in keys:
                    async with asyncio.timeout(END_TIMEOUT_S):
                        await self._unregister(*key)
                for parameter in self._parameters.keys:
                    async with asyncio.timeout(END_TIMEOUT_S):
                        await self._parameters.unsubscribe(parameter)

    async def _check_node(self) -> None:
        """Check the address that the master has: none after its restart, another one after a name collision."""
        found = await self._node.find_own_uri()
        known = self._registrations.open
        if found is None:
            if known:
                self._node.counts.re_registrations += 1
                log.warning("ros1.registered_again", master=self._node.master_uri, count=len(known))
            self._registrations.forget(list(known))
            await self._parameters.renew()
        elif found != self._node.uri and known:
            self._on_collision(f"another node named {self._node.name} answers at {printable(found)}")

    async def _register(self) -> None:
        """Register one name after another. After a call without an answer, the next attempt repeats it."""
        registrations, now_s = self._registrations, asyncio.get_running_loop().time
        registrations.want(self._sync.wanted())
        while (action := registrations.next(now_s())) is not None:
            kind, name = action.key
            try:
                if isinstance(action, Close):
                    await self._unregister(kind, name)
                else:
                    await self._register_one(kind, name, action.spec)
                registrations.done(action)
            except CallRefused as error:
                assert not isinstance(action, Close)  # noqa: S101 - a refusal to unregister is kept there
                registrations.failed(action, now_s())
                self._node.log_once("ros1.name_refused", name=name, reason=str(error))

    async def _register_one(self, kind: RegistrationKind, name: str, type_name: str) -> None:
        third = self._service_uri if kind is RegistrationKind.SERVICE else type_name
        answer = await self._node.call_master(f"register{kind.value}", name, third, self._node.uri)
        if kind is RegistrationKind.SUBSCRIBER and isinstance(answer, list):
            self._sync.set_publishers(name, [str(uri) for uri in answer], is_answer=True)

    async def _unregister(self, kind: RegistrationKind, name: str) -> None:
        uri = self._service_uri if kind is RegistrationKind.SERVICE else self._node.uri
        with contextlib.suppress(CallRefused):  # the master has forgotten it
            await self._node.call_master(f"unregister{kind.value}", name, uri)

    async def _read_state(self) -> None:
        """Read the services of the graph, and which names of this node are still registered."""
        now_s = asyncio.get_running_loop().time()
        if now_s < self._state_at_s + STATE_INTERVAL_S:
            return
        self._state_at_s = now_s
        state = _nodes_by_name(await self._node.call_master("getSystemState"))
        own = {
            kind: {name for name, nodes in state[kind].items() if self._node.name in nodes} for kind in RegistrationKind
        }
        forgotten = [(kind, name) for kind, name in self._registrations.open if name not in own[kind]]
        if forgotten:
            self._registrations.forget(forgotten)
            self._node.counts.re_registrations += 1
            self.note_change()
        self._on_services({name: nodes[-1] for name, nodes in state[RegistrationKind.SERVICE].items() if nodes})

    def _note_master(self, *, is_reachable: bool, reason: str = "") -> None:
        """Log a line when the master is lost, and one when it is found."""
        if is_reachable is self._is_reachable:
            return
        self._is_reachable = is_reachable
        if is_reachable:
            log.info("ros1.master_found", master=self._node.master_uri, node=self._node.name)
        else:
            log.warning("ros1.master_lost", master=self._node.master_uri, reason=reason)


def _nodes_by_name(state: Any) -> dict[RegistrationKind, dict[str, list[str]]]:
    """Sort the answer to getSystemState: publishers, subscribers, services.

    Raises:
        Unreachable: the answer has another form.
    """
    try:
        parts = [{str(name): [str(node) for node in nodes] for name, nodes in part} for part in state]
        return dict(
            zip((RegistrationKind.PUBLISHER, RegistrationKind.SUBSCRIBER, RegistrationKind.SERVICE), parts, strict=True)
        )
    except (TypeError, ValueError) as error:
        raise Unreachable("the answer to getSystemState is malformed") from error
