"""`hostlink params`: list, get, set, delete, dump and load the parameters that devices request."""

import json as json_text
import tomllib
from pathlib import Path
from typing import Annotated, Any

import typer

from hostlink.cli.arguments import Json, ParameterName, Token, Url, parameter_names
from hostlink.cli.connecting import ask, rosapi
from hostlink.cli.names import unknown
from hostlink.cli.output import quantity, write, write_error, write_table
from hostlink.client import DEFAULT_URL, Host
from hostlink.core.runtime.text_file import read_text
from hostlink.errors import ConfigError

app = typer.Typer(
    no_args_is_help=True,
    help="The parameters that devices request: those of the configuration, and those that were set since.",
)


@app.command("list")
def list_(
    group: Annotated[
        str, typer.Argument(help="Only the parameters of this group.", autocompletion=parameter_names)
    ] = "",
    *,
    url: Url = DEFAULT_URL,
    token: Token = None,
    json: Json = False,
) -> None:
    """List the parameters with their values."""
    begin = f"/{group.strip('/')}/" if group.strip("/") else "/"
    found = {name: value for name, value in ask(url, token, _values).items() if name.startswith(begin)}
    if json:
        write(json_text.dumps(found))
    elif found:
        write_table(["parameter", "value"], [[name, json_text.dumps(value)] for name, value in found.items()])
    elif begin != "/":
        write_error(f"there are no parameters in {begin[:-1]}; `hostlink params list` lists all")
    else:
        write_error(
            "there are no parameters; `hostlink params set NAME VALUE` or [parameters] of the configuration sets one"
        )


@app.command()
def get(name: ParameterName, *, url: Url = DEFAULT_URL, token: Token = None) -> None:
    """Print a parameter as JSON; the name of a group prints an object of the parameters in it."""
    write(json_text.dumps(ask(url, token, lambda host: _get(host, name))))


@app.command("set", context_settings={"ignore_unknown_options": True})  # a negative number is a value
def set_(
    name: ParameterName,
    value: Annotated[str, typer.Argument(help="JSON, for example 1.5, true or [1, 2]; any other text is a string.")],
    *,
    url: Url = DEFAULT_URL,
    token: Token = None,
) -> None:
    """Set a parameter until the daemon ends. A device receives it when it requests it, usually when it connects."""
    ask(url, token, lambda host: _set(host, {name: _value(value)}))
    write_error(
        f"{name} is {json_text.dumps(_value(value))} until the daemon ends; write it under [parameters] to keep it"
    )


@app.command()
def delete(name: ParameterName, *, url: Url = DEFAULT_URL, token: Token = None) -> None:
    """Delete a parameter, or a group with all its parameters."""
    ask(url, token, lambda host: host.call("/rosapi/delete_param", {"name": name}))


@app.command()
def dump(
    file: Annotated[Path | None, typer.Argument(help="File to write; else standard output.")] = None,
    *,
    url: Url = DEFAULT_URL,
    token: Token = None,
) -> None:
    """Save all parameters as JSON, which `hostlink params load` reads."""
    found = ask(url, token, _values)
    text = json_text.dumps(found, indent=2)
    if file is None:
        typer.echo(text)
        return
    try:
        file.write_text(text + "\n", encoding="utf-8")
    except OSError as error:
        raise ConfigError("FILE", f"{file} cannot be written: {error.strerror}; name another file") from error
    write_error(f"{quantity(len(found), 'parameter')} in {file}")


@app.command()
def load(
    file: Annotated[Path, typer.Argument(help="JSON, or a hostlink.toml with a table of parameters.")],
    *,
    url: Url = DEFAULT_URL,
    token: Token = None,
) -> None:
    """Set the parameters of a file; other parameters keep their values."""
    values = _read(file)
    ask(url, token, lambda host: _set(host, values))
    write_error(f"{quantity(len(values), 'parameter')} set")


async def _values(host: Host) -> dict[str, Any]:
    return {name: await _read_value(host, name) for name in await rosapi(host, "get_param_names", "names")}


async def _read_value(host: Host, name: str) -> Any:
    return json_text.loads(await rosapi(host, "get_param", "value", name=name))


async def _get(host: Host, name: str) -> Any:
    if not await rosapi(host, "has_param", "exists", name=name):
        known = await rosapi(host, "get_param_names", "names")
        raise unknown("parameter", name, known, command="params list")
    return await _read_value(host, name)


async def _set(host: Host, values: dict[str, Any]) -> None:
    for name, value in values.items():
        await host.call("/rosapi/set_param", {"name": name, "value": json_text.dumps(value)})


def _value(text: str) -> Any:
    try:
        return json_text.loads(text)
    except (ValueError, RecursionError):
        return text


def _read(file: Path) -> dict[str, Any]:
    """Return the parameters of a file by name.

    Raises:
        ConfigError: the file cannot be read, or has no parameters.
    """
    try:
        text = read_text(file)
        values = tomllib.loads(text).get("parameters") if file.suffix == ".toml" else json_text.loads(text)
    except OSError as error:
        raise ConfigError("FILE", f"{file} cannot be read: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise ConfigError(
            "FILE", f"{file} is neither JSON nor TOML: {error}; `hostlink params dump` shows the form"
        ) from error
    if not isinstance(values, dict):
        raise ConfigError("FILE", f"{file} has no parameters; write a JSON object, or [parameters] in a .toml file")
    return values
