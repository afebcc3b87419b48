"""Outgoing: a WebSocket message to a client, and the queue in which it waits."""

import asyncio
from typing import NamedTuple

import msgspec

from hostlink.hub.byte_budget import ByteBudget
from hostlink.hub.queue import Queue


class Outgoing(NamedTuple):
    """JSON is text; CBOR is binary. `before`, if not empty, is a binary message that leaves before it."""

    data: bytes
    is_binary: bool = False
    before: bytes = b""


class ClientQueue(Queue[Outgoing]):
    """The queue of one client."""

    def __init__(self, budget: ByteBudget | None = None) -> None:
        share = None if budget is None else budget["queues"]
        super().__init__(_size_bytes, asyncio.get_running_loop().time, share)
        self.is_flush_due = True  # what subscriptions hold back has changed

    def wake(self) -> None:
        self.is_flush_due = True
        super().wake()


def _size_bytes(outgoing: Outgoing) -> int:
    return len(outgoing.data) + len(outgoing.before)


def put_json(queue: ClientQueue, answer: object) -> None:
    """Queue an answer or an event."""
    queue.put_result(Outgoing(msgspec.json.encode(answer)))
