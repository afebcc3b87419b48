"""ForwardingProtocol: wrapper of an asyncio protocol, for subclasses that watch its start and end."""

import asyncio


class ForwardingProtocol(asyncio.BaseProtocol):
    """Forwards every call except those with received bytes.

    A subclass is an asyncio.Protocol or an asyncio.BufferedProtocol too, never both: uvloop calls `data_received` of a
    class that is both, and asyncio calls `buffer_updated`.
    """

    def __init__(self, inner: asyncio.Protocol) -> None:
        self._inner = inner

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._inner.connection_made(transport)

    def eof_received(self) -> bool | None:
        return self._inner.eof_received()

    def pause_writing(self) -> None:
        self._inner.pause_writing()

    def resume_writing(self) -> None:
        self._inner.resume_writing()

    def connection_lost(self, exc: Exception | None) -> None:
        self._inner.connection_lost(exc)
