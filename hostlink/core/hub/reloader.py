"""Reloader: reads the settings again, and applies all that can change without a restart, or nothing."""

import asyncio
import contextlib
import dataclasses
import itertools
from collections.abc import Callable, Coroutine, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

import structlog

from hostlink.core.config import AT_ONCE, Config, RobotConfig
from hostlink.core.hub.links import addresses_of
from hostlink.core.hub.robot_settings import LIMITS, limits_of
from hostlink.core.robot.kinematics import SETTINGS
from hostlink.core.robot.names import Places
from hostlink.core.runtime.detached import DetachedThread
from hostlink.errors import HostlinkError, ReloadRefused

log = structlog.get_logger()

ROBOT = ("address", "devices", "command_device", "kinematics", "wheel_radius_m", *SETTINGS, *LIMITS)

READ_TIMEOUT_S = 10.0  # 20,000 robots take 2 to 4 s on a busy machine; longer waits are for a disk or a network
MAX_LOGGED = 50  # settings in a line of the log


def places_of(config: Config) -> Places:
    """Return the configured addresses of robots, and check their limits. With thousands of robots, call it in a thread.

    Raises:
        ConfigError: limits of a robot cannot be kept.
    """
    for robot in config.robots.values():
        limits_of(robot)
    return Places(addresses_of(config), {name: robot.devices for name, robot in config.robots.items() if robot.devices})


class Change(NamedTuple):
    """Applicable settings, names of changed settings, and names of settings that need a restart."""

    config: Config
    changed: tuple[str, ...]
    needs_restart: tuple[str, ...]


def change(old: Config, new: Config) -> Change:
    """Return the settings of `new` that a daemon with `old` can apply at once."""
    tables = {**old.component_settings, **new.component_settings}
    kinds = {name: type(table) for name, table in tables.items() if _applied_at_once(type(table))}
    old, new = _with_tables(old, kinds), _with_tables(new, kinds)
    names = {**old.robots, **new.robots}
    robots = {name: _robot(old, new, name) for name in names}
    kept = {name: robot for name, robot in robots.items() if name in new.robots or robot != RobotConfig()}
    config = dataclasses.replace(old, robots=kept)
    for name, kind in kinds.items():
        wanted = {each: getattr(new.table(name, kind), each) for each in _applied_at_once(kind)}
        config = config.with_tables(**{name: dataclasses.replace(old.table(name, kind), **wanted)})
    old, between, new = (_with_robots(each, names) for each in (old, config, new))
    return Change(config, tuple(_differences(old, between)), tuple(_differences(between, new)))


def _robot(old: Config, new: Config, name: str) -> RobotConfig:
    wanted = new.robots.get(name, RobotConfig())
    changed = {setting: getattr(wanted, setting) for setting in ROBOT}
    return dataclasses.replace(old.robots.get(name, RobotConfig()), **changed)


def _applied_at_once(kind: type) -> list[str]:
    """Names of the settings of a component's table that need no restart."""
    return [each.name for each in dataclasses.fields(kind) if each.metadata == AT_ONCE]


def _with_tables(config: Config, kinds: Mapping[str, type]) -> Config:
    """Add the default settings of tables that the file does not have."""
    return config.with_tables(**{name: config.table(name, kind) for name, kind in kinds.items()})


def _with_robots(config: Config, names: Iterable[str]) -> Config:
    """Add the default settings of robots that are not configured."""
    return dataclasses.replace(config, robots={name: config.robots.get(name, RobotConfig()) for name in names})


def _differences(old: object, new: object, where: str = "") -> Iterator[str]:
    """Yield the names of different settings, as in the file."""
    if old == new:
        return
    parts, others = _parts(old), _parts(new)
    if parts is None or others is None:
        yield where
        return
    for name in {**parts, **others}:
        yield from _differences(parts.get(name), others.get(name), f"{where}.{name}".lstrip("."))


def _parts(part: Any) -> dict[str, Any] | None:
    """Return the entries of a table; None for a value."""
    if isinstance(part, dict):
        return part
    if part is None or not dataclasses.is_dataclass(part):
        return None
    found = {field.name: getattr(part, field.name) for field in dataclasses.fields(part)}
    tables = found.pop("component_settings", {})  # each has a name of its own
    return {**found, **tables}


Read = Callable[[], Config]
Prepare = Callable[[Config], Callable[[], None]]  # checks settings in a thread; returns the function that applies them


@dataclass(frozen=True, slots=True)
class Reloaded:
    """Result of a reload: names of settings, and new names of robots by their old ones."""

    changed: tuple[str, ...] = ()
    needs_restart: tuple[str, ...] = ()
    renamed: dict[str, str] = field(default_factory=dict)


class Reconfigurable(Protocol):
    """The hub, as the reload of the settings knows it."""

    config: Config

    def reconfigure(self, config: Config, places: Places) -> dict[str, str]:
        """Change names and limits of robots. Return the new names of connected robots by their old ones."""

    def spawn(self, work: Coroutine[Any, Any, object], *, name: str) -> None:
        """Run work at most as long as the hub. A crash ends only this work."""


class Reloader:
    """Reload of the settings. Files are read, and settings are compared and checked, in a thread.

    `read` returns the settings as a new start would have them; None if the daemon has no file.
    """

    def __init__(
        self, hub: Reconfigurable, read: Read | None = None, *, read_timeout_s: float = READ_TIMEOUT_S
    ) -> None:
        self.prepares: list[Prepare] = []  # checks of the parts outside of the hub
        self._hub, self._read, self._read_timeout_s = hub, read, read_timeout_s
        self._thread = DetachedThread("reload")
        self._turn = asyncio.Lock()  # a request during a reload reads again: the file may have changed
        self._is_requested = False

    def request(self) -> None:
        """Reload soon. Errors are logged."""
        if not self._is_requested:
            self._is_requested = True
            self._hub.spawn(self._reload_as_requested(), name="reload")

    async def _reload_as_requested(self) -> None:
        with contextlib.suppress(HostlinkError):
            await self.reload()

    async def reload(self) -> Reloaded:
        """Reload the settings.

        Raises:
            ReloadRefused: the daemon was started without a file, a file cannot be read within READ_TIMEOUT_S, or a
                robot that is driven or locked would be renamed.
            ConfigError: a setting is wrong.
        """
        try:
            async with self._turn:
                self._is_requested = False
                reloaded = await self._reload()
        except HostlinkError as error:
            log.warning("config.refused", reason=str(error))
            raise
        if reloaded != Reloaded():
            facts = {
                "changed": _shown(reloaded.changed),
                "needs_restart": _shown(reloaded.needs_restart),
                "renamed": dict(itertools.islice(reloaded.renamed.items(), MAX_LOGGED)),
            }
            log.warning("config.reloaded", **{name: fact for name, fact in facts.items() if fact})
        return reloaded

    async def _reload(self) -> Reloaded:
        if self._read is None:
            raise ReloadRefused("this daemon was started without --config FILE: there is nothing to read again")
        if self._thread.is_busy:
            raise ReloadRefused("an earlier reload still waits for a file; check the disk or network that has it")
        read = self._read
        try:
            apply = await self._thread.run(lambda: self._prepare(read), timeout_s=self._read_timeout_s)
        except TimeoutError:
            raise ReloadRefused(
                f"the settings, or a file that they name, could not be read within {self._read_timeout_s:g} s; "
                "nothing has changed"
            ) from None
        return apply()

    def _prepare(self, read: Read) -> Callable[[], Reloaded]:
        """Read, compare and check the settings, in the thread. Return the function that applies them."""
        changes = change(self._hub.config, read())
        places = places_of(changes.config)
        applies = [prepare(changes.config) for prepare in self.prepares]

        def apply() -> Reloaded:
            renamed = self._hub.reconfigure(changes.config, places)
            for each in applies:
                each()
            return Reloaded(changes.changed, changes.needs_restart, renamed)

        return apply


def _shown(names: tuple[str, ...]) -> tuple[str, ...]:
    """Shorten a list of names for a log line."""
    return names if len(names) <= MAX_LOGGED else (*names[:MAX_LOGGED], f"and {len(names) - MAX_LOGGED} more")
