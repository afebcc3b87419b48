"""EarlyMaster: the master before the daemon runs: blocking calls, without the HTTP client that takes long to import."""

import http.client
import urllib.parse
from typing import Any

from hostlink.graphs.ros1.xml_rpc import (
    HEADERS,
    MASTER_PORT,
    MAX_ANSWER_BYTES,
    TIMEOUT_S,
    BadXml,
    Unreachable,
    decode_answer,
    encode_call,
)


class EarlyMaster:
    """One connection, which is opened again when the master has closed it."""

    def __init__(self, uri: str, node: str) -> None:
        where = urllib.parse.urlsplit(uri)
        host, port = where.hostname or "", where.port or MASTER_PORT
        self._connection = http.client.HTTPConnection(host, port, timeout=TIMEOUT_S)
        self._path, self._node = where.path or "/", node

    def close(self) -> None:
        """End the connection."""
        self._connection.close()

    def call(self, method: str, *arguments: object) -> Any:
        """The value of the answer.

        Raises:
            Unreachable: there is none.
            Refused: the master could not do it.
            BadXml: an argument has no form in XML-RPC.
        """
        body = encode_call(method, (self._node, *arguments))
        try:
            try:
                answer = self._post(body)
            except (http.client.RemoteDisconnected, ConnectionResetError, BrokenPipeError):  # closed after the last one
                self._connection.close()
                answer = self._post(body)
            return decode_answer(answer)
        except (http.client.HTTPException, OSError, BadXml, ValueError) as error:
            self._connection.close()
            raise Unreachable(_why(error)) from error

    def _post(self, body: bytes) -> bytes:
        self._connection.request("POST", self._path, body, HEADERS)
        answer = self._connection.getresponse().read(MAX_ANSWER_BYTES + 1)
        if len(answer) > MAX_ANSWER_BYTES:
            raise BadXml(f"an answer of more than {MAX_ANSWER_BYTES} bytes")
        return answer


def _why(error: Exception) -> str:
    """For people."""
    if isinstance(error, TimeoutError):
        return f"no answer within {TIMEOUT_S:g} s"
    return (error.strerror if isinstance(error, OSError) else None) or str(error) or type(error).__name__
