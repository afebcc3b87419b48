"""Arguments of `hostlink serve`. The port for devices is opened before the daemon is imported, which takes 0.4 s.

A device that connects in this time waits in the kernel until it is served, or is reset if the start fails.
"""

import dataclasses
import importlib
import shlex
import socket
import sys
from collections.abc import Callable, Mapping
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from hostlink.cli.addresses import parse_address, parse_serial
from hostlink.cli.files import MessageFolders
from hostlink.cli.output import write
from hostlink.cli.settings import load
from hostlink.cli.start import import_fast
from hostlink.components.gateway.settings import ApiConfig, is_origin
from hostlink.components.ros1.settings import Ros1Config
from hostlink.core.config import (
    Config,
    MicroRosConfig,
    MicroRosTcpConfig,
    MicroRosUdpConfig,
    TcpConfig,
    UdpConfig,
)
from hostlink.core.runtime.listening import listen as listen_at
from hostlink.errors import ConfigError, LibraryMissing

# -- command ----------------------------------------------------------------------------------------------------------

if TYPE_CHECKING:
    import asyncio

Loop = Literal["auto", "asyncio", "uvloop"]

ConfigFile = Annotated[
    Path | None, typer.Option(help="Configuration file, usually hostlink.toml: for settings without an option.")
]
ApiAddress = Annotated[
    str | None,
    typer.Option(help="Address and port on which programs connect: HOST:PORT.", show_default="127.0.0.1:9090"),
]
Level = Literal["debug", "info", "warning", "error"]
LogLevel = Annotated[
    Level,
    typer.Option(case_sensitive=False, help="What to log: debug to trace a fault."),
]

Origins = Annotated[
    list[str] | None,
    typer.Option(
        "--origin",
        help="Web page of another server that may use the API, for example https://app.foxglove.dev. May be repeated.",
    ),
]

EXAMPLES = {"config": "hostlink.toml", "systemd": "hostlink.service", "udev": "70-hostlink.rules"}


def command(
    *,
    config: ConfigFile = None,
    listen: Annotated[
        str | None,
        typer.Option(help="Address and port on which devices connect: HOST:PORT.", show_default="0.0.0.0:11411"),
    ] = None,
    udp: Annotated[str | None, typer.Option(help="Also serve devices over UDP, on this PORT or HOST:PORT.")] = None,
    serial: Annotated[
        list[str] | None, typer.Option(help="Serial port with a device: /dev/ttyACM0@57600. May be repeated.")
    ] = None,
    micro_ros: Annotated[
        list[str] | None,
        typer.Option(
            metavar="URL", help="Serve micro-ROS boards, at udp://0.0.0.0:8888 or tcp://0.0.0.0:8888. May be repeated."
        ),
    ] = None,
    api: ApiAddress = None,
    origin: Origins = None,
    messages: MessageFolders = None,
    zenoh: Annotated[
        bool, typer.Option("--zenoh", help="Show and drive the robots of other daemons in this network: docs/fleet.md.")
    ] = False,
    ros1: Annotated[
        str | None,
        typer.Option(metavar="URL", help="Show the robots in ROS 1, as a node of this master: http://localhost:11311."),
    ] = None,
    log_level: Annotated[
        Level | None,
        typer.Option(
            case_sensitive=False,
            help="What to log: debug to trace a fault.",
            show_default="info; on a terminal: warnings, and a line when a robot is ready",
        ),
    ] = None,
    loop: Annotated[
        Loop, typer.Option(help="Event loop: asyncio, uvloop, or auto, which is uvloop on Linux where it is installed.")
    ] = "auto",
    check_config: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Report what FILE would serve, or its errors, without starting the daemon."),
    ] = None,
    example: Annotated[
        str | None, typer.Option(metavar="NAME", help="Print an example file to start from: config, systemd or udev.")
    ] = None,
) -> None:
    """Run the daemon: devices on TCP port 11411, serial ports and UDP, programs on port 9090.

    Exit status: 0 stopped as asked, 1 failed, 2 wrong arguments or settings, or an address that is in use.
    """
    if example is not None:
        write(*read_example(example).splitlines())
        return
    file = check_config or config

    def read() -> Config:
        settings = merge(
            load(file) if file else Config(),
            listen=listen,
            udp=udp,
            serial=serial,
            micro_ros=micro_ros,
            api=api,
            messages=messages,
        )
        settings = allow_origins(settings, origin)
        if zenoh:
            settings = switched_on(settings, "zenoh")
        if ros1 is not None:
            node = with_master(settings.table("ros1", Ros1Config), "--ros1", ros1)
            settings = switched_on(settings.with_tables(ros1=node), "ros1")
        return settings

    settings = read()
    listening = [] if check_config else open_device_port(settings.tcp)
    new_loop = loop_factory(loop)
    sentences = Sentences() if log_level is None else None
    importlib.import_module("hostlink.core.runtime.logs").configure(level=log_level or "info", sentences=sentences)
    daemon = import_fast("hostlink.cli.serve")
    if check_config:
        daemon.show_check(settings)
    else:
        daemon.run(settings, listening, new_loop, read=read if config else None)


def open_device_port(config: TcpConfig) -> list[socket.socket]:
    """Listen for devices. Return no socket if the address cannot be used; the daemon reports the reason later."""
    try:
        return listen_at(config.host, config.port)
    except (OSError, OverflowError, UnicodeError):
        return []


def switched_on(config: Config, component: str) -> Config:
    """Return the settings with a component that an option wants: it precedes the [components] of the file."""
    return dataclasses.replace(config, components=config.components | {component: True})


def with_master(config: Ros1Config, where: str, url: str) -> Ros1Config:
    """Return the settings with this master.

    Raises:
        ConfigError: `url` is not the address of a master; the error begins with `where`.
    """
    if not url:
        raise ConfigError(where, "no address of a master is given; an example: http://localhost:11311")
    try:
        return dataclasses.replace(config, master=url)
    except ValueError as error:
        raise ConfigError(where, str(error)) from error


def loop_factory(name: Loop, platform: str = sys.platform) -> "Callable[[], asyncio.AbstractEventLoop] | None":
    """Return what makes the loop that `--loop` names; None for asyncio's own.

    UvLoop compares uvloop's clock with Python's. Both are CLOCK_MONOTONIC on Linux; other systems have several clocks.

    Raises:
        ConfigError: uvloop is requested on another system than Linux.
        LibraryMissing: uvloop is requested and not installed.
    """
    if name == "asyncio" or (name == "auto" and platform != "linux"):
        return None
    if platform != "linux":
        raise ConfigError("--loop", "uvloop is supported on Linux only, because of its clock; choose asyncio")
    try:
        factory: Callable[[], asyncio.AbstractEventLoop] = importlib.import_module("hostlink.cli.uvloop_loop").UvLoop
    except ImportError as error:
        if name == "auto":
            return None
        raise LibraryMissing("--loop", "uvloop", "uvloop") from error
    return factory


def allow_origins(config: Config, origins: list[str] | None) -> Config:
    """Return the configuration with the origins of `--origin` added to its own.

    Raises:
        ConfigError: a text is not an origin.
    """
    if not origins:
        return config
    for origin in origins:
        if not is_origin(origin):
            raise ConfigError(
                "--origin",
                f"{origin} is not an origin; write the scheme and the host, for example https://app.foxglove.dev",
            )
    api = config.table("api", ApiConfig)
    return config.with_tables(api=dataclasses.replace(api, origins=api.origins + tuple(origins)))


def merge(
    config: Config,
    *,
    listen: str | None = None,
    udp: str | None = None,
    serial: list[str] | None = None,
    micro_ros: list[str] | None = None,
    api: str | None = None,
    messages: list[Path] | None = None,
) -> Config:
    """Return the configuration with the values of the options, which take precedence.

    Raises:
        ConfigError: an option is wrong.
    """
    if listen is not None:
        host, port = parse_address("--listen", listen, config.tcp.host)
        config = dataclasses.replace(config, tcp=dataclasses.replace(config.tcp, host=host, port=port))
    if udp is not None:
        wanted = UdpConfig() if config.udp is None else config.udp
        host, port = parse_address("--udp", udp, wanted.host)
        config = dataclasses.replace(config, udp=dataclasses.replace(wanted, host=host, port=port))
    for url in micro_ros or ():
        config = dataclasses.replace(config, micro_ros=_with_port(config.micro_ros, url))
    if api is not None:
        wanted_api = config.table("api", ApiConfig)
        host, port = parse_address("--api", api, wanted_api.host)
        config = config.with_tables(api=dataclasses.replace(wanted_api, host=host, port=port))
        config = switched_on(config, "gateway")
    ports = config.serial + tuple(parse_serial(text) for text in serial or ())
    return dataclasses.replace(config, serial=ports, message_folders=config.message_folders + tuple(messages or ()))


def _with_port(config: MicroRosConfig, url: str) -> MicroRosConfig:
    """Return the settings with a port for micro-ROS boards.

    Raises:
        ConfigError: the text is not an address such as udp://0.0.0.0:8888.
    """
    scheme, _, address = url.partition("://")
    if scheme == "udp":
        udp = MicroRosUdpConfig() if config.udp is None else config.udp
        host, port = parse_address("--micro-ros", address, udp.host, example="udp://0.0.0.0:8888")
        return dataclasses.replace(config, udp=dataclasses.replace(udp, host=host, port=port))
    if scheme == "tcp":
        tcp = MicroRosTcpConfig() if config.tcp is None else config.tcp
        host, port = parse_address("--micro-ros", address, tcp.host, example="tcp://0.0.0.0:8888")
        return dataclasses.replace(config, tcp=dataclasses.replace(tcp, host=host, port=port))
    step = "a serial port is --serial /dev/ttyUSB0@115200; an example of this option: udp://0.0.0.0:8888"
    raise ConfigError("--micro-ros", f"{url!r} is not udp://HOST:PORT or tcp://HOST:PORT; {step}")


# -- sentences on a terminal ------------------------------------------------------------------------------------------


class Sentences:
    """Sentences for a person who has started the daemon in a terminal, instead of the log's lines of level info."""

    def __init__(self) -> None:
        self._option = ""  # for commands, if the API has another address than theirs

    def __call__(self, event: Mapping[str, object]) -> str | None:
        """Return the sentence of an event; None if it has none: then a warning is shown as a line of the log."""
        match event["event"]:
            case "daemon.started":
                url = event.get("api", "")  # empty: the gateway is off, or has failed
                self._option = "" if url in ("", f"http://127.0.0.1:{ApiConfig().port}") else f" --url {url}"
                page = f": {url}  (open it in a browser)" if url else ", without an address for programs"
                udp = f", over UDP to {event['udp']}" if "udp" in event else ""
                micro_ros = _listed(event, ", those of micro-ROS to ", "micro_ros")
                serial, missing = _listed(event, ", and are at ", "serial"), _listed(event, "; waiting for ", "missing")
                boards = f"boards connect to {event['tcp']}{udp}{micro_ros}{serial}{missing}"
                return f"hostlink runs{page}\n{boards}; Ctrl-C ends hostlink"
            case "serial.waiting":
                reason = str(event["reason"]).removeprefix(f"{event['port']}: ")
                return f"{event['port']} cannot be used: {reason}\n  next: {event['next_step']}"
            case "robot.appeared" if event.get("velocity"):
                robot = shlex.quote(str(event["robot"]))
                return f"{event['robot']} is ready; to drive it: hostlink teleop {robot}{self._option}"
            case "robot.appeared":
                return f"{event['robot']} is connected; it takes no velocity"
            case "daemon.stopping":
                return "stopping the robots ..."
            case "daemon.stopped":
                return "hostlink has ended"
        return None


def _listed(event: Mapping[str, object], start: str, key: str) -> str:
    names = event.get(key)
    return start + ", ".join(names) if isinstance(names, list) and names else ""


# -- examples ---------------------------------------------------------------------------------------------------------


def read_example(name: str) -> str:
    """Return the text of one of EXAMPLES.

    Raises:
        ConfigError: the name is unknown.
    """
    if name not in EXAMPLES:
        raise ConfigError("--example", f"unknown example {name!r}; choose one of {', '.join(EXAMPLES)}")
    return (files("hostlink") / "data" / EXAMPLES[name]).read_text()
