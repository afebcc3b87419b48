"""Settings: what cannot work is an error that names the key, what is probably a mistake is a warning."""

from pathlib import Path
from typing import Any

import pytest

from hostlink.components.mqtt.settings import MqttSettings
from hostlink.errors import ConfigError

FILE = Path("file")


def test_defaults_have_no_warning_and_do_not_drive() -> None:
    assert MqttSettings().check() == ()
    assert not MqttSettings().drive


@pytest.mark.parametrize(
    ("settings", "where", "problem"),
    [
        ({"host": ""}, "mqtt.host", "'' is not a host name"),
        ({"host": "mqtt://broker"}, "mqtt.host", "the port has a key of its own"),
        ({"port": 0}, "mqtt.port", "0 is not a port"),
        ({"port": 65536}, "mqtt.port", "65536 is not a port"),
        ({"username": "x" * 201}, "mqtt.username", "at most 200 characters"),
        ({"password_file": FILE}, "mqtt.password_file", "needs username"),
        ({"client_id": "a b"}, "mqtt.client_id", "at most 100 letters"),
        ({"prefix": ""}, "mqtt.prefix", "'' is not the beginning of a topic"),
        ({"prefix": "a/+"}, "mqtt.prefix", "without '+'"),
        ({"prefix": "$SYS"}, "mqtt.prefix", "is not the beginning"),
        ({"prefix": "/a"}, "mqtt.prefix", "is not the beginning"),
        ({"prefix": "a/"}, "mqtt.prefix", "is not the beginning"),
        ({"discovery_prefix": "a b"}, "mqtt.discovery_prefix", "is not the beginning"),
        ({"interval_s": 0.0}, "mqtt.interval_s", "0 is out of range; choose 0.1 to 3600"),
        ({"interval_s": float("nan")}, "mqtt.interval_s", "nan is out of range"),
        ({"keepalive_s": 1}, "mqtt.keepalive_s", "1 is out of range"),
        ({"max_age_s": 60.0}, "mqtt.max_age_s", "60 is out of range"),
        ({"forget_after_s": 0.0}, "mqtt.forget_after_s", "0 is out of range"),
        ({"ca": FILE}, "mqtt.ca", "set tls = true"),
        ({"tls": True, "certificate": FILE}, "mqtt.certificate", "belong together"),
    ],
)
def test_setting_that_cannot_work_is_an_error(settings: dict[str, Any], where: str, problem: str) -> None:
    with pytest.raises(ConfigError) as raised:
        MqttSettings(**settings).check()
    assert raised.value.where == where
    assert problem in raised.value.problem


@pytest.mark.parametrize(
    ("settings", "warning"),
    [
        ({"drive": True}, "drive = true without username: every program"),
        (
            {"host": "broker.lab", "username": "u", "password_file": FILE},
            "tls = false: everything, also the password,",
        ),
        ({"host": "broker.lab", "tls": True, "port": 8883}, "without username: every program"),
        ({"username": "u"}, "username without password_file"),
        ({"tls": True}, "port = 1883, the usual one without TLS"),
        ({"port": 8883}, "port = 8883, the usual one with TLS"),
    ],
)
def test_probable_mistake_is_a_warning(settings: dict[str, Any], warning: str) -> None:
    (found,) = MqttSettings(**settings).check()
    assert found.startswith(warning)


def test_broker_is_named_as_an_address() -> None:
    assert MqttSettings(host="::1").broker == "mqtt://[::1]:1883"
    assert MqttSettings(host="a", port=8883, tls=True).broker == "mqtts://a:8883"
