"""Arguments that several commands have, and the names that a shell completes for them."""

import json
import re
from typing import Annotated, Any

import typer

from hostlink.cli.completion import parameter_names, robot_names, service_names, topic_names, type_names
from hostlink.errors import ConfigError

# -- arguments --------------------------------------------------------------------------------------------------------

Url = Annotated[str, typer.Option(help="Where hostlink's API is.", envvar="HOSTLINK_URL")]
Token = Annotated[
    str | None,
    typer.Option(
        help="For an API that needs one; in the environment no other user can read it.",
        envvar="HOSTLINK_TOKEN",
        show_default=False,
    ),
]
Json = Annotated[bool, typer.Option("--json", help="For programs.")]
JsonLines = Annotated[bool, typer.Option("--json", help="One JSON object a line, for programs.")]
Seconds = Annotated[float, typer.Option(min=0.0, help="End after this time; 0: with Ctrl-C.")]
TopicName = Annotated[str, typer.Argument(show_default=False, autocompletion=topic_names)]
ServiceName = Annotated[str, typer.Argument(show_default=False, autocompletion=service_names)]
RobotName = Annotated[str | None, typer.Argument(show_default=False, autocompletion=robot_names)]
ParameterName = Annotated[str, typer.Argument(show_default=False, autocompletion=parameter_names)]
TypeName = Annotated[str, typer.Argument(help="As geometry_msgs/Twist.", show_default=False, autocompletion=type_names)]


def json_object(name: str, text: str) -> dict[str, object]:
    """The object of an argument, in JSON or in YAML's flow style.

    Raises:
        ConfigError: it is none; the exit status is 2.
    """
    try:
        value = read_message(text)
    except (ValueError, RecursionError) as error:
        raise ConfigError(name, f'is no JSON: {error}; write it as \'{{"linear": {{"x": 0.1}}}}\'') from error
    if not isinstance(value, dict):
        raise ConfigError(name, 'must be a JSON object, as {"data": 1}')
    return value


# -- ros text ---------------------------------------------------------------------------------------------------------

_TEXT = r'"(?:[^"\\]|\\.)*"'
_SINGLE = re.compile(rf"({_TEXT})|'((?:[^']|'')*)'")
_NAME = re.compile(rf"({_TEXT})|([A-Za-z_]\w*)(?=\s*:)")
_WORD = re.compile(rf"({_TEXT})|(?<=[:\[,])(\s*)([A-Za-z_/][^,:\[\]{{}}\"]*?)(?=\s*[,\]}}])")
_LITERALS = {"true": "true", "false": "false", "null": "null", "yes": "true", "no": "false"}


def read_message(text: str) -> Any:
    """JSON as it is; else YAML in one line, with or without the braces.

    Raises:
        ValueError: it is neither; what is wrong with it as JSON.
        RecursionError: it is nested too deeply.
    """
    try:
        return json.loads(text)
    except ValueError:
        try:
            return json.loads(_as_json(text.strip()))
        except ValueError:
            pass
        raise


def _as_json(text: str) -> str:
    """Texts, names and words get their double quotes; what has them already is passed over."""
    text = text if text.startswith(("{", "[")) else f"{{{text}}}"
    text = _SINGLE.sub(lambda found: found[1] or json.dumps(found[2].replace("''", "'")), text)
    text = _NAME.sub(lambda found: found[1] or f'"{found[2]}"', text)
    return _WORD.sub(lambda found: found[1] or found[2] + _word(found[3]), text)


def _word(word: str) -> str:
    return _LITERALS.get(word.lower()) or json.dumps(word)
