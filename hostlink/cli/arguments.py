"""Arguments that are JSON."""

import json

from hostlink.errors import ConfigError


def json_object(name: str, text: str) -> dict[str, object]:
    """The object that a text spells; ConfigError, so exit status 2, when it is none."""
    try:
        value = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ConfigError(name, f"is no JSON: {error}") from error
    if not isinstance(value, dict):
        raise ConfigError(name, 'must be a JSON object, as {"data": 1}')
    return value
