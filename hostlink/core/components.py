"""Components by name (entry-point group `hostlink.components`), and their supervision."""

import asyncio
import contextlib
import functools
from collections import Counter
from collections.abc import AsyncIterator, Callable, Coroutine, Iterable, Mapping
from dataclasses import fields
from graphlib import TopologicalSorter
from typing import Any, NamedTuple

import structlog

from hostlink.core.config import Config
from hostlink.core.host import Component, Host
from hostlink.core.hub.hub import Hub
from hostlink.core.runtime import plugins
from hostlink.core.runtime.cancellation import first_error, meanwhile, raise_if_cancelled
from hostlink.core.runtime.loop_time import loop_time_s
from hostlink.errors import ConfigError, HostlinkError

GROUP = "hostlink.components"
FIRST_PAUSE_S, LONGEST_PAUSE_S = 1.0, 60.0  # before another run; doubled after each failure
LONGEST_PAUSE_OF_FIRST_S = 5.0  # of those that begin first: people stop robots through the gateway
READY_S = 20.0  # for a component that begins first: a disk that sleeps needs several seconds
STEADY_S = 60.0  # after a run of this length the pause is the first one again

log = structlog.get_logger()
AnyComponent = Component[Any]
Make = Callable[[], AnyComponent]  # makes a component for one run


def find_component(name: str) -> type[AnyComponent]:
    """Return the component of this name.

    Raises:
        ConfigError: no installed package has it, or the one that has it cannot be imported.
    """
    found = _entry_points()
    component = plugins.load(found, name, where=f"components.{name}", what="component")
    if not (isinstance(component, type) and issubclass(component, Component)):
        raise ConfigError(f"components.{name}", f"{found[name].value} is not a subclass of Component")
    if component.name != name:
        raise ConfigError(f"components.{name}", f"{found[name].value} has the name {component.name}")
    return component


def settings_type(name: str) -> type | None:
    """Return the type of a component's table in hostlink.toml; None if no component has this name.

    Raises:
        ConfigError: the component cannot be imported, or its settings are in tables of other names.
    """
    if name not in _entry_points():
        return None
    kind = find_component(name)
    if kind.tables:
        own = " and ".join(f"[{table}]" for table in kind.tables)
        raise ConfigError(name, f"the settings of this component are in {own}; switch it on or off in [components]")
    return kind.settings_type


class Chosen(NamedTuple):
    """A component that runs."""

    name: str
    kind: type[AnyComponent]
    settings: object

    def make(self) -> AnyComponent:
        """Make it with these settings."""
        return self.kind(self.settings)

    def table(self, name: str) -> Any:
        """Return the settings of one of its tables in hostlink.toml."""
        return getattr(self.settings, name) if self.kind.tables else self.settings


def chosen_components(config: Config, usual: Iterable[str] = ()) -> list[Chosen]:
    """Return the components that run: one is wanted by its table, switched on in [components], or `usual` and not off.

    Raises:
        ConfigError: a component is not installed, cannot be imported, or needs settings that the file does not have.
    """
    chosen = []
    switches = dict.fromkeys(usual, True)
    switches |= ({"mdns": True} if config.tcp.mdns else {}) | config.components  # tcp.mdns is older than [components]
    tables = config.component_settings.keys() & _entry_points().keys()
    for name in sorted(tables | switches.keys()):
        if not switches.get(name, True) and name in _entry_points():
            continue  # what is off is not imported
        kind = find_component(name)
        each = Chosen(name, kind, _settings_of(config, name, kind))
        if name in switches or kind.is_wanted(each.settings):
            chosen.append(each)
    return chosen


def _settings_of(config: Config, name: str, kind: type[AnyComponent]) -> object:
    """Return the settings of a component.

    Raises:
        ConfigError: it needs settings that the file does not have.
    """
    if kind.tables:
        found = {each.name: getattr(config, each.name) for each in fields(config)} | config.component_settings
        names = found.keys() & {each.name for each in fields(kind.settings_type)}
        return kind.settings_type(**{name: found[name] for name in names})
    settings = config.component_settings.get(name)
    if settings is None:
        try:
            settings = kind.settings_type()
        except TypeError as error:
            advice = f"it needs a table [{name}] with its settings: {error}"
            raise ConfigError(f"components.{name}", advice) from error
    return settings


@functools.cache
def _entry_points() -> Mapping[str, Any]:
    return plugins.entry_points(GROUP)


# -- running ----------------------------------------------------------------------------------------------------------


@contextlib.asynccontextmanager
async def begun_first(hub: Hub, chosen: Iterable[Chosen]) -> AsyncIterator[None]:
    """Run the components that begin first, for the length of the block. One begins when those that it uses are ready.

    Raises:
        ConfigError: the settings of one cannot be served, for example because a port is in use.
    """
    first = {each.name: each for each in chosen if each.kind.begins_first}
    order = TopologicalSorter({name: first.keys() & set(each.kind.uses) for name, each in first.items()})
    async with contextlib.AsyncExitStack() as running:
        for name in order.static_order():
            await running.enter_async_context(_begun(hub, first[name]))
        yield


@contextlib.asynccontextmanager
async def _begun(hub: Hub, chosen: Chosen) -> AsyncIterator[None]:
    """Run a component for the length of the block, which begins when it is ready, has failed, or takes READY_S."""
    ready = asyncio.Event()
    async with meanwhile((chosen.name, supervise(hub, chosen.name, _make(hub, chosen), ready))):
        try:
            async with asyncio.timeout(READY_S):
                await ready.wait()
        except TimeoutError:
            ready.set()  # from now on a failure is one of a daemon that holds robots
            log.warning("component.late", component=chosen.name, after_s=READY_S)
        yield


@contextlib.asynccontextmanager
async def begun(hub: Hub, chosen: Iterable[Chosen]) -> AsyncIterator[None]:
    """Run the other components for the length of the block."""
    others = [each for each in chosen if not each.kind.begins_first]
    async with meanwhile(*((each.name, supervise(hub, each.name, _make(hub, each))) for each in others)):
        yield


def _make(hub: Hub, chosen: Chosen) -> Make:
    """Return what makes the component for a run, with the settings as the last reload has left them."""
    return lambda: chosen.kind(_settings_of(hub.config, chosen.name, chosen.kind))


async def supervise(hub: Hub, name: str, make: Make, ready: asyncio.Event | None = None) -> None:
    """Run a component until cancelled. When it fails, its robots are stopped, and it is run again after a pause.

    `ready` is set when it is ready or has failed.

    Raises:
        ConfigError: the settings of one with `ready` cannot be served, before it was ready.
    """
    counts, kept = Counter[str](), dict[str, Any]()
    hub.counts.components[name] = lambda: counts
    pause_s = FIRST_PAUSE_S
    longest_s = LONGEST_PAUSE_S if ready is None else LONGEST_PAUSE_OF_FIRST_S
    while True:
        began_s = loop_time_s()
        error = await _run_once(hub, name, make, counts, kept, ready)
        if ready is not None and not ready.is_set():
            if isinstance(error, ConfigError):
                raise error
            ready.set()
        reason = "it ended by itself" if error is None else str(error) or repr(error)
        counts["failures"] += 1
        if loop_time_s() >= began_s + STEADY_S:
            pause_s = FIRST_PAUSE_S
        hub.diagnoses.observe_own(name, "component_failed", f"{name}: {reason}")
        log.warning("component.ended", component=name, reason=reason, again_in_s=pause_s)
        await asyncio.sleep(pause_s)
        hub.diagnoses.observe_own(name)
        pause_s = min(2 * pause_s, longest_s)


async def _run_once(
    hub: Hub, name: str, make: Make, counts: Counter[str], kept: dict[str, Any], ready: asyncio.Event | None
) -> BaseException | None:
    """Run a component to its end. Return the error that has ended it; None: it ended by itself."""
    error: BaseException | None = None
    try:
        async with hosted(hub, name, counts, kept, ready) as host:
            await make().run(host)
    except* Exception as group:  # noqa: BLE001 - a component of another package may raise anything
        error = first_error(group)
    raise_if_cancelled()
    if isinstance(error, Exception) and not isinstance(error, HostlinkError | OSError):
        hub.isolation.crashed("component", error, component=name)
    return error


@contextlib.asynccontextmanager
async def hosted(
    hub: Hub,
    name: str,
    counts: Counter[str],
    kept: dict[str, Any] | None = None,
    ready: asyncio.Event | None = None,
) -> AsyncIterator[Host]:
    """Make a host for the length of a block. What the block has spawned ends with it; then all that it took does.

    An error of the block, or of what it has spawned, is raised in an exception group. `kept`: for the block
    that follows.
    """
    with contextlib.ExitStack() as leaving:
        async with asyncio.TaskGroup() as tasks:
            spawned = set[asyncio.Task[object]]()

            def spawn(work: Coroutine[Any, Any, object], part: str, *, is_vital: bool) -> None:
                whole = work if is_vital else hub.isolated(work, part)
                try:
                    task = tasks.create_task(whole, name=f"{name}: {part}")
                except RuntimeError:  # the run ends, or has ended: the work would be cancelled before its first turn
                    whole.close()
                    work.close()
                    return
                spawned.add(task)
                task.add_done_callback(spawned.discard)
                task.add_done_callback(lambda _: work.close())  # it may be cancelled before its first turn

            host = Host(hub, name, spawn, counts, kept, ready)
            leaving.callback(host.close, is_resumed=kept is not None)
            try:
                yield host
            finally:
                for task in spawned:
                    task.cancel()
