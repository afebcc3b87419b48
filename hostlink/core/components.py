"""Components by name (entry-point group `hostlink.components`), and their supervision."""

import asyncio
import contextlib
import functools
from collections import Counter
from collections.abc import AsyncIterator, Callable, Coroutine, Iterator, Mapping
from typing import Any

import structlog

from hostlink.core.config import Config
from hostlink.core.host import Component, Host
from hostlink.core.hub.hub import Hub
from hostlink.core.runtime import plugins
from hostlink.core.runtime.cancellation import first_error, raise_if_cancelled
from hostlink.core.runtime.loop_time import loop_time_s
from hostlink.errors import ConfigError, HostlinkError

GROUP = "hostlink.components"
FIRST_PAUSE_S, LONGEST_PAUSE_S = 1.0, 60.0  # before another run; doubled after each failure
STEADY_S = 60.0  # after a run of this length the pause is the first one again

log = structlog.get_logger()
AnyComponent = Component[Any]
Make = Callable[[], AnyComponent]  # of a component for one run


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
        ConfigError: the component cannot be imported.
    """
    return find_component(name).settings_type if name in _entry_points() else None


def chosen_components(config: Config) -> list[tuple[str, type[AnyComponent], object]]:
    """Return name, component and settings of each that runs: it has a table, or [components] switches it on.

    Raises:
        ConfigError: a component is not installed, cannot be imported, or needs settings that the file does not have.
    """
    chosen = []
    switches = ({"mdns": True} if config.tcp.mdns else {}) | config.components  # tcp.mdns is older than [components]
    for name in sorted(config.component_settings.keys() | switches.keys()):
        kind = find_component(name)
        if not switches.get(name, True):
            continue
        settings = config.component_settings.get(name)
        if settings is None:
            try:
                settings = kind.settings_type()
            except TypeError as error:
                advice = f"it needs a table [{name}] with its settings: {error}"
                raise ConfigError(f"components.{name}", advice) from error
        chosen.append((name, kind, settings))
    return chosen


@functools.cache
def _entry_points() -> Mapping[str, Any]:
    return plugins.entry_points(GROUP)


async def supervise(hub: Hub, name: str, make: Make) -> None:
    """Run a component until cancelled. When it fails, its robots are stopped, and it is run again after a pause."""
    counts, kept = Counter[str](), dict[str, Any]()
    hub.counts.components[name] = lambda: counts
    pause_s = FIRST_PAUSE_S
    while True:
        began_s = loop_time_s()
        reason = await _run_once(hub, name, make, counts, kept)
        counts["failures"] += 1
        if loop_time_s() >= began_s + STEADY_S:
            pause_s = FIRST_PAUSE_S
        hub.diagnoses.observe_own(name, "component_failed", f"{name}: {reason}")
        log.warning("component.ended", component=name, reason=reason, again_in_s=pause_s)
        await asyncio.sleep(pause_s)
        hub.diagnoses.observe_own(name)
        pause_s = min(2 * pause_s, LONGEST_PAUSE_S)


async def _run_once(hub: Hub, name: str, make: Make, counts: Counter[str], kept: dict[str, Any]) -> str:
    """Run a component to its end. Return why it ended."""
    error: BaseException | None = None
    try:
        async with hosted(hub, name, counts, kept) as host:
            await make().run(host)
    except* Exception as group:  # noqa: BLE001 - a component of another package may raise anything
        error = first_error(group)
    raise_if_cancelled()
    if error is None:
        return "it ended by itself"
    if isinstance(error, Exception) and not isinstance(error, HostlinkError | OSError):
        hub.isolation.crashed("component", error, component=name)
    return str(error) or repr(error)


@contextlib.contextmanager
def hosted_part(hub: Hub, name: str) -> Iterator[Host]:
    """Make the host of a part of the daemon for the length of a block. A crash of spawned work ends only that work."""
    host = Host(hub, name, lambda work, part: hub.spawn(work, name=part), Counter())
    try:
        yield host
    finally:
        host.close()


@contextlib.asynccontextmanager
async def hosted(hub: Hub, name: str, counts: Counter[str], kept: dict[str, Any] | None = None) -> AsyncIterator[Host]:
    """Make a host for the length of a block. What the block has spawned ends with it; then all that it took does.

    An error of the block, or of what it has spawned, is raised in an exception group. `kept`: for the block
    that follows.
    """
    with contextlib.ExitStack() as leaving:
        async with asyncio.TaskGroup() as tasks:
            spawned = set[asyncio.Task[object]]()

            def spawn(work: Coroutine[Any, Any, object], part: str) -> None:
                try:
                    task = tasks.create_task(work, name=f"{name}: {part}")
                except RuntimeError:  # the run ends, or has ended: the work would be cancelled before its first turn
                    work.close()
                    return
                spawned.add(task)
                task.add_done_callback(spawned.discard)
                task.add_done_callback(lambda _: work.close())  # it may be cancelled before its first turn

            host = Host(hub, name, spawn, counts, kept)
            leaving.callback(host.close, is_resumed=kept is not None)
            try:
                yield host
            finally:
                for task in spawned:
                    task.cancel()
