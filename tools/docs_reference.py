"""Write docs/reference: what the code knows of itself, as pages. docs/conf.py calls it at each build of the site.

python tools/docs_reference.py
"""

import ast
import asyncio
import inspect
import json
import re
import typing
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import aiohttp
import typer

import hostlink.client
from hostlink.cli.main import PANELS, build_app
from hostlink.cli.serve import running
from hostlink.components.gateway import settings as gateway
from hostlink.components.mqtt import settings as mqtt
from hostlink.components.recorder import settings as recorder
from hostlink.components.ros1 import settings as ros1
from hostlink.components.zenoh import settings as zenoh
from hostlink.core import config
from hostlink.core.runtime import logs

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "docs" / "reference"
OPENAPI = ROOT / "tests" / "integration" / "openapi.json"  # a test holds it to what the daemon answers
FAMILY = re.compile(r"^# HELP (\w+) (.*)\n# TYPE \w+ (\w+)$", re.MULTILINE)


def main() -> None:
    """Write every page."""
    FOLDER.mkdir(exist_ok=True)
    pages = {
        "cli": commands(),
        "rest": rest(),
        "client": client(),
        "configuration": settings(),
        "metrics": metrics(),
        "events": events(),
    }
    for name, lines in pages.items():
        (FOLDER / f"{name}.md").write_text("\n".join(lines) + "\n")


# -- the command line -------------------------------------------------------------------------------------------------


def commands() -> Iterator[str]:
    """Every command, as its parser has it."""
    yield f"# Every command\n\nAs `hostlink COMMAND --help` shows them. How they belong together: {page('commands')}.\n"
    for panel, names in PANELS.items():
        yield f"## {panel}\n"
        for name in names:
            yield from command(f"hostlink {name}", parser(name), 3)


def page(name: str) -> str:
    """Return a link to a page whose title is the text."""
    return f"[](../{name}.md)"


def parser(name: str) -> Any:
    """The parser of a command."""
    return typing.cast(Any, typer.main.get_command(build_app(name))).commands[name]


def command(title: str, found: Any, level: int) -> Iterator[str]:
    """One command, and the commands in it."""
    text = inspect.cleandoc(found.help or found.short_help or "")
    arguments = [each for each in found.params if each.param_type_name == "argument"]
    options = [each for each in found.params if each.param_type_name == "option"]
    names = " ".join(each.name.upper() if each.required else f"[{each.name.upper()}]" for each in arguments)
    usage = f"{title} {names}" + (" [OPTIONS]" if options else "")
    yield f"{'#' * level} {title}\n\n{cell(text)}\n\n```text\n{usage}\n```\n"
    if arguments or options:
        yield "| option | default | meaning |\n|---|---|---|"
        for each in arguments:
            yield f"| {each.name.upper()} | | {cell(each.help or '')} |"
        for each in options:
            yield f"| {option(each)} | {default(each)} | {cell(each.help or '')} |"
        yield ""
    for name, inner in getattr(found, "commands", {}).items():
        yield from command(f"{title} {name}", inner, level + 1)


def option(found: Any) -> str:
    """Return the names of an option, and its environment variable."""
    names = ", ".join(f"`{name}`" for name in (*found.opts, *found.secondary_opts))
    return f"{names}, `{found.envvar}` in the environment" if found.envvar else names


def default(found: Any) -> str:
    """Return the default of an option as text; empty if none is shown."""
    if isinstance(found.show_default, str):
        return f"`{found.show_default}`"
    is_shown = found.show_default and found.default not in (None, False, "", [], ())
    return f"`{found.default}`" if is_shown else ""


def cell(text: str) -> str:
    """Text from the code, where a table or MyST would read more into it."""
    return re.sub(r"([|<{\[*])", r"\\\1", text)


# -- REST -------------------------------------------------------------------------------------------------------------


def rest() -> Iterator[str]:
    """Every path of the OpenAPI document, and the types in it."""
    document = json.loads(OPENAPI.read_text())
    yield f"# REST\n\nFrom the daemon's own `/api/openapi.json`. Who may do what: {page('api')}.\n"
    for path, methods in document["paths"].items():
        for method, operation in methods.items():
            yield f"## {method.upper()} {cell(path)}\n\n{cell(operation['summary'])}.\n"
            yield from body(operation)
            yield "| status | answer |\n|---|---|"
            for status, response in operation["responses"].items():
                types = [type_name(each["schema"]) for each in response.get("content", {}).values()]
                yield f"| {status} | {cell(response['description'])}{''.join(f': {each}' for each in types)} |"
            yield ""
    yield "## Types\n"
    for name, schema in document["components"]["schemas"].items():
        yield f"({name.lower()})=\n### {name}\n\n{cell(schema.get('description', ''))}\n"
        yield from fields(schema)


def body(operation: dict[str, Any]) -> Iterator[str]:
    """Yield a line about the body of a request."""
    for content in operation.get("requestBody", {}).get("content", {}).values():
        yield f"Body: {type_name(content['schema'])}.\n"


def fields(schema: dict[str, Any]) -> Iterator[str]:
    """The fields of an object."""
    if schema.get("properties"):
        yield "| field | type | |\n|---|---|---|"
        for name, each in schema["properties"].items():
            yield f"| `{name}` | {type_name(each)} | {'' if name in schema.get('required', ()) else 'may be missing'} |"
        yield ""


def type_name(schema: dict[str, Any]) -> str:
    """A type of JSON in words, with a link to what has a name."""
    if "$ref" in schema:
        name = schema["$ref"].rpartition("/")[2]
        return f"[{name}](#{name.lower()})"
    if "anyOf" in schema:
        return " or ".join(type_name(each) for each in schema["anyOf"])
    if schema.get("type") == "array":
        return f"list of {type_name(schema.get('items') or {})}"
    if isinstance(schema.get("additionalProperties"), dict):
        return f"object of {type_name(schema['additionalProperties'])}"
    return str(schema.get("type", "anything"))


# -- the client -------------------------------------------------------------------------------------------------------


def client() -> Iterator[str]:
    """Every public name of hostlink.client, from its docstring."""
    yield f"# hostlink.client\n\nHow it is used: {page('client')}.\n"
    yield "```{eval-rst}\n.. py:module:: hostlink.client\n"
    names = sorted(hostlink.client.__all__, key=lambda name: (not name.startswith("connect"), name))
    for name in names:
        value = getattr(hostlink.client, name)
        kind = "class" if inspect.isclass(value) else "function" if callable(value) else "data"
        kind = "exception" if inspect.isclass(value) and issubclass(value, Exception) else kind
        yield f".. auto{kind}:: hostlink.client.{name}"
        yield "   :members:\n   :inherited-members: dict, tuple, Exception\n" if kind == "class" else ""
    yield "```"


# -- settings, metrics, the log ---------------------------------------------------------------------------------------


def settings() -> Iterator[str]:
    """Every setting, as the modules of the settings have it."""
    yield f"# Every setting\n\nOf `hostlink.toml`: {page('configuration')}. The types are Python's; `None`: left out.\n"
    yield from tables(config, sections)
    yield from tables(gateway, lambda _: [("`[api]`", "ApiConfig"), ("`[[api.tokens]]`", "TokenConfig")])
    yield from tables(recorder, lambda _: [("`[recording]`", "RecordingConfig"), ("`[black_box]`", "BlackBoxConfig")])
    yield from tables(ros1, lambda _: [("`[ros1]`", "Ros1Config")])
    yield from tables(mqtt, lambda _: [("`[mqtt]`", "MqttSettings")])
    yield from tables(zenoh, lambda _: [("`[zenoh]`", "ZenohSettings")])


def tables(module: ModuleType, chosen: Callable[[dict[str, ast.ClassDef]], Iterable[tuple[str, str]]]) -> Iterator[str]:
    """Yield the tables of the file that a module has, by name and class, as `chosen` returns them."""
    lines = inspect.getsource(module).splitlines()
    classes = {each.name: each for each in ast.parse("\n".join(lines)).body if isinstance(each, ast.ClassDef)}
    for section, name in chosen(classes):
        yield f"## {section}\n\n{cell(ast.get_docstring(classes[name]) or '')}\n"
        yield "| setting | type | default | |\n|---|---|---|---|"
        for each in assigned(classes[name]):
            value, comment = (
                ast.unparse(each.value) if each.value else "",
                lines[each.end_lineno - 1].partition("  # ")[2],
            )
            comment = re.sub(r"noqa: \w+( - )?", "", comment)
            value = re.sub(r"field\(default_factory=(\w+)\)", r"\1()", value)
            value = re.sub(r"field\(default=(.+), metadata=AT_ONCE\)", r"\1", value)
            annotation = ast.unparse(each.annotation)
            if not is_section(annotation, classes):
                yield f"| `{each.target.id}` | `{cell_code(annotation)}` | `{value}` | {cell(comment)} |"
        yield ""


def sections(classes: dict[str, ast.ClassDef]) -> Iterator[tuple[str, str]]:
    """The name of each table of the file, and its class."""
    yield "At the top", "Config"
    for each in assigned(classes["Config"]):
        found = is_section(ast.unparse(each.annotation), classes)
        if found:
            yield table_name(each.target.id, ast.unparse(each.annotation)), found
            for inner in assigned(classes[found]):
                if deeper := is_section(ast.unparse(inner.annotation), classes):
                    yield table_name(f"{each.target.id}.{inner.target.id}", ast.unparse(inner.annotation)), deeper


def table_name(path: str, annotation: str) -> str:
    """Return the name of a table as TOML writes it."""
    path = f"{path}.NAME" if annotation.startswith("dict") else path
    return f"`[[{path}]]`" if annotation.startswith("tuple") else f"`[{path}]`"


def is_section(annotation: str, classes: dict[str, ast.ClassDef]) -> str:
    """The class in an annotation; empty: there is none."""
    return next((name for name in re.findall(r"\w+", annotation) if name in classes), "")


def assigned(found: ast.ClassDef) -> Iterable[Any]:
    """The fields of a dataclass."""
    return (each for each in found.body if isinstance(each, ast.AnnAssign))


def cell_code(text: str) -> str:
    """Code in a table."""
    return text.replace("|", "\\|")


def metrics() -> Iterator[str]:
    """Every family of /metrics, as a daemon describes it."""
    yield "# Metrics\n\nOf `GET /metrics`, in the format of Prometheus.\n\n| name | kind | |\n|---|---|---|"
    for name, text, kind in FAMILY.findall(asyncio.run(scraped())):
        yield f"| `{name}` | {kind} | {cell(text)} |"


async def scraped() -> str:
    """The text of a daemon without devices."""
    logs.configure(level="error")
    local = config.Config(tcp=config.TcpConfig(host="127.0.0.1", port=0)).with_tables(
        api=gateway.ApiConfig(host="127.0.0.1", port=0), black_box=recorder.BlackBoxConfig(enabled=False)
    )
    async with (
        running(local) as (_, addresses),
        aiohttp.ClientSession() as session,
        session.get(f"{addresses.api}/metrics") as response,
    ):
        return await response.text()


def events() -> Iterator[str]:
    """Every event of the log, as the contract in logs.py lists them."""
    yield "# Events of the log\n\nOn a terminal text, else JSON, one line each, on standard error.\n"
    contract = (logs.__doc__ or "").partition("\n\n")[2]
    yield "| about | events |\n|---|---|"
    for line in re.sub(r",\n\s+", ", ", contract).splitlines():
        about, _, names = line.partition("  ")
        yield f"| {about} | {', '.join(f'`{name}`' for name in names.strip().split(', '))} |"


if __name__ == "__main__":
    main()
