"""Usual components run unless [components] switches them off."""

from hostlink.core.components import Chosen, chosen_components
from hostlink.core.config import Config

USUAL = ("gateway", "recorder")


def chosen(config: Config) -> list[Chosen]:
    """Return the components of a daemon with these settings.

    Raises:
        ConfigError: as for `chosen_components`.
    """
    return chosen_components(config, USUAL)
