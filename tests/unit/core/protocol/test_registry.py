"""Protocols by name: of hostlink and of installed packages."""

import importlib.metadata
from importlib.metadata import EntryPoint

import pytest

from hostlink.core.messages.catalog import Catalog
from hostlink.core.protocol.registry import GROUP, find_protocol
from hostlink.core.protocol.rosserial.protocol import ROSSERIAL
from hostlink.core.protocol.xrce.framing import DatagramFraming, LengthFraming, SerialFraming
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


def test_micro_ros_has_the_framing_of_its_transport_also_in_a_capture() -> None:
    ping = bytes.fromhex("80000000 02010800 000AFFFD 02000000")
    for framing in (DatagramFraming, LengthFraming, SerialFraming):
        data = framing().encode(ping)
        for protocol in (
            find_protocol("micro-ros", framing.transport),
            find_protocol(f"micro-ROS/{framing.transport}"),
        ):
            assert framing().feed(protocol.answer_ping(data))
            captured_as = protocol.session(Catalog()).captured_as
            assert captured_as == f"micro-ROS/{framing().captured_as}"
            assert find_protocol(captured_as).answer_ping(data)


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("morse", "no installed package has this protocol; known: broken, micro-ros, rosserial, text, wrong"),
        ("broken", "no_such_module:X cannot be imported: ModuleNotFoundError"),
        ("wrong", "tests.support.text_protocol:TextProtocol is not a DeviceProtocol"),
    ],
)
def test_protocol_that_cannot_be_used_is_named_with_its_reason(name: str, reason: str) -> None:
    with pytest.raises(ConfigError) as caught:
        find_protocol(name)
    assert reason in str(caught.value)
