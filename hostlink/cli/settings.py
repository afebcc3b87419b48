"""Reading of hostlink.toml with the tables of the installed components."""

import importlib
from collections.abc import Iterable
from pathlib import Path
from typing import cast

from hostlink.core import config
from hostlink.core.config import Config
from hostlink.core.runtime import plugins

TABLES = "hostlink.tables"  # entry points: tables of components whose names are not those of the components


def load(path: Path) -> Config:
    """Read and validate a settings file.

    Raises:
        ConfigError: the file cannot be read, a setting is wrong, or a component cannot be imported.
    """
    return config.load(path, settings_type=settings_type, table_names=table_names)


def settings_type(name: str) -> type | None:
    """Return the type of a table of a component; None if no component has it.

    Raises:
        ConfigError: it, or its component, cannot be imported.
    """
    if name in (tables := plugins.entry_points(TABLES)):
        return cast("type", plugins.load(tables, name, where=name, what="table"))
    found: type | None = importlib.import_module("hostlink.core.components").settings_type(name)  # few files need it
    return found


def table_names() -> Iterable[str]:
    """Return the names of the tables of components, for the hint about an unknown one."""
    group = importlib.import_module("hostlink.core.components").GROUP
    return (*plugins.entry_points(TABLES), *plugins.entry_points(group))
