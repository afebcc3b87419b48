"""Addresses on the command line: HOST:PORT and serial ports."""

from typing import Annotated

import typer

from hostlink.core.config import MAX_PORT, SerialConfig
from hostlink.errors import ConfigError

HostAddress = Annotated[
    str,
    typer.Option("--connect", help="Address of the host for devices, if it is not on this computer: HOST:PORT."),
]
DEFAULT_HOST = "127.0.0.1:11411"  # of HostAddress
LOWEST_BAUD = 300
MAX_DIGITS = 9  # of a port or a baud rate; Python refuses to read a number of thousands


def parse_address(option: str, text: str, default_host: str, *, example: str = "192.168.4.1:11411") -> tuple[str, int]:
    """Return the host and the port of `HOST:PORT`, `PORT`, `:PORT` or `[::1]:PORT`.

    Raises:
        ConfigError: `text` has another form; the error begins with `option`, and ends with `example`.
    """
    host, colon, port = text.rpartition(":")
    if text.startswith("/dev/") or text.upper().startswith("COM"):
        raise ConfigError(option, f"{text!r} is not HOST:PORT; a serial port is --serial /dev/ttyUSB0")
    problem = _problem(host, colon, port)
    if problem is not None:
        raise ConfigError(option, f"{text!r} is not HOST:PORT: {problem}; an example: {example}")
    return host.strip("[]") or default_host, int(port)


def _problem(host: str, colon: str, port: str) -> str | None:
    """Return what is wrong with the parts of HOST:PORT; None: nothing."""
    if not port or not (colon or _is_number(port)):
        return "the port is missing"
    if not _is_number(port):
        return f"the port {port!r} is not a number"
    if int(port) > MAX_PORT:
        return f"the highest port is {MAX_PORT}"
    if host.startswith("[") != host.endswith("]"):
        return "a bracket is missing"
    try:
        host.encode("idna")
    except UnicodeError:
        return "the host has an empty part, or one of more than 63 characters"
    return None


def parse_serial(text: str) -> SerialConfig:
    """Read `/dev/ttyACM0`, `/dev/ttyACM0@57600`, or with rates to try `/dev/ttyACM0@57600,115200`.

    Raises:
        ConfigError: `text` has another form.
    """
    path, at, rates = text.partition("@")
    bauds = rates.split(",") if at else []
    before, colon, rate = path.rpartition(":")
    if colon and _is_number(rate) and int(rate) >= LOWEST_BAUD:
        raise ConfigError("--serial", f"{text!r}: the baud rate follows an @: --serial {before}@{rate}")
    if not path or not all(_is_number(baud) and int(baud) for baud in bauds):
        raise ConfigError("--serial", f"{text!r} is not PORT or PORT@BAUD; an example: /dev/ttyACM0@57600")
    return SerialConfig(path=path, baud=tuple(map(int, bauds))) if at else SerialConfig(path=path)


def _is_number(text: str) -> bool:
    return text.isdecimal() and len(text) <= MAX_DIGITS
