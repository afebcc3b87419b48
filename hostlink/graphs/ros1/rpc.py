"""Rpc: calls of the master and of other nodes, each with its deadline and a bound on its answer."""

import os
import socket
from typing import Any

import aiohttp

from hostlink.graphs.ros1.xml_parser import XmlParser
from hostlink.graphs.ros1.xml_rpc import (
    HEADERS,
    MAX_ANSWER_BYTES,
    TIMEOUT_S,
    BadXml,
    Refused,
    Unreachable,
    decode_answer,
    encode_call,
)


class Rpc:
    """One session for all; `aclose` ends it. `parser`: for whatever else this node is sent."""

    def __init__(self) -> None:
        self.parser = XmlParser()
        timeout = aiohttp.ClientTimeout(total=TIMEOUT_S)
        # a kilobyte of an answer is at most a kilobyte
        self._session = aiohttp.ClientSession(timeout=timeout, headers=HEADERS, auto_decompress=False)

    async def aclose(self) -> None:
        """End its connections."""
        await self._session.close()

    async def call(self, uri: str, method: str, *arguments: object) -> Any:
        """The value of the answer.

        Raises:
            Unreachable: there is none.
            Refused: the other side could not do it.
            BadXml: an argument has no form in XML-RPC.
        """
        body = encode_call(method, arguments)
        try:
            try:
                answer = await self._post(uri, body)
            except aiohttp.ServerDisconnectedError:  # it had closed the connection of the call before
                answer = await self._post(uri, body)
            return await self.parser.parse(decode_answer, answer)
        except (aiohttp.ClientError, OSError, BadXml, ValueError) as error:  # a TimeoutError is an OSError
            raise Unreachable(_why(error)) from error

    async def _post(self, uri: str, body: bytes) -> bytes:
        if self._session.closed:
            raise ConnectionAbortedError("the node has ended")
        async with self._session.post(uri, data=body) as response:
            answer = bytearray()
            async for piece in response.content.iter_any():
                answer += piece
                if len(answer) > MAX_ANSWER_BYTES:
                    raise BadXml(f"an answer of more than {MAX_ANSWER_BYTES} bytes")
            return bytes(answer)


def _why(error: Exception) -> str:
    """For people."""
    if isinstance(error, aiohttp.ClientConnectorError) and error.os_error.errno is not None:
        is_lookup = isinstance(error.os_error, socket.gaierror)  # its numbers are not the system's
        return error.os_error.strerror or str(error) if is_lookup else os.strerror(error.os_error.errno)
    return str(error) or f"no answer within {TIMEOUT_S:g} s"


class Master:
    """The master, as this node calls it."""

    def __init__(self, rpc: Rpc, uri: str, node: str) -> None:
        self.uri, self._rpc, self._node = uri, rpc, node

    async def call(self, method: str, *arguments: object) -> Any:
        """The value of its answer; errors as `Rpc.call`."""
        return await self._rpc.call(self.uri, method, self._node, *arguments)

    async def find_node(self, node: str) -> str | None:
        """Where the node of that name answers; None: the master knows none.

        Raises:
            Unreachable: the master does not answer.
        """
        try:
            found = await self.call("lookupNode", node)
        except Refused:
            return None
        if not isinstance(found, str):
            raise Unreachable("its address of a node is none")
        return found
