"""Arguments that several commands have."""

import json
from typing import Annotated

import typer

from hostlink.errors import ConfigError

Url = Annotated[str, typer.Option(help="Where hostlink's API is.", envvar="HOSTLINK_URL")]
Token = Annotated[
    str | None,
    typer.Option(
        help="For an API that needs one; in the environment no other user can read it.",
        envvar="HOSTLINK_TOKEN",
        show_default=False,
    ),
]


def json_object(name: str, text: str) -> dict[str, object]:
    """The JSON object of an argument.

    Raises:
        ConfigError: it is none; the exit status is 2.
    """
    try:
        value = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ConfigError(name, f"is no JSON: {error}") from error
    if not isinstance(value, dict):
        raise ConfigError(name, 'must be a JSON object, as {"data": 1}')
    return value
