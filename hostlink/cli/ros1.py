"""`hostlink ros1`: the daemon with the names, arguments and parameters of rosserial_python."""

import dataclasses
import importlib
import re
import shlex
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from hostlink.cli.addresses import parse_serial
from hostlink.cli.files import MessageFolders
from hostlink.cli.output import write
from hostlink.cli.serve_command import (
    ApiAddress,
    ConfigFile,
    LogLevel,
    merge,
    open_device_port,
    switched_on,
    with_master,
)
from hostlink.cli.settings import load
from hostlink.cli.start import import_fast
from hostlink.components.ros1.names import NodeArguments, parse_arguments
from hostlink.components.ros1.settings import Ros1Config
from hostlink.core.config import MAX_PORT, Config, SerialConfig
from hostlink.errors import ConfigError

NODE = "serial_node"
MASTER = "http://localhost:11311"
PORT, BAUD, TCP_PORT = "/dev/ttyUSB0", 57600, 11411  # defaults of rosserial_python
TCP = "tcp"  # argument in the place of a serial port

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
# The node is a shell script, so it is installed as a program: catkin_install_python would treat it as Python.
CMAKE_LISTS = """cmake_minimum_required(VERSION 3.5)
project(hostlink)
find_package(catkin REQUIRED)
catkin_package()
install(PROGRAMS scripts/serial_node.py DESTINATION ${CATKIN_PACKAGE_BIN_DESTINATION})
"""

_EPILOG = (
    "Arguments of roslaunch are accepted: __name:=serial_node, __ns:=/lab, _port:=/dev/ttyACM0, _baud:=115200, "
    "cmd_vel:=/robot_0/cmd_vel. Missing ones are read from the node's parameters ~port, ~baud and ~tcp_port."
)


def command(
    words: Annotated[
        list[str] | None, typer.Argument(metavar="[PORT | tcp [TCP_PORT]] [NAME:=VALUE]...", help=_EPILOG)
    ] = None,
    *,
    tcp: Annotated[
        int | None, typer.Option(help="Serve devices on this TCP port, instead of a serial port.", min=0, max=MAX_PORT)
    ] = None,
    serial: Annotated[str | None, typer.Option(help="Serve the device on this serial port.")] = None,
    baud: Annotated[int | None, typer.Option(help="Baud rate of the serial port.", min=1)] = None,
    master: Annotated[
        str | None, typer.Option(help="Address of the ROS master.", envvar="ROS_MASTER_URI", show_default=MASTER)
    ] = None,
    host: Annotated[
        str | None,
        typer.Option(
            help="Name or address by which other nodes reach this one, if the host name does not resolve.",
            envvar=["ROS_HOSTNAME", "ROS_IP"],
        ),
    ] = None,
    namespace: Annotated[
        str | None, typer.Option(help="Namespace of the node.", envvar="ROS_NAMESPACE", show_default="/")
    ] = None,
    api: ApiAddress = None,
    messages: MessageFolders = None,
    config: ConfigFile = None,
    write_package: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER", help="Write a package for roslaunch into FOLDER, for example ~/catkin_ws/src, and end."
        ),
    ] = None,
    log_level: LogLevel = "info",
) -> None:
    """Run the daemon as a node of ROS 1, started as rosserial_python's serial_node.py is.

    The daemon ends when the node is shut down, for example by rosnode kill, or when a newer node takes its name.
    """
    if write_package is not None:
        write(*_write_package(write_package))
        return
    arguments = parse_arguments(words or ())
    settings = merge(load(config) if config else Config(), listen=None, serial=None, api=api, messages=messages)
    node = settings.table("ros1", Ros1Config)
    node = node_of(node, arguments, master=master, host=host, namespace=namespace)
    settings = switched_on(settings.with_tables(ros1=node), "ros1")
    options = _PortOptions(tcp, serial, baud)
    plain = with_devices(settings, {}, arguments.others, options)  # reports wrong arguments first
    listening = [] if is_port_at_master(arguments.others, options) else open_device_port(plain.tcp)
    if settings.message_folders:  # reports wrong definitions before the wait for the master
        importlib.import_module("hostlink.core.messages.catalog").Catalog(settings.message_folders)
    master_parameters = importlib.import_module("hostlink.cli.ros1_parameters")
    parameters, listening = master_parameters.read(node, arguments.parameters, plain.tcp, listening)
    settings = with_devices(settings, parameters, arguments.others, options)
    listening = listening or open_device_port(settings.tcp)
    importlib.import_module("hostlink.core.runtime.logs").configure(level=log_level)
    import_fast("hostlink.cli.serve").run(settings, listening, None, ends_with_graph=True)


def _write_package(folder: Path) -> list[str]:
    """Write a package with a node of rosserial_python's name; return lines that explain its use.

    Raises:
        ConfigError: the package cannot be written.
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
    """Return the version as catkin's three numbers, without suffixes of pip such as in 0.2.0.dev1."""
    found = re.match(r"\d+(?:\.\d+)*", text)
    numbers = found[0].split(".") if found else []
    return ".".join((*numbers, "0", "0", "0")[:3])


@dataclasses.dataclass(frozen=True, slots=True)
class _PortOptions:
    """Options --tcp, --serial and --baud."""

    tcp: int | None
    serial: str | None
    baud: int | None


def node_of(
    config: Ros1Config,
    arguments: NodeArguments,
    *,
    master: str | None = None,
    host: str | None = None,
    namespace: str | None = None,
) -> Ros1Config:
    """Return the settings of the node: of its arguments, else the options and the environment, else the configuration.

    Raises:
        ConfigError: a name or the address of the master is invalid.
    """
    specials = arguments.specials
    names = arguments.names(NODE if config.name == Ros1Config().name else config.name, namespace or config.namespace)
    address = specials.get("master", (config.master or MASTER) if master is None else master)
    return dataclasses.replace(
        with_master(config, "the master", address),
        name=names.node.rpartition("/")[2],
        namespace=names.namespace,
        host=specials.get("hostname") or specials.get("ip") or host or config.host,
        remappings={**config.remappings, **arguments.remappings},
    )


def is_port_at_master(others: tuple[str, ...], options: _PortOptions) -> bool:
    """Whether parameters of the master determine the TCP port for devices."""
    return options.tcp is None and options.serial is None and others in ((), (TCP,))


def with_devices(
    config: Config, parameters: Mapping[str, Any], others: tuple[str, ...], options: _PortOptions
) -> Config:
    """Return the settings with the port for devices: of the options, else arguments, else parameters, else the default.

    Raises:
        ConfigError: too many arguments were given, or one of them is not a port.
    """
    if len(others) > 2 or (len(others) == 2 and others[0] != TCP):  # noqa: PLR2004 - the two of rosserial_python
        raise ConfigError(" ".join(others), "too many arguments; give a serial port, or tcp and a TCP port")
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
        raise ConfigError(what, f"{value!r} is not a number from 0 to {largest}")
    return number
