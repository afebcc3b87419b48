"""Errors of the broker's connection as one line for people, and the files of the login."""

import asyncio
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import aiomqtt
import pytest

from hostlink.components.mqtt.broker import Connection, as_os_errors, load_tls, read_password
from hostlink.components.mqtt.mqtt import Mqtt
from hostlink.components.mqtt.settings import MqttSettings
from hostlink.errors import ConfigError, LibraryMissing


def raised(error: Exception, cause: BaseException | None = None) -> str:
    with pytest.raises(ConnectionError) as found, as_os_errors("mqtt://a:1883"):
        raise error from cause
    return str(found.value)


def test_reason_codes_say_what_to_do() -> None:
    assert "refuses the login" in raised(aiomqtt.MqttCodeError(135))
    assert "set client_id" in raised(aiomqtt.MqttCodeError(133))
    assert "does not speak MQTT 5" in raised(aiomqtt.MqttCodeError(132))
    assert raised(aiomqtt.MqttCodeError(7)).startswith("mqtt://a:1883: the connection has ended")


def test_connection_that_fails_has_the_systems_text() -> None:
    text = raised(aiomqtt.MqttError("[Errno 111] Connection refused"))
    assert text == "mqtt://a:1883: Connection refused; is the broker running, and reachable from here?"
    assert "the broker has closed the connection" in raised(aiomqtt.MqttError("ended"), aiomqtt.MqttCodeError(128))


@pytest.mark.parametrize("work", ["publish", "subscribe"])
async def test_cancellation_that_arrives_with_the_answer_ends_the_task(work: str) -> None:
    async def drop(*_: object, **__: object) -> list[int]:
        """Return after a cancellation, as asyncio.wait_for of Python 3.11 does when its future is done."""
        try:
            await asyncio.sleep(60)
        except asyncio.CancelledError:
            return []
        raise AssertionError

    client: Any = SimpleNamespace(publish=drop, subscribe=drop)
    connection = Connection(client, "mqtt://a:1883")
    call = connection.publish("a", b"") if work == "publish" else connection.subscribe([], qos=0)
    task = asyncio.get_running_loop().create_task(call)  # type: ignore[arg-type]
    await asyncio.sleep(0)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task


def test_defect_of_a_callback_is_not_an_error_of_the_network() -> None:
    with pytest.raises(ZeroDivisionError), as_os_errors("mqtt://a:1883"):
        raise aiomqtt.MqttError("ended") from ZeroDivisionError()


@pytest.mark.parametrize("text", ["secret", "secret\n", "secret\r\nmore\n"])
def test_password_is_the_first_line(tmp_path: Path, text: str) -> None:
    file = tmp_path / "password"
    file.write_bytes(text.encode())
    assert read_password(file) == "secret"


@pytest.mark.parametrize("text", ["", "\n", "x" * 1025])
def test_file_without_a_password_is_an_error(tmp_path: Path, text: str) -> None:
    file = tmp_path / "password"
    file.write_text(text)
    with pytest.raises(ConfigError, match="its first line must be the password"):
        read_password(file)


def test_missing_files_are_errors_with_their_key(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"^mqtt.password_file: .*No such file"):
        read_password(tmp_path / "none")
    with pytest.raises(ConfigError, match=r"^mqtt.ca: .*cannot be loaded"):
        load_tls(MqttSettings(tls=True, ca=tmp_path / "none"))
    file = tmp_path / "text"
    file.write_text("not a certificate")
    with pytest.raises(ConfigError, match=r"^mqtt.certificate: .*cannot be loaded"):
        load_tls(MqttSettings(tls=True, certificate=file, key=file))
    assert load_tls(MqttSettings()) is None


def test_library_that_is_missing_is_named_with_its_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "aiomqtt", None)
    with pytest.raises(LibraryMissing, match="mqtt: needs aiomqtt, of the extra 'mqtt'"):
        Mqtt(MqttSettings()).check()


def test_description_has_the_broker_and_what_is_taken() -> None:
    settings = MqttSettings(username="robots", drive=True, unlock=False, discovery=False)
    assert (
        Mqtt(settings).describe() == "robots at mqtt://127.0.0.1:1883 as robots under hostlink, takes stop, lock, drive"
    )
