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


ClientQueue = Queue[Outgoing]


def client_queue(budget: ByteBudget | None = None) -> ClientQueue:
    """An empty queue, for the loop that runs."""
    share = None if budget is None else budget["queues"]
    clock = asyncio.get_running_loop().time
    return Queue(lambda outgoing: len(outgoing.data) + len(outgoing.before), clock, share)


def put_json(queue: ClientQueue, answer: object) -> None:
    """Queue an answer or an event."""
    queue.put_result(Outgoing(msgspec.json.encode(answer)))
