"""Objects of installed packages, by the names of their entry points."""

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

from hostlink.errors import ConfigError, HostlinkError

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint


def entry_points(group: str) -> "dict[str, EntryPoint]":
    """Return the entry points of a group by name."""
    from importlib import metadata  # noqa: PLC0415 - it takes 20 ms, which few need

    return {each.name: each for each in metadata.entry_points(group=group)}


def load(found: "Mapping[str, EntryPoint]", name: str, *, where: str, what: str, own: Iterable[str] = ()) -> object:
    """Import the object of a name. `where`: the setting; `what`: kind of the object; `own`: names that need no package.

    Raises:
        ConfigError: no installed package has it, or the one that has it cannot be imported.
    """
    if name not in found:
        known = ", ".join(sorted({*own, *found})) or "none"
        raise ConfigError(where, f"no installed package has this {what}; known: {known}")
    try:
        return found[name].load()
    except HostlinkError as error:  # for example a library that is missing
        raise ConfigError(where, str(error)) from error
    except Exception as error:  # a module of another package may raise anything
        raise ConfigError(where, f"{found[name].value} cannot be imported: {error!r}") from error
