"""Protocols by name: of hostlink and of installed packages."""

import importlib.metadata
from importlib.metadata import EntryPoint

import pytest

from hostlink.core.protocol.registry import GROUP, find_protocol
from hostlink.core.protocol.rosserial.protocol import ROSSERIAL
from hostlink.errors import ConfigError
from tests.support.text_protocol import TEXT


@pytest.fixture(autouse=True)
def installed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Packages with a protocol, one that cannot be imported, and one whose object is not a protocol."""
    found = [
        EntryPoint("text", "tests.support.text_protocol:TEXT", GROUP),
        EntryPoint("broken", "no_such_module:X", GROUP),
        EntryPoint("wrong", "tests.support.text_protocol:TextProtocol", GROUP),
    ]
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda *, group: found if group == GROUP else [])


def test_protocol_is_found_by_its_name() -> None:
    assert find_protocol("rosserial") is ROSSERIAL
    assert find_protocol("text") is TEXT


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("morse", "no installed package has this protocol; known: broken, rosserial, text, wrong"),
        ("broken", "no_such_module:X cannot be imported: ModuleNotFoundError"),
        ("wrong", "tests.support.text_protocol:TextProtocol is not a DeviceProtocol"),
    ],
)
def test_protocol_that_cannot_be_used_is_named_with_its_reason(name: str, reason: str) -> None:
    with pytest.raises(ConfigError) as caught:
        find_protocol(name)
    assert reason in str(caught.value)
