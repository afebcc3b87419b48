"""Servers of tests leave no connection open: they end in each turn of the loop after an accept."""

import asyncio
import contextlib
import socket

import pytest

from tests.support.ros1.fake import encode_answer, xml_rpc_server
from tests.support.tcp_server import say_nothing, tcp_server


async def is_closed(client: socket.socket) -> bool:
    with contextlib.suppress(ConnectionResetError):
        async with asyncio.timeout(10.0):
            return await asyncio.get_running_loop().sock_recv(client, 1) == b""
    return True


@pytest.mark.parametrize("turns", range(8))
async def test_server_of_xml_rpc_that_ends_while_it_accepts_closes_the_connection(turns: int) -> None:
    with socket.socket() as client:
        client.setblocking(False)
        async with xml_rpc_server(lambda *_: encode_answer(1, "", 0)) as url:
            client.connect_ex(("127.0.0.1", int(url.rpartition(":")[2].strip("/"))))
            for _ in range(turns):
                await asyncio.sleep(0)
        assert await is_closed(client)


@pytest.mark.parametrize("turns", range(8))
async def test_tcp_server_that_ends_while_it_accepts_closes_the_connection(turns: int) -> None:
    with socket.socket() as client:
        client.setblocking(False)
        async with tcp_server(say_nothing) as address:
            client.connect_ex(address)
            for _ in range(turns):
                await asyncio.sleep(0)
        assert await is_closed(client)
