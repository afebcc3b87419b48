"""The commands for boards: `arduino-library` writes their library, `board` reads and sets what a board keeps."""

import asyncio
import contextlib
import getpass
import os
import sys
from collections.abc import AsyncIterator, Collection, Iterable
from pathlib import Path
from typing import Annotated

import msgspec
import typer

from hostlink.board.library import TypeSelection, known_names, library, pack, select, sources, types_needed
from hostlink.board.settings import SETTINGS, BoardSettings, Setting, check_value
from hostlink.cli.arguments import Json
from hostlink.cli.files import check_new_file, replacing
from hostlink.cli.names import LISTED, near
from hostlink.cli.output import plain, show_progress, write, write_error
from hostlink.config import SerialConfig
from hostlink.errors import BadRequest, ConfigError, HostlinkError
from hostlink.messages.catalog import Catalog, check_not_empty
from hostlink.transport.serial import open_serial

# -- arduino library --------------------------------------------------------------------------------------------------


def arduino_library(
    *,
    output: Annotated[Path, typer.Option("-o", "--output", help="The ZIP.")] = Path("hostlink_rosserial.zip"),
    messages: Annotated[
        list[Path] | None,
        typer.Option("--messages", help="A folder of packages with .msg and .srv files. May be repeated."),
    ] = None,
    only: Annotated[
        list[str] | None,
        typer.Option(help="Packages or types, as geometry_msgs,std_msgs/String; what they contain comes along."),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Write over a file that is there.")] = False,
    json: Json = False,
) -> None:
    """Write rosserial for boards with a header for each message and service: for the Arduino IDE, PlatformIO, CMake."""
    check_new_file("--output", output, is_forced=force, example="hostlink_rosserial.zip")
    show_progress("reading the definitions")
    catalog = Catalog(messages or ())
    for folder in messages or ():
        check_not_empty(folder)
    texts = sources()
    selection = _select(catalog, only, types_needed(texts))
    show_progress(f"writing {output}")
    packed = pack(library(texts, selection))
    with replacing("--output", output) as beside:
        beside.write_bytes(packed)
    show_progress("")
    _report(output, selection, len(packed), as_json=json)


def _select(catalog: Catalog, only: list[str] | None, needed: Collection[str]) -> TypeSelection:
    """The types of --only, and those that the library's own sources need.

    Raises:
        ConfigError: a name is not known, or a definition is wrong.
    """
    if only is None:
        return select(catalog, None)
    names = [name.strip() for names in only for name in names.split(",") if name.strip()]
    known = known_names(catalog)
    if not names:
        raise ConfigError("--only", "names nothing; name packages or types, as geometry_msgs,std_msgs/String")
    for name in names:
        if name not in known:
            raise ConfigError("--only", f"no package or type named {name}; {_hint(name, known)}")
    return select(catalog, {*names, *needed})


def _hint(name: str, known: Iterable[str]) -> str:
    found = near(name, known)
    packages = sorted({each.partition("/")[0] for each in known})
    return f"near it: {', '.join(found)}" if found else f"there is: {', '.join(packages[:LISTED])} ..."


def _report(output: Path, selection: TypeSelection, size_bytes: int, *, as_json: bool) -> None:
    if as_json:
        facts = {
            "output": os.fsencode(output).decode(errors="replace"),
            "bytes": size_bytes,
            "messages": [message.name for message in selection.messages],
            "services": [service.name for service in selection.services],
        }
        write(msgspec.json.encode(facts).decode())
        return
    counts = f"{len(selection.messages)} messages and {len(selection.services)} services"
    write(
        f"{output}: {counts} of {len(selection.packages)} packages, {size_bytes / 1000:.0f} kB. Next, one of:",
        "  Arduino IDE: Sketch > Include Library > Add .ZIP Library...",
        f"  PlatformIO:  lib_deps = file://{output.resolve()}",  # as it is: PlatformIO decodes no %20
        "  CMake:       unpack it, then add_subdirectory(hostlink_rosserial)",
    )


# -- settings of a board ----------------------------------------------------------------------------------------------

USUAL_PORT = 11411  # that the library has where none is set
CLEAR = "-"  # the answer that empties a setting

Port = Annotated[str, typer.Argument(help="The serial port, as /dev/ttyUSB0.", show_default=False)]
Baud = Annotated[int, typer.Option(help="That of the sketch's Serial.begin().", min=300)]
Wait = Annotated[float, typer.Option(help="Seconds for the board to start and to answer.", min=0.1)]
SecretFile = Annotated[Path | None, typer.Option(help="A file with it: an argument could be read by others.")]

app = typer.Typer(help="Read and set what a board keeps: its host, name, WiFi and keys.", no_args_is_help=True)


@app.command()
def info(port: Port, *, baud: Baud = 115200, wait: Wait = 10.0, json: Json = False) -> None:
    """Show the settings of a board; of passwords and keys, whether they are set."""
    values = asyncio.run(_read(port, baud, wait))
    if json:
        write(msgspec.json.encode(values).decode())
    else:
        write(*(f"{name:<16} {value or '(not set)'}" for name, value in values.items()))


@app.command()
def setup(
    port: Port,
    *,
    baud: Baud = 115200,
    wait: Wait = 10.0,
    host: Annotated[str | None, typer.Option(help="Name or address of the computer that runs hostlink.")] = None,
    host_port: Annotated[str | None, typer.Option(help="Its port for devices; 11411 unless it was changed.")] = None,
    name: Annotated[str | None, typer.Option(help="The robot's name, before its topics.")] = None,
    wifi_name: Annotated[str | None, typer.Option(help="The WiFi's name.")] = None,
    wifi_password_file: SecretFile = None,
    key_file: SecretFile = None,
    update_password_file: SecretFile = None,
    json: Json = False,
) -> None:
    """Set what a board keeps. Without an option it asks for each; an empty answer keeps what is there, - empties it."""
    files = {"wifi_password": wifi_password_file, "key": key_file, "update_password": update_password_file}
    texts = {"host": host, "port": host_port, "name": name, "wifi_name": wifi_name}
    given = {name: text for name, text in texts.items() if text is not None}
    given |= {name: _secret(name, file) for name, file in files.items() if file is not None}
    for each, value in given.items():
        _check(SETTINGS[each], value)
    if not given and not sys.stdin.isatty():
        raise ConfigError("board setup", "nobody answers here; name the settings: --host, --name, --wifi-name ...")
    values = asyncio.run(_write(port, baud, wait, given or _ask(asyncio.run(_read(port, baud, wait)))))
    if json:
        write(msgspec.json.encode(values).decode())
    else:
        place = f"{values.get('host') or '?'}:{values.get('port') or USUAL_PORT}"
        write(f"{port}: stored. The board connects to {place} at its next start.")


async def _read(port: str, baud: int, wait_s: float) -> dict[str, str]:
    async with _opened(port, baud, wait_s) as board:
        return await board.read()


async def _write(port: str, baud: int, wait_s: float, wanted: dict[str, str]) -> dict[str, str]:
    """Write, and read again what the board has then; a sketch may restart in between."""
    async with _opened(port, baud, wait_s) as board:
        await board.write(wanted)
        after = await board.read()
    for name, value in wanted.items():
        kept = ("set" if value else "unset") if SETTINGS[name].is_secret else value
        if after.get(name) != kept:
            raise HostlinkError(f"{port}: {name} was stored and is not there; run the command again")
    return after


@contextlib.asynccontextmanager
async def _opened(port: str, baud: int, wait_s: float) -> AsyncIterator[BoardSettings]:
    show_progress(f"{port}: waiting for the board")
    try:
        transport = await open_serial(SerialConfig(path=port, baud=baud))
    except OSError as error:
        raise ConfigError("PORT", error.strerror or str(error)) from error
    try:
        yield BoardSettings(transport, patience_s=wait_s, baud=baud)
    except OSError as error:
        text = error.strerror or str(error)
        raise HostlinkError(text if text.startswith(port) else f"{port}: {text}") from error
    finally:
        await transport.aclose()
        show_progress("")


def _ask(before: dict[str, str]) -> dict[str, str]:
    """The settings for which there was an answer.

    Raises:
        HostlinkError: all is to stay as it is, or the answers end.
    """
    wanted = {}
    for setting in SETTINGS.values():
        answer = _answer(setting, before.get(setting.name, ""))
        if answer:
            wanted[setting.name] = "" if answer == CLEAR else answer
    if not wanted:
        raise HostlinkError("nothing was changed")
    return wanted


def _answer(setting: Setting, before: str) -> str:
    """The first one that the board would accept; empty: as it was."""
    text = plain(f"{setting.question}{f' [{before}]' if before else ''} ")
    while True:
        try:
            answer = getpass.getpass(text) if setting.is_secret else input(text).strip()
        except EOFError:
            raise HostlinkError("no answer; nothing is stored") from None
        try:
            check_value(setting, "" if answer == CLEAR else answer)
        except BadRequest as error:
            write_error(f"  {error}")
        else:
            return answer


def _secret(name: str, file: Path) -> str:
    option = f"--{name.replace('_', '-')}-file"
    try:
        secret = file.read_text(encoding="utf-8-sig").strip("\r\n")  # some editors begin a file with a mark
    except OSError as error:
        raise ConfigError(option, f"{file}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise ConfigError(option, f"{file}: not UTF-8") from error
    if not secret and file.is_file():
        raise ConfigError(option, f"{file} is empty; /dev/null empties the setting")
    return secret


def _check(setting: Setting, value: str) -> None:
    try:
        check_value(setting, value)
    except BadRequest as error:
        raise ConfigError("board setup", str(error)) from error


COMMANDS = {"arduino-library": arduino_library, "board": app}
