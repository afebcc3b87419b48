"""Opening of accepted connections: a defect in one ends neither the listener nor the others."""

import asyncio
import socket
from pathlib import Path
from typing import Any

from hostlink.core.config import TcpConfig
from hostlink.core.runtime.listening import listen_on
from hostlink.core.transport.base import Transport
from hostlink.core.transport.tcp import serve_tcp
from tests.support.tcp_server import never
from tests.support.waiting import expect


async def test_connection_that_cannot_be_opened_is_reported_and_others_are_accepted(tmp_path: Path) -> None:
    """asyncio opens no connection of a socket of packets; the listener accepts it all the same."""
    loop, reported, made = asyncio.get_running_loop(), list[dict[str, Any]](), list[Transport]()
    before = loop.get_exception_handler()
    loop.set_exception_handler(lambda _, context: reported.append(context))
    found = await loop.getaddrinfo("127.0.0.1", 0, type=socket.SOCK_STREAM)
    packets = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    packets.bind(str(tmp_path / "host"))
    packets.listen()
    packets.setblocking(False)
    listening = [*listen_on("127.0.0.1", 0, found), packets]
    try:
        async with serve_tcp(TcpConfig(), made.append, on_exhausted=never, listening=listening) as listener:
            with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as wrong:
                wrong.bind(str(tmp_path / "peer"))
                wrong.connect(str(tmp_path / "host"))
                await expect(lambda: reported)
                wrong.settimeout(5.0)
                assert wrong.recv(1) == b""  # it was closed
            with socket.create_connection(listener.address):
                await expect(lambda: made)
                await made[0].aclose()
    finally:
        loop.set_exception_handler(before)
    assert [each["message"] for each in reported] == ["a connection could not be opened"]
    assert isinstance(reported[0]["exception"], ValueError)
