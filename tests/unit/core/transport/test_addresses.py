"""Texts of addresses and ports: how they are written, and why one cannot be used."""

import errno
import os
import socket
import struct
from pathlib import Path

import pytest

from hostlink.core.config import SerialConfig
from hostlink.core.runtime.listening import spelled
from hostlink.core.transport.keyed import proof, read_key
from hostlink.core.transport.serial import UsbPort, choose_by_serial, find_port
from hostlink.core.transport.tcp import explain
from hostlink.core.transport.udp import local_address
from hostlink.errors import ConfigError

PORTS = [
    UsbPort("/dev/ttyUSB1", "B", "1-2"),
    UsbPort("/dev/ttyUSB0", "A", "1-1"),
    UsbPort("/dev/ttyACM0", "A", "1-1"),
]


def test_address_of_ip_version_6_has_brackets() -> None:
    assert spelled("192.168.4.2", 11411) == "192.168.4.2:11411"
    assert spelled("fe80::1", 11411) == "[fe80::1]:11411"


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (OverflowError("port"), "invalid port; choose 0"),
        (OSError(errno.EADDRINUSE, "x"), "is in use, probably by another rosserial host; stop it"),
        (OSError(errno.EACCES, "x"), f"cannot be listened on: {os.strerror(errno.EACCES)}"),
        (socket.gaierror(socket.EAI_NONAME, "unknown name"), "cannot be listened on: unknown name"),
        (OSError("only a text"), "cannot be listened on: only a text"),
        (UnicodeError("label too long"), "invalid host name; choose another with --listen HOST:PORT"),
    ],
)
def test_unusable_address_is_explained(error: OSError | OverflowError | UnicodeError, text: str) -> None:
    assert explain(error, "--listen").startswith(text)


def test_used_address_names_the_option() -> None:
    assert "--udp HOST:PORT" in explain(OSError(errno.EADDRINUSE, "x"), "--udp")


def test_datagram_without_ancillary_data_was_sent_to_the_bound_address() -> None:
    assert local_address([], ("192.168.4.1", 11411)) == ("192.168.4.1", 11411)
    assert local_address([(socket.SOL_SOCKET, 99, b"x")], ("192.168.4.1", 11411)) == ("192.168.4.1", 11411)


def test_local_address_of_ip_version_4_is_the_specific_destination() -> None:
    info = struct.pack("=I4s4s", 2, bytes((192, 168, 4, 1)), bytes((192, 168, 4, 255)))
    assert local_address([(socket.IPPROTO_IP, 8, info)], ("0.0.0.0", 11411)) == ("192.168.4.1", 11411)


@pytest.mark.parametrize(("host", "scope"), [("fe80::1", 0x01020304), ("2001:db8::1", 0)])
def test_local_address_of_ip_version_6_has_a_scope_within_the_link(host: str, scope: int) -> None:
    info = socket.inet_pton(socket.AF_INET6, host) + struct.pack("=I", 0x01020304)
    ancillary = [(socket.IPPROTO_IPV6, socket.IPV6_PKTINFO, info)]
    assert local_address(ancillary, ("::", 11411, 0, 0)) == (host, 11411, 0, scope)


def test_usb_device_with_two_ports_gives_the_first() -> None:
    assert choose_by_serial("A", PORTS) == "/dev/ttyACM0"
    assert choose_by_serial("B", PORTS) == "/dev/ttyUSB1"


def test_unknown_usb_device_lists_the_others() -> None:
    with pytest.raises(OSError, match=r"C: no USB device .*available: A \(/dev/ttyACM0\), A .*, B \(/dev/ttyUSB1\)"):
        choose_by_serial("C", PORTS)
    with pytest.raises(OSError, match="available: none"):
        choose_by_serial("C", [])


def test_pattern_must_match_one_port(tmp_path: Path) -> None:
    config = SerialConfig(path=str(tmp_path / "tty*"))
    with pytest.raises(OSError, match="no such port"):
        find_port(config)
    (tmp_path / "ttyB").touch()
    assert find_port(config) == str(tmp_path / "ttyB")
    (tmp_path / "ttyA").touch()
    with pytest.raises(OSError, match=r"matches 2 ports: .*ttyA, .*ttyB; name one of them"):
        find_port(config)


def test_key_is_read_without_white_space_and_has_a_least_length(tmp_path: Path) -> None:
    file = tmp_path / "key"
    file.write_bytes(b"\n" + b"k" * 16 + b" \n")
    assert read_key(file, "tcp.key_file") == b"k" * 16
    file.write_bytes(b"k" * 15 + b"\n")
    with pytest.raises(ConfigError, match="at least"):
        read_key(file, "tcp.key_file")
    with pytest.raises(ConfigError, match="No such file"):
        read_key(tmp_path / "missing", "tcp.key_file")


def test_proof_depends_on_key_side_and_both_randoms() -> None:
    made = {
        proof(b"key", b"host", b"1", b"2"),
        proof(b"other", b"host", b"1", b"2"),
        proof(b"key", b"device", b"1", b"2"),
        proof(b"key", b"host", b"3", b"2"),
        proof(b"key", b"host", b"1", b"3"),
    }
    assert len(made) == 5
