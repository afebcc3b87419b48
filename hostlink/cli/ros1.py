"""`hostlink ros1`: the daemon in place of rosserial_python: its names, arguments and parameters."""

import dataclasses
import importlib
import re
import shlex
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from hostlink.cli.addresses import MAX_PORT, parse_serial
from hostlink.cli.output import write
from hostlink.cli.serve_command import merge, open_device_port, with_master
from hostlink.config import Config, Ros1Config, SerialConfig, load
from hostlink.errors import ConfigError
from hostlink.graphs.ros1.names import NodeArguments, parse_arguments

NODE = "serial_node"
PORT, BAUD, TCP_PORT = "/dev/ttyUSB0", 57600, 11411  # rosserial_python's own
TCP = "tcp"  # instead of a serial port

PACKAGE, NODE_FILE = "hostlink", "serial_node.py"
PACKAGE_XML = """<?xml version="1.0"?>
<package format="2">
  <name>hostlink</name>
  <version>{version}</version>
  <description>hostlink in the place of rosserial_python</description>
  <maintainer email="hostlink@example.com">hostlink</maintainer>
  <license>MIT</license>
  <buildtool_depend>catkin</buildtool_depend>
</package>
"""
# The node is a shell script: catkin_install_python would have Python read it.
CMAKE_LISTS = """cmake_minimum_required(VERSION 3.5)
project(hostlink)
find_package(catkin REQUIRED)
catkin_package()
install(PROGRAMS scripts/serial_node.py DESTINATION ${CATKIN_PACKAGE_BIN_DESTINATION})
"""

_EPILOG = (
    "Arguments of roslaunch are understood: __name:=serial_node, __ns:=/lab, _port:=/dev/ttyACM0, _baud:=115200, "
    "cmd_vel:=/robot_0/cmd_vel. What is given nowhere is a parameter of the node: ~port, ~baud, ~tcp_port."
)


def command(
    words: Annotated[
        list[str] | None, typer.Argument(metavar="[PORT | tcp [TCP_PORT]] [NAME:=VALUE]...", help=_EPILOG)
    ] = None,
    *,
    tcp: Annotated[
        int | None, typer.Option(help="Serve devices on this TCP port.", min=0, max=MAX_PORT, show_default=False)
    ] = None,
    serial: Annotated[
        str | None, typer.Option(help="Serve the device on this serial port.", show_default=False)
    ] = None,
    baud: Annotated[int | None, typer.Option(help="Of the serial port.", min=1, show_default=False)] = None,
    master: Annotated[str, typer.Option(help="The master.", envvar="ROS_MASTER_URI")] = "http://localhost:11311",
    host: Annotated[
        str | None,
        typer.Option(
            help="By which name other nodes reach this one.", envvar=["ROS_HOSTNAME", "ROS_IP"], show_default=False
        ),
    ] = None,
    namespace: Annotated[str, typer.Option(help="Of the node.", envvar="ROS_NAMESPACE")] = "/",
    api: Annotated[
        str | None, typer.Option(help="Where programs connect: HOST:PORT.", show_default="127.0.0.1:9090")
    ] = None,
    messages: Annotated[
        list[Path] | None, typer.Option(help="A folder of .msg and .srv files. May be repeated.")
    ] = None,
    config: Annotated[Path | None, typer.Option(help="hostlink.toml", show_default=False)] = None,
    write_package: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="Write a package for roslaunch into FOLDER, as ~/catkin_ws/src, and end."),
    ] = None,
    log_level: Annotated[str, typer.Option(help="debug, info, warning or error.")] = "info",
) -> None:
    """Run the daemon as a node of ROS 1, started as rosserial_python's serial_node.py is.

    It ends when the node is shut down, as by rosnode kill, or when a newer node has its name.
    """
    if write_package is not None:
        write(*_write_package(write_package))
        return
    if log_level.upper() not in ("DEBUG", "INFO", "WARNING", "ERROR"):
        raise ConfigError("--log-level", f"{log_level} is none of debug, info, warning, error")
    arguments = parse_arguments(words or ())
    settings = merge(load(config) if config else Config(), listen=None, serial=None, api=api, messages=messages)
    node = _node(settings.ros1, arguments, master=master, host=host, namespace=namespace)
    settings = dataclasses.replace(settings, ros1=node)
    options = _Options(tcp, serial, baud)
    plain = with_devices(settings, {}, arguments.others, options)  # wrong arguments are reported before all else
    listening = [] if is_port_at_master(arguments.others, options) else open_device_port(plain.tcp)
    if settings.message_folders:  # what is wrong in them is reported before the master is waited for
        importlib.import_module("hostlink.messages.catalog").Catalog(settings.message_folders)
    master_parameters = importlib.import_module("hostlink.cli.ros1_parameters")
    parameters, listening = master_parameters.read(node, arguments.parameters, plain.tcp, listening)
    settings = with_devices(settings, parameters, arguments.others, options)
    listening = listening or open_device_port(settings.tcp)
    importlib.import_module("hostlink.logs").configure(level=log_level)
    importlib.import_module("hostlink.cli.serve").run(settings, listening, None, ends_with_graph=True)


def _write_package(folder: Path) -> list[str]:
    """A package with a node of the name that rosserial_python's has; returns what to do with it.

    Raises:
        ConfigError: it cannot be written.
    """
    package = folder / PACKAGE
    node = package / "scripts" / NODE_FILE
    try:
        node.parent.mkdir(parents=True, exist_ok=True)
        version = importlib.import_module("importlib.metadata").version("hostlink")
        (package / "package.xml").write_text(PACKAGE_XML.format(version=_catkin_version(version)))
        (package / "CMakeLists.txt").write_text(CMAKE_LISTS)
        node.write_text(f'#!/bin/sh\nexec {shlex.quote(str(Path(sys.argv[0]).absolute()))} ros1 "$@"\n')
        node.chmod(0o755)
    except OSError as error:
        raise ConfigError(str(folder), error.strerror or str(error)) from error
    return [
        f"wrote {package}. In a launch file:",
        f'  <node pkg="{PACKAGE}" type="{NODE_FILE}" name="serial_node"/>',
        f"if roslaunch does not find it: export ROS_PACKAGE_PATH=$ROS_PACKAGE_PATH:{folder.absolute()}",
    ]


def _catkin_version(text: str) -> str:
    """Three numbers, as catkin has them: without what pip knows beside, as in 0.2.0.dev1."""
    found = re.match(r"\d+(?:\.\d+)*", text)
    numbers = found[0].split(".") if found else []
    return ".".join((*numbers, "0", "0", "0")[:3])


@dataclasses.dataclass(frozen=True, slots=True)
class _Options:
    """Of the command line, with two dashes."""

    tcp: int | None
    serial: str | None
    baud: int | None


def _node(config: Ros1Config, arguments: NodeArguments, *, master: str, host: str | None, namespace: str) -> Ros1Config:
    """Arguments of the node precede options, and those the environment."""
    specials = arguments.specials
    names = arguments.names(NODE, namespace or "/")
    return dataclasses.replace(
        with_master(config, "the master", specials.get("master", master)),
        name=names.node.rpartition("/")[2],
        namespace=names.namespace,
        host=specials.get("hostname") or specials.get("ip") or host,
        remappings={**config.remappings, **arguments.remappings},
    )


def is_port_at_master(others: tuple[str, ...], options: _Options) -> bool:
    """Whether parameters of the master decide on which TCP port devices are served."""
    return options.tcp is None and options.serial is None and others in ((), (TCP,))


def with_devices(config: Config, parameters: Mapping[str, Any], others: tuple[str, ...], options: _Options) -> Config:
    """The settings with the port that was meant: options first, then arguments, then parameters, then the default.

    Raises:
        ConfigError: there are more arguments than a port and a TCP port, or one is no port.
    """
    if len(others) > 2 or (len(others) == 2 and others[0] != TCP):  # noqa: PLR2004 - the two of rosserial_python
        raise ConfigError(" ".join(others), "the arguments are a serial port, or tcp and a TCP port")
    port = others[0] if others else str(parameters.get("port", PORT))
    tcp_port = others[1] if len(others) > 1 else parameters.get("tcp_port", TCP_PORT)
    if options.tcp is not None:
        port, tcp_port = TCP, options.tcp
    if options.serial is not None:
        port = options.serial
    baud = options.baud or parameters.get("baud", BAUD)
    listening = dataclasses.replace(config.tcp, port=_number("the TCP port", tcp_port, MAX_PORT))
    serial: tuple[SerialConfig, ...] = config.serial
    if port == TCP or options.tcp is not None:
        config = dataclasses.replace(config, tcp=listening)
    if port != TCP:
        serial += (parse_serial(f"{port}@{_number('the baud rate', baud)}"),)
    if options.tcp is None and port != TCP:
        config = dataclasses.replace(config, tcp=dataclasses.replace(config.tcp, host="127.0.0.1", port=0))
    return dataclasses.replace(config, serial=serial)


def _number(what: str, value: object, largest: int = 10**8) -> int:
    try:
        number = int(str(value))
    except ValueError:
        number = -1
    if not 0 <= number <= largest:
        raise ConfigError(what, f"{value!r} is none")
    return number
