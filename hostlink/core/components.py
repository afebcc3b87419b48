"""Components by name (entry-point group `hostlink.components`), and their supervision."""

import asyncio
import contextlib
import functools
from collections import Counter
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine, Iterable, Iterator, Mapping
from dataclasses import MISSING, fields, is_dataclass
from graphlib import CycleError, TopologicalSorter
from typing import Any, NamedTuple, TypeVar

import msgspec
import structlog

from hostlink.core.config import Config
from hostlink.core.host import Component, Connections, Host
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
Result = TypeVar("Result")


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
    if not is_dataclass(getattr(component, "settings_type", None)):
        raise ConfigError(f"components.{name}", f"settings_type of {found[name].value} is not a dataclass")
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


@contextlib.contextmanager
def _named(name: str, member: str) -> Iterator[None]:
    """Name the component and its member in the error of a member that fails, which belongs to another package.

    Raises:
        ConfigError: the block raises another error than those of hostlink.
    """
    try:
        yield
    except HostlinkError:
        raise
    except (Exception, SystemExit) as error:
        step = f"correct the component, or write {name} = false below [components]"
        raise ConfigError(f"components.{name}", f"{member} has failed: {error!r}; {step}") from error


class Chosen(NamedTuple):
    """A component that runs. Its members are those of a stranger: they may raise and return anything."""

    name: str
    kind: type[AnyComponent]
    settings: object

    def make(self) -> AnyComponent:
        """Make it with these settings.

        Raises:
            ConfigError: it cannot be made.
        """
        with _named(self.name, "__init__"):
            return self.kind(self.settings)

    def checked(self) -> tuple[list[str], dict[str, tuple[str, int]]]:
        """Return its warnings, without the table's name, and host and port of its listeners by table.

        Raises:
            ConfigError: the settings cannot be served, or its `check` or `listens` has failed.
        """
        component = self.make()
        with _named(self.name, "check"):
            found = component.check()
            warnings = msgspec.convert(found if isinstance(found, str) else list(found), list[str])
        with _named(self.name, "listens"):
            return warnings, msgspec.convert(component.listens(), dict[str, tuple[str, int]])

    def line(self) -> str:
        """Return the line that describes it. A failure is told in the line: the daemon does not need it.

        Raises:
            ConfigError: it cannot be made.
        """
        component = self.make()
        try:
            return str(component.describe())
        except Exception as error:  # noqa: BLE001 - it is of another package
            return f"{self.name}: describe has failed: {error!r}"

    def connections(self) -> dict[str, tuple[int, Connections]]:
        """Return the most connections of each table that limits them, and how these share descriptors.

        Raises:
            ConfigError: a number is wrong, or the table is not one of the component.
        """
        found = {}
        for table, sharing in self._sharing().items():
            if table not in (self.kind.tables or (self.name,)):
                raise ConfigError(f"components.{self.name}", f"connections names [{table}], which is not its table")
            with _named(self.name, "connections"):
                most = msgspec.convert(self.table(table).max_connections, int)
            if most < 1:
                raise ConfigError(f"{table}.max_connections", f"{most} is not allowed; choose at least 1")
            found[table] = most, sharing
        return found

    def _sharing(self) -> dict[str, Connections]:
        with _named(self.name, "connections"):
            found = msgspec.convert(self.kind.connections, dict[str, Connections])
            if any(min(sharing) < 1 for sharing in found.values()):
                raise ValueError("least and descriptors must be at least 1")
            return found

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
        with _named(name, "is_wanted"):
            is_wanted = name in switches or kind.is_wanted(each.settings)
        if is_wanted:
            chosen.append(each)
    _in_order(chosen)
    return chosen


def _in_order(chosen: Iterable[Chosen]) -> list[Chosen]:
    """Return those that begin first, each behind those that it uses.

    Raises:
        ConfigError: they use each other.
    """
    first = {each.name: each for each in chosen if each.kind.begins_first}
    uses = {name: first.keys() & set(each.kind.uses) for name, each in first.items()}
    try:
        return [first[name] for name in TopologicalSorter(uses).static_order()]
    except CycleError as error:
        names = [str(name) for name in error.args[1]]
        raise ConfigError(f"components.{names[0]}", f"they use each other: {' - '.join(names)}") from error


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
            needed = [each for each in fields(kind.settings_type) if each.default is each.default_factory is MISSING]
            keys = ", ".join(each.name for each in needed)
            raise ConfigError(f"components.{name}", f"it needs a table [{name}] with its settings: {keys}") from error
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
    async with contextlib.AsyncExitStack() as running:
        for each in _in_order(chosen):
            await running.enter_async_context(_begun(hub, each))
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
    return lambda: chosen._replace(settings=_settings_of(hub.config, chosen.name, chosen.kind)).make()


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
        if hub.gates.is_closed:  # the daemon ends
            await asyncio.Event().wait()
        began_s = loop_time_s()
        error = await _run_once(hub, name, make, counts, kept, ready)
        if ready is not None and not ready.is_set():
            if isinstance(error, ConfigError):
                raise error
            ready.set()
        counts["failures"] += 1
        if loop_time_s() >= began_s + STEADY_S:
            pause_s = FIRST_PAUSE_S
        reason = _report(hub, name, error)
        log.warning("component.ended", component=name, reason=reason, again_in_s=pause_s)
        await asyncio.sleep(pause_s)
        hub.diagnoses.observe_own(name)
        pause_s = min(2 * pause_s, longest_s)


def _report(hub: Hub, name: str, error: BaseException | None) -> str:
    """Let `hostlink doctor` show why a component has ended. Return the reason."""
    reason = "it ended by itself" if error is None else str(error) or repr(error)
    hub.diagnoses.observe_own(name, "component_failed", f"{name}: {reason}")
    return reason


async def _run_once(
    hub: Hub, name: str, make: Make, counts: Counter[str], kept: dict[str, Any], ready: asyncio.Event | None
) -> BaseException | None:
    """Run a component to its end. Return the error that has ended it; None: it ended by itself."""
    error: BaseException | None = None
    try:
        async with hosted(hub, name, counts, kept, ready) as host:
            await _uncancelled(make().run(host))
    except* Exception as group:  # noqa: BLE001 - a component of another package may raise anything
        error = first_error(group)
    if isinstance(error, Exception) and not isinstance(error, HostlinkError | OSError):
        hub.isolation.crashed("component", error, component=name)
    raise_if_cancelled()
    return error


async def _uncancelled(run: Awaitable[None]) -> None:
    """Await a run. What cancels a future that it awaits does not end it without a word.

    Raises:
        RuntimeError: the run was cancelled, but not by the daemon.
    """
    try:
        await _contained(run)
    except asyncio.CancelledError as error:
        raise_if_cancelled()
        raise RuntimeError("something that it awaited was cancelled") from error


async def _contained(work: Awaitable[Result]) -> Result:
    """Await work of a component, of which nothing ends the daemon: not SystemExit, and no other BaseException.

    Raises:
        RuntimeError: the work has raised such an exception.
    """
    try:
        return await work
    except (Exception, asyncio.CancelledError, GeneratorExit):
        raise
    except BaseException as error:
        raise RuntimeError(f"it has raised {error!r}") from error


@contextlib.asynccontextmanager
async def hosted(
    hub: Hub,
    name: str,
    counts: Counter[str],
    kept: dict[str, Any] | None = None,
    ready: asyncio.Event | None = None,
) -> AsyncIterator[Host]:
    """Make a host for the length of a block. What the block has spawned ends with it; then all that it took does.

    An error of the block, or of what it has spawned, is raised in an exception group. At the error, all that the block
    took ends at once: what does not end at its cancellation drives no robot. `kept`: for the block that follows.
    """
    is_resumed = kept is not None
    with contextlib.ExitStack() as leaving:
        async with asyncio.TaskGroup() as tasks:
            spawned = set[asyncio.Task[object]]()

            async def vital(work: Coroutine[Any, Any, object]) -> None:
                try:
                    await _contained(work)
                except Exception as error:
                    host.close(is_resumed=is_resumed)
                    if is_resumed:  # now, because the run may ignore its cancellation
                        _report(hub, name, error)
                    raise

            def spawn(work: Coroutine[Any, Any, object], part: str, *, is_vital: bool) -> None:
                whole = vital(work) if is_vital else hub.isolated(_contained(work), part)
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
            leaving.callback(host.close, is_resumed=is_resumed)
            try:
                yield host
            except Exception:
                host.close(is_resumed=is_resumed)
                raise
            finally:
                for task in spawned:
                    task.cancel()
