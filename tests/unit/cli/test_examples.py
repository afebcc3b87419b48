"""The example files: settings complete and true, rules that udev can read; systemd: tests/system/test_service.py."""

import dataclasses
import fnmatch
import re
import tomllib
import typing
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from hostlink.cli.serve_command import EXAMPLES, read_example
from hostlink.cli.settings import load
from hostlink.components.gateway.settings import ApiConfig, TokenConfig
from hostlink.components.mqtt.settings import MqttSettings
from hostlink.components.recorder.settings import BlackBoxConfig, RecordingConfig
from hostlink.components.ros1.settings import Ros1Config
from hostlink.components.zenoh.settings import ZenohSettings
from hostlink.core.config import Config, RobotConfig, SerialConfig
from hostlink.errors import ConfigError

SETTING_NOT_MADE = re.compile(r"^#(?=\S)", re.MULTILINE)
UDEV_KEY = r"(ACTION|SUBSYSTEM|GROUP|MODE|SYMLINK|GOTO|LABEL|ATTRS\{\w+\}|ENV\{\w+\})"
UDEV_PART = re.compile(rf'^{UDEV_KEY}(==|!=|=|\+=)"[^"]+"$')


@pytest.fixture
def sample(tmp_path: Path) -> Config:
    """The example configuration as it is."""
    path = tmp_path / "hostlink.toml"
    path.write_text(read_example("config"))
    return load(path)


COMMAND_TABLES = {"wheels", "joy", "words", "throttle", "vector"}


@pytest.fixture
def whole(tmp_path: Path) -> dict[str, Any]:
    """With every setting made, as it was written; it must be valid too."""
    text = SETTING_NOT_MADE.sub("", read_example("config"))
    path = tmp_path / "whole.toml"
    for kept in ("command_topic", *COMMAND_TABLES):  # one of them commands a robot
        path.write_text(_with_one_of_each(text, kept))
        load(path)
    return tomllib.loads(text)


def _with_one_of_each(text: str, kept: str) -> str:
    """Remove settings of which a robot or a port has only one: `kept` is the way to command the robot."""
    for alternative in (
        "usb_serial",
        r'devices = \["192',
        "command_device",
        'topic = "wheel_ticks"',
        'topic = "odom"',
        *({"command_topic"} - {kept}),
    ):
        text = re.sub(rf"^(?={alternative})", "#", text, flags=re.MULTILINE)
    for table in COMMAND_TABLES - {kept}:
        text = re.sub(rf"^\[robots\.robot_0\.{table}\]\n?(?:.+\n)*", "", text, flags=re.MULTILINE)
    return text


def test_the_example_is_the_defaults(sample: Config) -> None:
    tables = dict(sample.component_settings)
    assert tables == {name: type(table)() for name, table in tables.items()}
    assert dataclasses.replace(sample, component_settings={}) == Config()


def parts(kind: type[Any], shown: dict[str, Any]) -> Iterator[tuple[type[Any], dict[str, Any]]]:
    """The dataclass, and those that it holds, alone or several, each with what the example shows of it."""
    yield kind, shown
    for name, hint in typing.get_type_hints(kind).items():
        for inner in (hint, *typing.get_args(hint)):
            if dataclasses.is_dataclass(inner):
                value = shown[name]
                first = value[0] if isinstance(value, list) else value
                yield from parts(inner, next(iter(first.values())) if typing.get_origin(hint) is dict else first)


OF_COMPONENTS = ("component_settings",)  # their tables are theirs
OF_OTHERS: dict[str, type[Any]] = {  # tables of components
    "api": ApiConfig, "black_box": BlackBoxConfig, "mqtt": MqttSettings, "recording": RecordingConfig,
    "ros1": Ros1Config, "zenoh": ZenohSettings,
}  # fmt: skip


def test_the_example_names_every_setting_with_its_default(whole: dict[str, Any]) -> None:
    tables = {name: whole.pop(name) for name in OF_OTHERS}
    observed = list(parts(Config, whole))
    for name, kind in OF_OTHERS.items():
        observed += parts(kind, tables[name])
    assert {kind for kind, _ in observed} >= {Config, SerialConfig, RobotConfig, ApiConfig, TokenConfig}
    for kind, shown in observed:
        fields = [each for each in dataclasses.fields(kind) if each.name not in OF_COMPONENTS]
        assert set(shown) == {field.name for field in fields}, kind
        defaults = {field.name: field.default for field in fields if isinstance(field.default, int | float | str)}
        assert {name: shown[name] for name in defaults} == defaults, kind


def test_every_part_of_the_udev_rules_is_one() -> None:
    text = read_example("udev")
    for line in text.splitlines():
        if line and not line.startswith("#"):
            assert all(UDEV_PART.match(part) for part in line.split(", ")), line
    assert set(re.findall(r'GOTO="(\w+)"', text)) == set(re.findall(r'LABEL="(\w+)"', text))


COMMON_PORTS = [  # adapters and boards: vendor and product
    ("2341", "0043"), ("2a03", "0043"), ("303a", "1001"), ("0483", "5740"), ("0483", "374b"), ("2e8a", "000a"),
    ("1a86", "7523"), ("1a86", "55d4"), ("10c4", "ea60"), ("10c4", "ea70"), ("0403", "6001"), ("0403", "6010"),
    ("0403", "6014"), ("0403", "6015"), ("067b", "2303"), ("067b", "23a3"), ("16c0", "0483"), ("239a", "800b"),
    ("1b4f", "9206"), ("2886", "802d"), ("0d28", "0204"), ("04d8", "000a"), ("03eb", "2145"), ("1ffb", "00a0"),
]  # fmt: skip


@pytest.mark.parametrize("ids", COMMON_PORTS, ids=":".join)
def test_udev_rules_know_a_common_port(ids: tuple[str, str]) -> None:
    rule = re.compile(r'ATTRS\{idVendor\}=="(\w+)", (?:ATTRS\{idProduct\}=="([^"]+)", )?GOTO="hostlink_port"')
    rules = rule.findall(read_example("udev"))
    vendor, product = ids
    assert any(
        vendor == of_vendor and any(fnmatch.fnmatch(product, each or "*") for each in products.split("|"))
        for of_vendor, products in rules
    )


@pytest.mark.parametrize(
    "name", ["ttyACM", "ttyUSB", "ttyS", "ttyAMA", "ttyTHS", "ttymxc", "ttyMSM", "ttyGS", "rfcomm"]
)
def test_unit_permits_the_ports_of_common_computers(name: str) -> None:
    assert f"DeviceAllow=char-{name} rw\n" in read_example("systemd")


def test_an_example_that_there_is_not() -> None:
    assert list(EXAMPLES) == ["config", "systemd", "udev"]
    with pytest.raises(ConfigError, match="--example: unknown example 'cron'; choose one of config, systemd, udev"):
        read_example("cron")
