"""The commands for boards: `arduino-library` writes their library, `board` reads and writes a board's settings."""

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
from hostlink.cli.output import clear_progress, quantity, show_progress, write, write_error
from hostlink.core.config import SerialConfig
from hostlink.core.messages.catalog import Catalog, check_not_empty
from hostlink.core.runtime.plain_text import plain
from hostlink.core.runtime.text_file import read_text
from hostlink.core.transport.serial import open_serial
from hostlink.errors import BadRequest, ConfigError, HostlinkError, size

USUAL_PORT = 11411  # of the library, if the board has no setting
CLEAR = "-"  # the answer that clears a setting

# -- arduino library --------------------------------------------------------------------------------------------------


def arduino_library(
    *,
    output: Annotated[Path, typer.Option("-o", "--output", help="ZIP file to write.")] = Path("hostlink_rosserial.zip"),
    messages: Annotated[
        list[Path] | None,
        typer.Option(
            "--messages", help="Folder of packages with .msg and .srv files of your own types. May be repeated."
        ),
    ] = None,
    only: Annotated[
        list[str] | None,
        typer.Option(
            help="Packages or types to include, for a smaller library: geometry_msgs,std_msgs/String. "
            "Types that they contain are added."
        ),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace an existing file.")] = False,
    json: Json = False,
) -> None:
    """Write the rosserial library with headers of all messages and services, for Arduino IDE, PlatformIO and CMake."""
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
    _report(output, selection, len(packed), as_json=json)


def _select(catalog: Catalog, only: list[str] | None, needed: Collection[str]) -> TypeSelection:
    """Return the types of --only, and those that the library's own sources need.

    Raises:
        ConfigError: a name is unknown, or a definition is wrong.
    """
    if only is None:
        return select(catalog, None)
    names = [name.strip() for names in only for name in names.split(",") if name.strip()]
    known = known_names(catalog)
    if not names:
        raise ConfigError(
            "--only", "no name is given; name packages or types, for example geometry_msgs,std_msgs/String"
        )
    for name in names:
        if name not in known:
            raise ConfigError("--only", f"no package or type named {name}; {_hint(name, known)}")
    return select(catalog, {*names, *needed})


def _hint(name: str, known: Iterable[str]) -> str:
    found = near(name, known)
    packages = sorted({each.partition("/")[0] for each in known})
    return f"similar names: {', '.join(found)}" if found else f"packages are: {', '.join(packages[:LISTED])} ..."


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
    counts = f"{quantity(len(selection.messages), 'message')} and {quantity(len(selection.services), 'service')}"
    packages = quantity(len(selection.packages), "package")
    write(
        f"{output}: {counts} of {packages}, {size(size_bytes)}. Next, one of:",
        "  Arduino IDE: Sketch > Include Library > Add .ZIP Library...",
        f"  PlatformIO:  lib_deps = file://{output.resolve()}",  # unquoted: PlatformIO does not decode %20
        "  CMake:       unpack it, then add_subdirectory(hostlink_rosserial)",
    )


# -- settings of a board ----------------------------------------------------------------------------------------------


Port = Annotated[str, typer.Argument(help="Serial port of the board, for example /dev/ttyUSB0.")]
Baud = Annotated[int, typer.Option(help="Baud rate, as in the sketch's Serial.begin().", min=300)]
Wait = Annotated[
    float, typer.Option(help="Seconds to wait for an answer: longer for a board that starts slowly.", min=0.1)
]
SecretFile = Annotated[
    Path | None, typer.Option(help="File with the secret, because other users can read an argument.")
]

app = typer.Typer(
    help="Read and set the settings that a board stores: host, name, WiFi and keys.", no_args_is_help=True
)


@app.command()
def info(port: Port, *, baud: Baud = 115200, wait: Wait = 10.0, json: Json = False) -> None:
    """Show the settings of a board. Of a password or key it shows only whether it is set."""
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
    host_port: Annotated[str | None, typer.Option(help="Port of the daemon for devices, if it is not 11411.")] = None,
    name: Annotated[str | None, typer.Option(help="Name of the robot, which begins its topics.")] = None,
    wifi_name: Annotated[str | None, typer.Option(help="Name of the WiFi.")] = None,
    wifi_password_file: SecretFile = None,
    key_file: SecretFile = None,
    update_password_file: SecretFile = None,
    json: Json = False,
) -> None:
    """Set the settings of a board. Without options it asks for each; an empty answer keeps the value, - clears it."""
    files = {"wifi_password": wifi_password_file, "key": key_file, "update_password": update_password_file}
    texts = {"host": host, "port": host_port, "name": name, "wifi_name": wifi_name}
    given = {name: text for name, text in texts.items() if text is not None}
    given |= {name: _secret(name, file) for name, file in files.items() if file is not None}
    for each, value in given.items():
        _check(SETTINGS[each], value)
    if not given and not sys.stdin.isatty():
        raise ConfigError(
            "board setup",
            "standard input is not a terminal; give the settings as options: --host, --name, --wifi-name ...",
        )
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
    """Write the settings, and read them back; a sketch may restart in between.

    Raises:
        HostlinkError: the board has not stored them.
    """
    async with _opened(port, baud, wait_s) as board:
        await board.write(wanted)
        after = await board.read()
    for name, value in wanted.items():
        kept = ("set" if value else "unset") if SETTINGS[name].is_secret else value
        if after.get(name) != kept:
            raise HostlinkError(f"{port}: the board did not store {name}; run the command again")
    return after


@contextlib.asynccontextmanager
async def _opened(port: str, baud: int, wait_s: float) -> AsyncIterator[BoardSettings]:
    show_progress(f"{port}: waiting for the board")
    try:
        transport = await open_serial(SerialConfig(path=port, baud=baud))
    except OSError as error:
        raise ConfigError("PORT", error.strerror or f"{port} cannot be opened: {error}") from error
    try:
        yield BoardSettings(transport, patience_s=wait_s, baud=baud)
    except OSError as error:
        text = error.strerror or str(error)
        raise HostlinkError(text if text.startswith(port) else f"{port}: {text}") from error
    finally:
        await transport.aclose()
        clear_progress()


def _ask(before: dict[str, str]) -> dict[str, str]:
    """Ask for each setting; return the answered ones.

    Raises:
        HostlinkError: no setting was changed, or standard input ends.
    """
    wanted = {}
    for setting in SETTINGS.values():
        answer = _answer(setting, before.get(setting.name, ""))
        if answer:
            wanted[setting.name] = "" if answer == CLEAR else answer
    if not wanted:
        raise HostlinkError("every answer was empty, so no setting was changed")
    return wanted


def _answer(setting: Setting, before: str) -> str:
    """Ask until the board would accept the answer; an empty one keeps the setting."""
    text = plain(f"{setting.question}{f' [{before}]' if before else ''} ")
    while True:
        try:
            answer = getpass.getpass(text) if setting.is_secret else input(text).strip()
        except EOFError:
            write_error("")  # the question has no end of a line
            raise HostlinkError(
                "standard input ended, and no setting was stored; give the settings as options"
            ) from None
        try:
            check_value(setting, "" if answer == CLEAR else answer)
        except BadRequest as error:
            write_error(f"  {error}")
        else:
            return answer


def _secret(name: str, file: Path) -> str:
    option = f"--{name.replace('_', '-')}-file"
    try:
        secret = read_text(file).strip("\r\n")
    except OSError as error:
        raise ConfigError(option, f"{file} cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise ConfigError(option, f"{file} is not UTF-8; save it as UTF-8") from error
    if not secret and file.is_file():
        raise ConfigError(option, f"{file} is empty; name /dev/null to clear the setting")
    return secret


def _check(setting: Setting, value: str) -> None:
    try:
        check_value(setting, value)
    except BadRequest as error:
        raise ConfigError("board setup", str(error)) from error
