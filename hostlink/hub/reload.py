"""What a running daemon changes of its settings without a restart: names and limits of robots, tokens and origins."""

import dataclasses
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

from hostlink.config import Config, RobotConfig

ROBOT = (
    "address",
    "kinematics",
    "wheel_separation_m",
    "max_linear_m_s",
    "max_angular_rad_s",
    "max_wheel_m_s",
    "max_linear_acceleration_m_s2",
    "max_angular_acceleration_rad_s2",
    "max_linear_deceleration_m_s2",
    "max_angular_deceleration_rad_s2",
)
API = ("tokens", "origins")


class Change(NamedTuple):
    """`config`: the settings from now on; `changed`: names of those that differ; `needs_restart`: not in `config`."""

    config: Config
    changed: tuple[str, ...]
    needs_restart: tuple[str, ...]


def change(old: Config, new: Config) -> Change:
    """What of `new` can be used at once by a daemon that runs with `old`."""
    names = {**old.robots, **new.robots}
    robots = {name: _robot(old, new, name) for name in names}
    kept = {name: robot for name, robot in robots.items() if name in new.robots or robot != RobotConfig()}
    api = dataclasses.replace(old.api, **{name: getattr(new.api, name) for name in API})
    config = dataclasses.replace(old, robots=kept, api=api)
    old, between, new = (_with_robots(each, names) for each in (old, config, new))
    return Change(config, tuple(_differences(old, between)), tuple(_differences(between, new)))


def _robot(old: Config, new: Config, name: str) -> RobotConfig:
    wanted = new.robots.get(name, RobotConfig())
    changed = {setting: getattr(wanted, setting) for setting in ROBOT}
    return dataclasses.replace(old.robots.get(name, RobotConfig()), **changed)


def _with_robots(config: Config, names: Iterable[str]) -> Config:
    """A robot that is not configured has the usual settings."""
    return dataclasses.replace(config, robots={name: config.robots.get(name, RobotConfig()) for name in names})


def _differences(old: object, new: object, where: str = "") -> Iterator[str]:
    """The names of the settings that differ, as they stand in the file."""
    if old == new:
        return
    parts, others = _parts(old), _parts(new)
    if parts is None or others is None:
        yield where
        return
    for name in {**parts, **others}:
        yield from _differences(parts.get(name), others.get(name), f"{where}.{name}".lstrip("."))


def _parts(part: Any) -> dict[str, Any] | None:
    """Of a table; None: it is a value."""
    if isinstance(part, dict):
        return part
    if part is None or not dataclasses.is_dataclass(part):
        return None
    return {field.name: getattr(part, field.name) for field in dataclasses.fields(part)}
