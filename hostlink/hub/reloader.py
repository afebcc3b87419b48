"""Reloader: reads the settings again, and changes what can be changed while it runs; all of it, or nothing."""

from collections.abc import Callable
from dataclasses import dataclass, field

import structlog

from hostlink.config import Config
from hostlink.errors import HostlinkError, ReloadRefused
from hostlink.hub.hub import Hub
from hostlink.hub.reload import change

log = structlog.get_logger()

Read = Callable[[], Config]
Prepare = Callable[[Config], Callable[[], None]]  # refuses what is wrong, or returns what changes it


@dataclass(frozen=True, slots=True)
class Reloaded:
    """Names of settings, and the new names of robots by their old ones."""

    changed: tuple[str, ...] = ()
    needs_restart: tuple[str, ...] = ()
    renamed: dict[str, str] = field(default_factory=dict)


class Reloader:
    """`read`: the settings as a new start would have them; None: there is no file."""

    def __init__(self, hub: Hub, read: Read | None = None) -> None:
        self.prepares: list[Prepare] = []  # of the parts beside the hub
        self._hub, self._read = hub, read

    def reload(self) -> Reloaded:
        """Read the settings again.

        Raises:
            ReloadRefused: the daemon was started without a file, or a robot that is driven or locked would be renamed.
            ConfigError: a setting is wrong.
        """
        try:
            reloaded = self._reload()
        except HostlinkError as error:
            log.warning("config.refused", reason=str(error))
            raise
        if reloaded != Reloaded():
            facts = {"changed": reloaded.changed, "needs_restart": reloaded.needs_restart, "renamed": reloaded.renamed}
            log.warning("config.reloaded", **{name: fact for name, fact in facts.items() if fact})
        return reloaded

    def _reload(self) -> Reloaded:
        if self._read is None:
            raise ReloadRefused("this daemon was started without --config FILE: there is nothing to read again")
        changes = change(self._hub.config, self._read())
        applies = [prepare(changes.config) for prepare in self.prepares]
        renamed = self._hub.reconfigure(changes.config)
        for apply in applies:
            apply()
        return Reloaded(changes.changed, changes.needs_restart, renamed)
