"""Zenoh without a network: sessions of one process, in virtual time. Samples come in the next turn of the loop."""

import asyncio
import re
from collections import Counter
from collections.abc import Callable
from typing import Any

from hostlink.graphs.zenoh.session import Declaration, Query, Sample, Token


class MemoryNetwork:
    """Declarations of all sessions."""

    def __init__(self) -> None:
        self.subscribers: list[tuple[MemorySession, re.Pattern[str], Callable[[Sample], None]]] = []
        self.queryables: list[tuple[re.Pattern[str], Callable[[Query], None]]] = []
        self.token_subscribers: list[tuple[re.Pattern[str], Callable[[Token], None]]] = []
        self.tokens: list[str] = []

    def note_token(self, key: str, *, is_alive: bool) -> None:
        if is_alive:
            self.tokens.append(key)
        else:
            self.tokens.remove(key)
        for pattern, receive in self.token_subscribers:
            if pattern.fullmatch(key):
                asyncio.get_running_loop().call_soon(receive, Token(key, is_alive))


class MemorySession:
    """Session as the fleet uses it."""

    def __init__(self, network: MemoryNetwork, zid: str) -> None:
        self.counts: Counter[str] = Counter()
        self.zid, self._network = zid, network

    def put(self, key: str, payload: bytes, **_: Any) -> None:
        for session, pattern, receive in list(self._network.subscribers):
            if session is not self and pattern.fullmatch(key):
                asyncio.get_running_loop().call_soon(receive, Sample(key, payload))

    def declare_publisher(self, key: str, **_: Any) -> "MemoryPublisher":
        return MemoryPublisher(self, key)

    def declare_token(self, key: str) -> Declaration:
        self._network.note_token(key, is_alive=True)
        return Declaration(lambda: self._network.note_token(key, is_alive=False))

    def subscribe(self, keys: str, receive: Callable[[Sample], None], **_: Any) -> Declaration:
        return _listed(self._network.subscribers, (self, _pattern(keys), receive))

    def subscribe_tokens(self, keys: str, receive: Callable[[Token], None]) -> Declaration:
        pattern = _pattern(keys)
        for key in filter(pattern.fullmatch, self._network.tokens):
            asyncio.get_running_loop().call_soon(receive, Token(key, True))
        return _listed(self._network.token_subscribers, (pattern, receive))

    def serve(self, keys: str, answer: Callable[[Query], None], **_: Any) -> Declaration:
        return _listed(self._network.queryables, (_pattern(keys), answer))

    async def get(self, key: str, **_: Any) -> list[Sample]:
        answers: list[Sample] = []
        for pattern, answer in list(self._network.queryables):
            if pattern.fullmatch(key):
                answer(Query(key, b"", b"", lambda payload: answers.append(Sample(key, payload)), lambda: None))
        return answers

    def certificate_of(self, _: str) -> str:
        return ""


class MemoryPublisher:
    """Publisher that does not know its subscribers, so messages on demand are not sent."""

    def __init__(self, session: MemorySession, key: str) -> None:
        self._session, self._key = session, key

    def put(self, payload: bytes) -> None:
        self._session.put(self._key, payload)

    def watch(self, on_change: Callable[[bool], None]) -> None:
        """Never."""

    def close(self) -> None:
        """Do nothing, because a publisher is not declared."""


def _listed(entries: list[Any], entry: Any) -> Declaration:
    entries.append(entry)
    return Declaration(lambda: entries.remove(entry))


def _pattern(keys: str) -> re.Pattern[str]:
    return re.compile(re.escape(keys).replace(r"/\*\*", "(/.*)?").replace(r"\*", "[^/]*"))
