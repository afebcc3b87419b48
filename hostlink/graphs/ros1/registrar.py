"""Registrar: keeps this node registered at a master that may die, come back, or forget."""

import asyncio
import contextlib
from collections.abc import Callable
from typing import Any

import structlog

from hostlink.graphs.ros1.graph_sync import GraphSync
from hostlink.graphs.ros1.parameters import MasterParameters
from hostlink.graphs.ros1.parts import Kind, Parts
from hostlink.graphs.ros1.xml_rpc import Refused, Unreachable
from hostlink.logs import printable
from hostlink.mirror.reconciler import Close, Reconciler

log = structlog.get_logger()

CHECK_INTERVAL_S = 1.0  # how late a master that is back, or another node of this name, may be noticed
STATE_INTERVAL_S = 3.0  # how late a service of another node may be; the master makes a list of all for it
END_TIMEOUT_S = 1.0  # to unregister everything


class Registrar:
    """Compares what is wanted with what the master knows, and calls it for each difference."""

    def __init__(
        self,
        parts: Parts,
        sync: GraphSync,
        parameters: MasterParameters,
        service_uri: str,
        *,
        on_services: Callable[[dict[str, str]], None],
        on_collision: Callable[[str], None],
    ) -> None:
        """`on_services`: the node of each service in the graph; `on_collision`: another node has this name."""
        self._parts, self._sync, self._parameters, self._service_uri = parts, sync, parameters, service_uri
        self._on_services, self._on_collision = on_services, on_collision
        self._registrations: Reconciler[tuple[Kind, str], str] = Reconciler(replaces=True, retry_s=STATE_INTERVAL_S)
        self._changed = asyncio.Event()
        self._is_reachable: bool | None = None  # None: it was not called yet
        self._state_at_s = float("-inf")

    def note_change(self) -> None:
        """Something else is wanted."""
        self._changed.set()

    async def run(self) -> None:
        """Until it is cancelled."""
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
        """Unregister all, as far as there is time."""
        with contextlib.suppress(TimeoutError, Unreachable):
            async with asyncio.timeout(END_TIMEOUT_S):
                for key in self._registrations.open:
                    await self._unregister(*key)
                await self._parameters.end()

    async def _check_node(self) -> None:
        """The master knows nothing of this node when it began anew, another address when another has its name."""
        found = await self._parts.master.find_node(self._parts.node)
        known = self._registrations.open
        if found is None:
            if known:
                self._parts.counts.re_registrations += 1
                log.warning("ros1.registered_again", master=self._parts.master.uri, count=len(known))
            self._registrations.forget(list(known))
            await self._parameters.renew()
        elif found != self._parts.uri and known:
            self._on_collision(f"another node named {self._parts.node} answers at {printable(found)}")

    async def _register(self) -> None:
        """One call after another: when the master does not answer, the same call is the next one."""
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
            except Refused as error:
                assert not isinstance(action, Close)  # noqa: S101 - a refusal to unregister is kept there
                registrations.failed(action, now_s())
                self._parts.log_once("ros1.name_refused", name=name, reason=str(error))

    async def _register_one(self, kind: Kind, name: str, type_name: str) -> None:
        third = self._service_uri if kind is Kind.SERVICE else type_name
        answer = await self._parts.master.call(f"register{kind.value}", name, third, self._parts.uri)
        if kind is Kind.SUBSCRIBER and isinstance(answer, list):
            self._sync.set_publishers(name, [str(uri) for uri in answer], is_answer=True)

    async def _unregister(self, kind: Kind, name: str) -> None:
        uri = self._service_uri if kind is Kind.SERVICE else self._parts.uri
        with contextlib.suppress(Refused):  # the master does not know it any more
            await self._parts.master.call(f"unregister{kind.value}", name, uri)

    async def _read_state(self) -> None:
        """Which services there are, and what of this node is still registered."""
        now_s = asyncio.get_running_loop().time()
        if now_s < self._state_at_s + STATE_INTERVAL_S:
            return
        self._state_at_s = now_s
        state = _nodes_by_name(await self._parts.master.call("getSystemState"))
        own = {kind: {name for name, nodes in state[kind].items() if self._parts.node in nodes} for kind in Kind}
        forgotten = [(kind, name) for kind, name in self._registrations.open if name not in own[kind]]
        if forgotten:
            self._registrations.forget(forgotten)
            self._parts.counts.re_registrations += 1
            self.note_change()
        self._on_services({name: nodes[-1] for name, nodes in state[Kind.SERVICE].items() if nodes})

    def _note_master(self, *, is_reachable: bool, reason: str = "") -> None:
        """One line when it is lost, one when it is found."""
        if is_reachable is self._is_reachable:
            return
        self._is_reachable = is_reachable
        if is_reachable:
            log.info("ros1.master_found", master=self._parts.master.uri, node=self._parts.node)
        else:
            log.warning("ros1.master_lost", master=self._parts.master.uri, reason=reason)


def _nodes_by_name(state: Any) -> dict[Kind, dict[str, list[str]]]:
    """The answer to getSystemState: publishers, subscribers, services.

    Raises:
        Unreachable: it is none.
    """
    try:
        parts = [{str(name): [str(node) for node in nodes] for name, nodes in part} for part in state]
        return dict(zip((Kind.PUBLISHER, Kind.SUBSCRIBER, Kind.SERVICE), parts, strict=True))
    except (TypeError, ValueError) as error:
        raise Unreachable("its state of the graph is none") from error
