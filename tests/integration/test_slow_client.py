"""A client that does not read: how much is sent to it, where no message is replaced or dropped."""

import asyncio
import socket
import struct

from hostlink.core.protocol.endpoint import EndpointKind
from hostlink.core.protocol.rosserial.frame import encode
from tests.support.api_loads import operation, websocket_head
from tests.support.daemon import daemon
from tests.support.fake_device import fake_device, robot_topics, topic
from tests.support.waiting import TIMEOUT_S

NARROW_BYTES = 2048  # of the client's own buffer
TEXT = b"x" * 1000
MOST_BYTES = 110_000  # one write of 64 KiB in the process, twice 16 KiB in the kernel, and the client's own


async def test_client_that_does_not_read_is_sent_little_and_the_rest_waits_in_its_queue() -> None:
    flood = topic(EndpointKind.PUBLISHER, 126, "/flood", "std_msgs/String", buffer_bytes=2000)
    wire = encode(flood.id, struct.pack("<I", len(TEXT)) + TEXT)
    async with daemon() as host, fake_device(host.tcp, [*robot_topics(), flood]) as device:
        with socket.socket() as narrow:
            narrow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, NARROW_BYTES)
            narrow.connect(("127.0.0.1", int(host.url.rpartition(":")[2])))
            narrow.sendall(websocket_head("") + operation(op="subscribe", topic="/flood"))
            async with asyncio.timeout(TIMEOUT_S):
                while not (clients := (await host.get("/api/clients"))["clients"]) or not clients[0]["dropped"]:
                    await device.send(wire * 10)
            assert 0 < clients[0]["bytes_to_client"] < MOST_BYTES
            assert clients[0]["waiting_messages"] > 1000
