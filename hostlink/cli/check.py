"""Checks of a configuration for `serve` and `--check-config`: errors that prevent the start, and warnings.

`serve` runs the checks before it starts, so a configuration that passes is served. A problem that may be gone later,
such as a port that another program uses, is a warning.
"""

import errno
import math
import operator
import re
from collections import Counter
from collections.abc import Iterator

from hostlink.cli.descriptors import fewer, ports_of
from hostlink.cli.output import quantity
from hostlink.cli.usual import chosen
from hostlink.core.config import Config, SerialConfig, TcpConfig, UdpConfig, check_port, check_ports, is_place
from hostlink.core.hub.hub import Hub
from hostlink.core.hub.parameters import to_parameter
from hostlink.core.hub.robot_settings import check_command, drive_in, encoders_lack, frames_of, lacking
from hostlink.core.hub.topic_graph import resolve
from hostlink.core.listeners.accepting import TcpAcceptor, UdpAcceptor, protocols_of
from hostlink.core.messages.catalog import Catalog
from hostlink.core.protocol.rosserial.control import encode_parameter
from hostlink.core.robot.kinematics import SETTINGS, WHEELS_NEED, AckermannDrive
from hostlink.core.runtime.acceptor import bind, why
from hostlink.core.runtime.listening import close_all, spelled
from hostlink.core.transport.serial import find_port
from hostlink.core.transport.udp import serve_udp
from hostlink.errors import ConfigError, HostlinkError

# -- checks -----------------------------------------------------------------------------------------------------------

_ROS_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*(?:/[A-Za-z][A-Za-z0-9_]*)*")  # http://wiki.ros.org/Names
_SENSIBLE = {  # setting -> the smallest value that works, and the reason
    "link.max_topics": (2, "a robot has a velocity and an odometry"),
    "link.uart_bytes_s": (120, "no UART is slower than 1200 baud"),
    "link.silence_timeout_s": (2.5, "a device requests the time every 2.5 s"),
    "link.idle_timeout_s": (2.5, "a device requests the time every 2.5 s"),
    "link.write_timeout_s": (0.1, "a radio link takes longer"),
}


async def check(config: Config, *, descriptors: int, is_listening: bool = False) -> list[str]:
    """Check everything that `serve` needs; return warnings. `is_listening`: the port for devices is open already.

    Raises:
        ConfigError: the configuration cannot be served.
    """
    warnings, listeners = check_settings(config)
    hub = Hub(config, Catalog(config.message_folders))  # message folders, limits of robots
    for serial in config.serial:
        protocols_of(hub, serial)
    for table, (host, port) in listeners.items():
        warnings += await _try_port(table, host, port)
    for name, part in ports_of(config).items():
        if isinstance(part, UdpConfig):
            UdpAcceptor(hub, part)
            warnings += await _try_datagrams(name, part)
        else:
            TcpAcceptor(hub, part)  # the key
            warnings += [] if is_listening and part is config.tcp else await _try_port(name, part.host, part.port)
    if few := fewer(config, descriptors):
        numbers = ", ".join(f"{name}.max_connections {number}" for name, number in few.items())
        warnings.append(f"{descriptors} descriptors (ulimit -n) are enough only for {numbers}")
    return [*warnings, *_suspicious(config)]


def check_settings(config: Config) -> tuple[list[str], dict[str, tuple[str, int]]]:
    """Check the values, without a port. Return warnings of components, and host and port of their listeners by table.

    Raises:
        ConfigError: the configuration cannot be served.
    """
    _check_values(config)
    warnings: list[str] = []
    listeners: dict[str, tuple[str, int]] = {}
    for each in chosen(config):  # the warnings of those with tables of other names begin with a key
        found, its_listeners = each.checked()
        warnings += [f"{'' if each.kind.tables else f'{each.name}: '}{warning}" for warning in found]
        listeners |= its_listeners
    for table, (_, port) in listeners.items():
        check_port(f"{table}.port", port)
    check_ports(config, listeners)
    return warnings, listeners


def describe(config: Config) -> list[str]:
    """Lines that describe what would be served."""
    tcp, udp, components = config.tcp, config.udp, chosen(config)
    lines = [f"devices on TCP {spelled(tcp.host, tcp.port)}, from {_describe_who(tcp)}, at most {tcp.max_connections}"]
    if udp is not None:
        believed = f"; {', '.join((*udp.trusted, *udp.devices))} trusted" if udp.trusted or udp.devices else ""
        where = spelled(udp.host, udp.port)
        lines.append(f"devices on UDP {where}, from {_describe_who(udp)}, at most {udp.max_connections}{believed}")
    for name, part in ports_of(config).items():
        if name.startswith("micro_ros."):
            where, most = spelled(part.host, part.port), part.max_connections
            lines.append(f"micro-ROS boards on {name[-3:].upper()} {where}, from {_describe_who(part)}, at most {most}")
    lines += [f"a device on {_describe_port(port)}" for port in config.serial]
    lines += [each.line() for each in components if each.kind.begins_first]
    for name, robot in config.robots.items():
        lines.append(f"robot {name}, {robot.address or ' and '.join(robot.devices or ()) or 'known by its topics'}")
    lines += [each.line() for each in components if not each.kind.begins_first]
    lines += [f"messages in {folder}" for folder in config.message_folders]
    return [*lines, quantity(len(config.parameters), "parameter")]


def _describe_who(config: TcpConfig | UdpConfig) -> str:
    who = ", ".join(config.allow) or "any address"
    if config.key_file is None:
        return who
    return f"{who}, with the key" + (f" but {', '.join(config.keyless)}" if config.keyless else "")


def _describe_port(port: SerialConfig) -> str:
    return f"{port.name} at {' or '.join(map(str, port.bauds))} baud"


# -- wrong values -----------------------------------------------------------------------------------------------------


def _check_values(config: Config) -> None:
    for name, part in ports_of(config).items():
        check_port(f"{name}.port", part.port)
    for where, number in _positive(config):
        if number is not None and not 0 < number < math.inf:
            raise ConfigError(where, f"{number:g} is not allowed; choose a finite number above 0")
    for robot, settings in config.robots.items():
        try:
            drive_in(settings)
            check_command(settings)
        except ConfigError as error:
            raise ConfigError(f"robots.{robot}", error.problem) from error


_POSITIVE = ("uart_bytes_s", "wheel_radius_m", "cmd_vel_max_age_s")


def _positive(config: Config) -> Iterator[tuple[str, float | None]]:
    """Yield the settings that must be above zero."""
    for name in ("silence_timeout_s", "idle_timeout_s", "write_timeout_s", "uart_bytes_s"):
        yield f"link.{name}", getattr(config.link, name)
    for port in config.serial:
        yield f"serial {port.name}.baud_try_s", port.baud_try_s
        yield from ((f"serial {port.name}.baud", baud) for baud in port.bauds)
    for robot, settings in config.robots.items():
        for name in (*_POSITIVE, *(each for each in SETTINGS if each != "wheel_angles_deg")):
            yield f"robots.{robot}.{name}", getattr(settings, name)


async def _try_port(part: str, host: str, port: int) -> list[str]:
    """Listen on the address for a moment; return a warning if the port is in use.

    Raises:
        ConfigError: the address cannot be listened on.
    """
    try:
        close_all(await bind(host, port))
    except (OSError, OverflowError, UnicodeError) as error:
        if isinstance(error, OSError) and error.errno == errno.EADDRINUSE:
            return [f"{part}.port {port} is in use at this moment"]
        raise ConfigError(f"{part}.host {host}, port {port}", f"cannot be listened on: {why(error)}") from error
    return []


async def _try_datagrams(part: str, config: UdpConfig) -> list[str]:
    try:
        async with serve_udp(config, Counter(), lambda _port, _datagram: False):
            return []
    except ConfigError as error:
        if isinstance(error.__cause__, OSError) and error.__cause__.errno == errno.EADDRINUSE:
            return [f"{part}.port {config.port} is in use at this moment"]
        raise


# -- warnings --------------------------------------------------------------------------------------------------------


def _suspicious(config: Config) -> Iterator[str]:
    yield from _too_small(config)
    yield from _suspicious_robots(config)
    yield from _shared_topics(config)
    yield from _shared_frames(config)
    for name, part in {"tcp": config.tcp, "udp": config.udp}.items():
        if part is not None and part.keyless and part.key_file is None:
            yield f"{name}.keyless has no effect without {name}.key_file, because no device needs a key"
    for port in config.serial:
        try:
            find_port(port)
        except OSError as error:
            if error.errno != errno.ENOENT:  # the device may be plugged in later
                yield f"serial {error.strerror}"
    for name, value in config.parameters.items():
        try:
            encode_parameter(to_parameter(name, value))
        except (HostlinkError, ValueError, OverflowError) as error:
            yield f"parameters.{name} cannot be sent: {error}"


def _too_small(config: Config) -> Iterator[str]:
    """Warn of values that are allowed, but too small to work with."""
    values = [(setting, operator.attrgetter(setting)(config), *known) for setting, known in _SENSIBLE.items()]
    uart = _SENSIBLE["link.uart_bytes_s"]
    values += [(f"robots.{name}.uart_bytes_s", robot.uart_bytes_s, *uart) for name, robot in config.robots.items()]
    for setting, value, least, reason in values:
        if value is not None and value < least:
            yield f"{setting} {value:g} is very small: {reason}"


def _shared_topics(config: Config) -> Iterator[str]:
    """Warn of two robots with one topic: a command drives both, and their odometry is mixed."""
    owners: dict[str, str] = {}
    for name, robot in config.robots.items():
        for setting in ("odom_topic", "cmd_vel_topic", "cmd_vel_stamped_topic"):
            chosen = getattr(robot, setting)
            topic = resolve(f"{name}/{setting.removesuffix('_topic')}" if chosen is None else chosen)
            where = f"robots.{name}.{setting}"
            if chosen != "" and owners.setdefault(topic, where) != where:
                yield f"{where} and {owners[topic]} are the same topic, {topic}; give each its own name"


def _shared_frames(config: Config) -> Iterator[str]:
    """Warn of two robots with one base frame: in /tf they are one robot that jumps between two places."""
    owners: dict[str, str] = {}
    for name, robot in config.robots.items():
        frame, where = frames_of(name, robot).base, f"robots.{name}.base_frame"
        if owners.setdefault(frame, where) != where:
            yield f"{where} and {owners[frame]} are the same frame, {frame}; give each its own name"


_WHEEL_SETTINGS = {"": ("wheel_separation_m",), "planar": ("wheel_separation_m",), **WHEELS_NEED}
_USUAL_CAR = AckermannDrive()


def _suspicious_robots(config: Config) -> Iterator[str]:
    ports = {port.name for port in config.serial}
    by_address: dict[str, str] = {}
    for name, robot in config.robots.items():
        where = f"robots.{name}"
        if not _ROS_NAME.fullmatch(name):
            yield f"{where}: ROS programs cannot use this name; use letters, digits, _ and /, with a letter first"
        if robot.max_wheel_m_s is not None:
            needed = [each for each in _WHEEL_SETTINGS.get(robot.kinematics, ()) if getattr(robot, each) is None]
            if needed:
                yield f"{where}.max_wheel_m_s needs {' and '.join(needed)}, without which turns are not limited"
        drive = drive_in(robot)
        needed = [] if robot.encoders is None or drive.wheels else lacking(drive, robot)
        needed += encoders_lack(robot)
        if needed:
            *first, last = needed
            names = f"{', '.join(first)} and {last}" if first else last
            yield f"{where}.encoders needs {names}, without which they tell only whether the robot moves"
        if robot.kinematics == "ackermann" and None in (robot.wheelbase_m, robot.max_steering_rad):
            yield (
                f"{where}: measure the car for wheelbase_m and max_steering_rad, with which it steers; without them it "
                f"is one of {_USUAL_CAR.wheelbase_m:g} m and {_USUAL_CAR.max_steering_rad:g} rad"
            )
        if robot.address is None:
            continue
        if robot.address in by_address:
            yield (
                f"{where} and robots.{by_address[robot.address]} have the same address, {robot.address}; "
                "the devices can be told apart only if the firmware of each has its own name"
            )
        by_address.setdefault(robot.address, name)
        if robot.address not in ports and not is_place(robot.address):
            kinds = "an IP address, with or without a port, nor the name of a [[serial]] port"
            yield f"{where}.address {robot.address} is neither {kinds}"
