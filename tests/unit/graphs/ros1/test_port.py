"""Admission of connections to this node's ports, without sockets."""

from hostlink.graphs.ros1.connections import Port
from hostlink.graphs.ros1.local_node import Ros1Counts


def test_port_admits_addresses_of_allowed_networks_alone() -> None:
    port = Port(Ros1Counts(), allow=("10.0.0.0/8", "fd00::/8"), max_connections=1)
    admitted = {
        address: port.admits(address) for address in ("10.1.2.3", "fd00::1", "127.0.0.1", "11.0.0.1", "fe80::1")
    }
    assert [address for address, is_admitted in admitted.items() if is_admitted] == ["10.1.2.3", "fd00::1"]


def test_port_without_networks_admits_every_address_while_it_has_room() -> None:
    assert Port(Ros1Counts(), allow=(), max_connections=1).admits("127.0.0.1")
    assert not Port(Ros1Counts(), allow=(), max_connections=0).admits("127.0.0.1")
