"""Text files of users: a byte order mark does not belong to the text, wherever a file is read."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hostlink.cli.board import _secret
from hostlink.cli.params import _read
from hostlink.cli.settings_file import write_settings
from hostlink.cli.sim import read_world
from hostlink.components.gateway.access import Access
from hostlink.components.gateway.settings import ApiConfig, TokenConfig
from hostlink.core.config import load
from hostlink.core.messages.catalog import read_definition
from hostlink.core.runtime.text_file import read_text
from hostlink.core.transport.keyed import read_key
from hostlink.errors import ConfigError

MARK = b"\xef\xbb\xbf"
SECRET = "0123456789abcdef0123456789abcdef"


def token_of(file: Path) -> Any:
    config = ApiConfig(tokens=(TokenConfig(name="phone", role="drive", token_file=file),))
    return Access(config).grant(SECRET).who


READERS: list[tuple[str, str, Callable[[Path], Any]]] = [
    ("hostlink.toml", "[tcp]\nport = 7\n", load),
    ("token", f"{SECRET}\r\n", token_of),
    ("key", f"{SECRET}\n", lambda file: read_key(file, "tcp.key_file")),
    ("key", f"{SECRET}\n", lambda file: _secret("key", file)),
    ("parameters.json", '{"gain": 1.5}', _read),
    ("parameters.toml", "[parameters]\ngain = 1.5\n", _read),
    ("Odd.msg", "int32 data\n", read_definition),
]


@pytest.mark.parametrize(
    ("name", "text", "read"), READERS, ids=[f"{name} {n}" for n, (name, _, _) in enumerate(READERS)]
)
def test_file_with_a_byte_order_mark_is_read_as_without(
    tmp_path: Path, name: str, text: str, read: Callable[[Path], Any]
) -> None:
    file = tmp_path / name
    file.write_bytes(text.encode())
    wanted = read(file)
    file.write_bytes(MARK + text.encode())
    assert wanted is not None
    assert read(file) == wanted


def test_world_with_a_byte_order_mark_is_read(tmp_path: Path) -> None:
    file = tmp_path / "world"
    for mark in (b"", MARK):
        file.write_bytes(mark + b"odd\n")
        with pytest.raises(ConfigError) as refused:
            read_world(file)
        assert "\ufeff" not in str(refused.value)


def test_settings_with_a_byte_order_mark_can_be_changed(tmp_path: Path) -> None:
    file = tmp_path / "hostlink.toml"
    file.write_bytes(MARK + b"[tcp]\r\nport = 7\r\n")
    write_settings(file, {"tcp": {"port": 8}})
    assert file.read_bytes() == b"[tcp]\r\nport = 8\r\n"
    assert load(file).tcp.port == 8


def test_file_of_utf_16_is_refused_with_the_next_step(tmp_path: Path) -> None:
    file = tmp_path / "hostlink.toml"
    file.write_text("[tcp]\nport = 7\n", encoding="utf-16")
    with pytest.raises(UnicodeDecodeError, match="it is UTF-16; save it as UTF-8"):
        read_text(file)
    with pytest.raises(ConfigError, match="it is UTF-16; save it as UTF-8"):
        load(file)
