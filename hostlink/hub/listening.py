"""Listening: where a running daemon waits for devices; port 0 in the configuration is a real one here."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Listening:
    """Addresses as sockets have them; None: it does not listen there."""

    tcp: tuple[str, int] | None = None
    udp: tuple[str, int] | None = None
