"""Reading of hostlink.toml with the tables of the installed components."""

import importlib
from pathlib import Path

from hostlink.core import config
from hostlink.core.config import Config


def load(path: Path) -> Config:
    """Read and validate a settings file.

    Raises:
        ConfigError: the file cannot be read, a setting is wrong, or a component cannot be imported.
    """
    return config.load(path, settings_type=_settings_type)


def _settings_type(name: str) -> type | None:
    found: type | None = importlib.import_module("hostlink.core.components").settings_type(name)  # few files need it
    return found
