"""Outgoing: a WebSocket message to a client, and the queue in which it waits."""

import asyncio
from typing import NamedTuple

import msgspec

from hostlink.hub.queue import Queue


class Outgoing(NamedTuple):
    """JSON is text; CBOR is binary."""

    data: bytes
    is_binary: bool = False


ClientQueue = Queue[Outgoing]


def client_queue() -> ClientQueue:
    """An empty queue, for the loop that runs."""
    return Queue(lambda outgoing: len(outgoing.data), asyncio.get_running_loop().time)


def put_json(queue: ClientQueue, answer: object) -> None:
    """Queue an answer or an event."""
    queue.put_result(Outgoing(msgspec.json.encode(answer)))
