"""`hostlink serve --check-config`: what a configuration means, without serving it."""

from hostlink.cli.addresses import MAX_PORT
from hostlink.config import Config, SerialConfig
from hostlink.errors import ConfigError
from hostlink.messages.catalog import Catalog
from hostlink.transport.keyed import read_key


def describe(config: Config) -> str:
    """A line for each thing that would be served. A ConfigError for what only shows when it is used."""
    Catalog(config.message_folders)
    tcp, api = config.tcp, config.api
    who = ", ".join(tcp.allow) or "everybody"
    if tcp.key_file is not None:
        read_key(tcp.key_file)
        who += ", with the key" + (f" but {', '.join(tcp.keyless)}" if tcp.keyless else "")
    for where, port in (("tcp.port", tcp.port), ("api.port", api.port)):
        if not 0 <= port <= MAX_PORT:
            raise ConfigError(where, f"{port} is no port; they go from 0 (any free one) to {MAX_PORT}")
    lines = [f"devices on TCP {tcp.host}:{tcp.port}, from {who}, at most {tcp.max_connections}"]
    lines += [f"a device on {_describe_port(port)}" for port in config.serial]
    lines.append(f"programs on http://{api.host}:{api.port}")
    lines += [f"robot {name}, {robot.address or 'known by its topics'}" for name, robot in config.robots.items()]
    lines += [f"messages in {folder}" for folder in config.message_folders]
    lines.append(f"{len(config.parameters)} parameters")
    return "".join(f"{line}\n" for line in lines)


def _describe_port(port: SerialConfig) -> str:
    return f"{port.name} at {' or '.join(map(str, port.bauds))} baud"
