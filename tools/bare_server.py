"""The least that asyncio can do for a crowd of devices: read the bytes, write due frames, nothing else.

    python tools/bare_server.py COUNT SECONDS RATE_HZ

Prints its port, waits for so many connections, and then prints a JSON object: what a read or a write cost in SECONDS,
the share of a core, and the largest memory.
`make bench` compares the daemon with it, so that its bounds mean the same on every machine.
"""

import asyncio
import json
import resource
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from hostlink.core.protocol.rosserial.frame import TOPICS_REQUEST
from hostlink.core.transport.base import READ_BYTES

COMMAND = bytes(56)  # as long as a velocity's frame
SETTLE_S = 2.0
POLL_S = 0.05
_INTO = bytearray(READ_BYTES)


class Bare(asyncio.BufferedProtocol):
    """One connection: counts its reads."""

    reads = 0

    def __init__(self, made: list[asyncio.Transport]) -> None:
        self._made = made

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)  # noqa: S101 - of a TCP connection
        transport.write(TOPICS_REQUEST)  # else the crowd is silent
        self._made.append(transport)

    def get_buffer(self, sizehint: int) -> bytearray:  # noqa: ARG002 - asyncio's signature
        return _INTO

    def buffer_updated(self, nbytes: int) -> None:  # noqa: ARG002 - asyncio's signature
        Bare.reads += 1


async def write_evenly(made: list[asyncio.Transport], rate_hz: float, until_s: float) -> int:
    """Write to one after another, each at this rate; returns how often."""
    loop, count = asyncio.get_running_loop(), 0
    began_s = loop.time()
    while loop.time() < until_s:
        made[count % len(made)].write(COMMAND)
        count += 1
        await asyncio.sleep(max(0.0, began_s + count / (rate_hz * len(made)) - loop.time()))
    return count


async def serve(count: int, seconds: float, rate_hz: float) -> dict[str, float]:
    """The core's share and the microseconds of a message, once all are there."""
    loop, made = asyncio.get_running_loop(), list[asyncio.Transport]()
    server = await loop.create_server(lambda: Bare(made), "127.0.0.1", 0, backlog=count)
    print(server.sockets[0].getsockname()[1], flush=True)
    while len(made) < count:  # noqa: ASYNC110 - nothing else waits
        await asyncio.sleep(POLL_S)
    await asyncio.sleep(SETTLE_S + count * 0.002)  # the crowd's first messages
    reads, used_s, began_s = Bare.reads, time.process_time(), loop.time()
    writes = 0
    if rate_hz:
        writes = await write_evenly(made, rate_hz, began_s + seconds)
    else:
        await asyncio.sleep(seconds)
    used_s = time.process_time() - used_s
    return {
        "core": used_s / (loop.time() - began_s),
        "message_us": used_s / (Bare.reads - reads + writes) * 1e6,
        "memory_mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }


if __name__ == "__main__":
    print(json.dumps(asyncio.run(serve(int(sys.argv[1]), float(sys.argv[2]), float(sys.argv[3])))))
