"""Admission: which connections may be there at once. Nobody takes a robot's place by connecting often."""

import ipaddress
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from hostlink.config import TcpConfig, UdpConfig


@dataclass(frozen=True, slots=True)
class OpenConnection:
    """One connection that is served."""

    number: int
    address: str
    is_identified: bool  # as every device does within a second; such a one is never evicted


@dataclass(frozen=True, slots=True)
class Verdict:
    """Whether a connection may stay: why not, or who must go for it."""

    refusal: str | None = None
    evicts: int | None = None


class Admission:
    """
    | a connection comes                | what happens                                                             |
    |-----------------------------------|--------------------------------------------------------------------------|
    | from outside the allowed networks | refused: not_allowed                                                     |
    | over the bound of its address     | refused: too_many_of_address                                             |
    | over the bound of all             | of the unidentified, without topics, the oldest of the address that has  |
    |                                   | most of them is evicted, if its own has none, or at least two fewer;     |
    |                                   | else it is refused: too_many                                             |
    """

    def __init__(self, config: TcpConfig | UdpConfig) -> None:
        self._config = config
        self._allowed = [ipaddress.ip_network(network) for network in config.allow]
        self._keyless = [ipaddress.ip_network(network) for network in config.keyless]

    def judge(self, address: str, connections: Sequence[OpenConnection], *, room: int | None = None) -> Verdict:
        """`connections`: those that are there, oldest first; `room`: for how many, if not the bound of all."""
        most = self._config.max_connections if room is None else room
        if self._allowed and not is_within(address, self._allowed):
            return Verdict(refusal="not_allowed")
        if sum(connection.address == address for connection in connections) >= self._config.max_connections_per_address:
            return Verdict(refusal="too_many_of_address")
        if len(connections) < most:
            return Verdict()
        unidentified = [connection for connection in connections if not connection.is_identified]
        counts = Counter(connection.address for connection in unidentified)
        oldest = max(
            unidentified, key=lambda connection: counts[connection.address], default=None
        )  # the first of equals
        if oldest is None or 0 < counts[address] >= counts[oldest.address] - 1:  # else crowds take turns without end
            return Verdict(refusal="too_many")
        return Verdict(evicts=oldest.number)

    def needs_key(self, address: str) -> bool:
        """If there is a key: whether this one must prove it."""
        return not is_within(address, self._keyless)


def is_within(address: str, networks: Sequence[ipaddress.IPv4Network | ipaddress.IPv6Network]) -> bool:
    """Whether one of the networks has the address."""
    found = ipaddress.ip_address(address)
    return any(found in network for network in networks)
