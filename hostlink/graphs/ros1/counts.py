"""Counts: what this node has carried, refused and dropped; `/metrics` shows each."""

from dataclasses import dataclass


@dataclass(slots=True)
class Counts:
    """Since the start. What a limit or a policy has cost has a name here."""

    messages_from_ros: int = 0
    messages_to_ros: int = 0
    dropped_to_slow_subscribers: int = 0
    superseded_velocities: int = 0  # a newer one was in the same piece of the stream
    refused_messages: int = 0  # by a robot, a gate or a lock
    malformed_messages: int = 0  # bytes that are not of the type that was agreed upon
    too_large_messages: int = 0
    refused_connections: int = 0  # too many, or from where nobody may connect
    refused_headers: int = 0  # no header, or one for what is not here
    refused_calls: int = 0  # of the slave API: no XML-RPC, or unknown
    failed_services: int = 0
    re_registrations: int = 0  # the master had forgotten this node
    crowded_out: int = 0  # publishers and services of the graph over a bound


def of(counts: Counts) -> dict[str, int]:
    """By name."""
    return {name: getattr(counts, name) for name in Counts.__slots__}
