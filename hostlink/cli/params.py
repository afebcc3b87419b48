"""`hostlink params`: the parameters that devices request: listed, read, set, saved into a file and loaded from one."""

import asyncio
import json as json_text
import tomllib
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from hostlink.cli.arguments import Json, ParameterName, Token, Url
from hostlink.cli.connecting import connected
from hostlink.cli.names import unknown
from hostlink.cli.output import write, write_error
from hostlink.client import DEFAULT_URL, Host
from hostlink.errors import ConfigError

app = typer.Typer(
    no_args_is_help=True,
    help="The parameters that devices request: those of the configuration, and what was set since.",
)


@app.command("list")
def list_(*, url: Url = DEFAULT_URL, token: Token = None, json: Json = False) -> None:
    """List the names of the parameters, with their values."""
    found = _run(url, token, _values)
    if json:
        write(json_text.dumps(found))
    elif found:
        width = max(map(len, found))
        write(*(f"{name:<{width}}  {json_text.dumps(value)}" for name, value in found.items()))
    else:
        write_error("no parameters; `hostlink params set NAME VALUE` or [parameters] of the configuration sets one")


@app.command()
def get(name: ParameterName, *, url: Url = DEFAULT_URL, token: Token = None) -> None:
    """Print a parameter as JSON; a name with others below it is an object of them."""
    write(json_text.dumps(_run(url, token, lambda host: _get(host, name))))


@app.command("set")
def set_(
    name: ParameterName,
    value: Annotated[str, typer.Argument(help="JSON, as 1.5, true or [1, 2]; anything else is a text.")],
    *,
    url: Url = DEFAULT_URL,
    token: Token = None,
) -> None:
    """Set a parameter, for as long as the daemon runs. A device gets it when it requests it: mostly as it starts."""
    _run(url, token, lambda host: _set(host, {name: _value(value)}))
    write_error(f"{name} is {json_text.dumps(_value(value))}, until the daemon ends; [parameters] keeps it")


@app.command()
def delete(name: ParameterName, *, url: Url = DEFAULT_URL, token: Token = None) -> None:
    """Delete a parameter, and all below it."""
    _run(url, token, lambda host: host.call("/rosapi/delete_param", {"name": name}))


@app.command()
def dump(
    file: Annotated[Path | None, typer.Argument(help="Standard output without it.")] = None,
    *,
    url: Url = DEFAULT_URL,
    token: Token = None,
) -> None:
    """Save all parameters as JSON, which `hostlink params load` reads."""
    found = _run(url, token, _values)
    text = json_text.dumps(found, indent=2)
    if file is None:
        typer.echo(text)
        return
    try:
        file.write_text(text + "\n", encoding="utf-8")
    except OSError as error:
        raise ConfigError("FILE", f"{file} cannot be written: {error.strerror}; name another file") from error
    write_error(f"{len(found)} parameters in {file}")


@app.command()
def load(
    file: Annotated[
        Path, typer.Argument(help="JSON, or a hostlink.toml with a table of parameters.", show_default=False)
    ],
    *,
    url: Url = DEFAULT_URL,
    token: Token = None,
) -> None:
    """Set the parameters of a file; the others stay as they are."""
    values = _read(file)
    _run(url, token, lambda host: _set(host, values))
    write_error(f"{len(values)} parameters set")


def _run(url: str, token: str | None, work: Callable[[Host], Awaitable[Any]]) -> Any:
    async def run() -> Any:
        async with connected(url, token) as host:
            return await work(host)

    return asyncio.run(run())


async def _names(host: Host) -> list[str]:
    names: list[str] = (await host.call("/rosapi/get_param_names", {}))["names"]
    return names


async def _values(host: Host) -> dict[str, Any]:
    return {name: await _read_value(host, name) for name in await _names(host)}


async def _read_value(host: Host, name: str) -> Any:
    return json_text.loads((await host.call("/rosapi/get_param", {"name": name}))["value"])


async def _get(host: Host, name: str) -> Any:
    if not (await host.call("/rosapi/has_param", {"name": name}))["exists"]:
        raise unknown("parameter", name, await _names(host), command="params list")
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
    """The parameters of a file, by name.

    Raises:
        ConfigError: it cannot be read, or has none.
    """
    try:
        text = file.read_text(encoding="utf-8")
        values = tomllib.loads(text).get("parameters") if file.suffix == ".toml" else json_text.loads(text)
    except OSError as error:
        raise ConfigError("FILE", f"{file}: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise ConfigError("FILE", f"{file}: {error}") from error
    if not isinstance(values, dict):
        raise ConfigError("FILE", f"{file} has no parameters: a JSON object, or [parameters] of a hostlink.toml")
    return values
