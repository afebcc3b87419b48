"""Zenoh without a network: sessions of one process, in virtual time. Samples arrive in the next turn of the loop."""

import asyncio
import re
from collections import Counter
from collections.abc import Callable, Hashable, Sequence
from typing import Any

from hostlink.components.zenoh.session import Declaration, Query, Token, ZenohSample
from hostlink.core.mirror.inbox import MAX_WAITING, ThreadInbox


class MemoryNetwork:
    """Declarations of the sessions."""

    def __init__(self) -> None:
        self.subscribers: list[tuple[MemorySession, re.Pattern[str], Callable[[ZenohSample], None]]] = []
        self.queryables: list[tuple[MemorySession, re.Pattern[str], Callable[[Query], None]]] = []
        self.token_subscribers: list[tuple[re.Pattern[str], Callable[[Token], None]]] = []
        self.tokens: list[str] = []
        self.publishers: list[MemoryPublisher] = []
        self.deaf: set[str] = set()  # sessions that receive nothing
        self.mute: set[tuple[str, str]] = set()  # sender and receiver of which nothing arrives
        self.closed: list[tuple[str, str]] = []  # links that were closed, by whom and to whom

    def note_token(self, key: str, *, is_alive: bool) -> None:
        if is_alive:
            self.tokens.append(key)
        elif key in self.tokens:
            self.tokens.remove(key)
        for pattern, receive in self.token_subscribers:
            if pattern.fullmatch(key):
                asyncio.get_running_loop().call_soon(receive, Token(key, is_alive))

    def note_subscribers(self) -> None:
        """Tell the publishers who watch it whether they have subscribers."""
        for publisher in list(self.publishers):
            publisher.note()

    def drop(self, zid: str) -> None:
        """End the tokens of a session, as if its process were killed."""
        for key in [key for key in self.tokens if zid in key.split("/")]:
            self.note_token(key, is_alive=False)


class MemorySession:
    """The part of a Session that the fleet and rmw_zenoh use."""

    def __init__(self, network: MemoryNetwork, zid: str) -> None:
        self.counts: Counter[str] = Counter()
        self.zid, self._network = zid, network

    def put(self, key: str, payload: bytes, *, attachment: bytes | None = None, is_urgent: bool = False) -> None:
        del is_urgent
        for session, pattern, receive in list(self._network.subscribers):
            is_heard = session.zid not in self._network.deaf and (self.zid, session.zid) not in self._network.mute
            if session is not self and is_heard and pattern.fullmatch(key):
                receive(ZenohSample(key, payload, attachment or b""))

    def declare_publisher(self, key: str, *, kept: int = 0, **_: Any) -> "MemoryPublisher":
        return MemoryPublisher(self, self._network, key, kept)

    def declare_token(self, key: str) -> Declaration:
        self._network.note_token(key, is_alive=True)
        return Declaration(lambda: self._network.note_token(key, is_alive=False))

    def subscribe(
        self,
        keys: str,
        receive: Callable[[ZenohSample], None],
        *,
        source_of: Callable[[ZenohSample], Hashable] = lambda _: "",
        is_known: Callable[[Any], bool] = lambda _: True,
        max_waiting: int = MAX_WAITING,
        needed: Callable[[Sequence[ZenohSample]], list[ZenohSample]] | None = None,
        has_history: bool = False,
        **_: Any,
    ) -> Declaration:
        inbox = ThreadInbox(receive, max_waiting=max_waiting, needed=needed, is_known=is_known)

        def put(sample: ZenohSample) -> None:
            inbox.put(source_of(sample), sample)

        pattern = _pattern(keys)
        for publisher in self._network.publishers if has_history else ():
            if publisher.kept is not None and pattern.fullmatch(publisher.key):
                put(publisher.kept)
        declaration = _listed(self._network.subscribers, (self, pattern, put))
        self._network.note_subscribers()
        return Declaration(inbox.close, declaration.close, self._network.note_subscribers)

    def subscribe_tokens(self, keys: str, receive: Callable[[Token], None]) -> Declaration:
        pattern = _pattern(keys)
        for key in filter(pattern.fullmatch, self._network.tokens):
            asyncio.get_running_loop().call_soon(receive, Token(key, True))
        return _listed(self._network.token_subscribers, (pattern, receive))

    def serve(self, keys: str, answer: Callable[[Query], None], **_: Any) -> Declaration:
        return _listed(self._network.queryables, (self, _pattern(keys), answer))

    async def get(
        self, key: str, payload: bytes | None = None, *, attachment: bytes | None = None, timeout_s: float
    ) -> list[ZenohSample]:
        """Return the answers of other sessions once all have closed their queries, or after the time-out."""
        answers: list[ZenohSample] = []
        waiting: list[asyncio.Future[None]] = []
        for session, pattern, answer in list(self._network.queryables):
            if session is not self and session.zid not in self._network.deaf and pattern.fullmatch(key):
                done = asyncio.get_running_loop().create_future()
                waiting.append(done)

                def reply(data: bytes, *, key: str = key, attachment: bytes | None = None) -> None:
                    answers.append(ZenohSample(key, data, attachment or b""))

                def close(done: asyncio.Future[None] = done) -> None:
                    if not done.done():
                        done.set_result(None)

                answer(Query(payload or b"", attachment or b"", reply, close))
        if waiting:
            await asyncio.wait(waiting, timeout=timeout_s)
        return answers

    def close_links(self, zid: str) -> None:
        """Close the links to another session: Zenoh makes them anew, with all that is declared."""
        self._network.closed.append((self.zid, zid))
        self._network.mute.discard((zid, self.zid))

    def certificate_of(self, _: str) -> str:
        return ""


class MemoryPublisher:
    """Publisher that keeps its newest message if it is declared so."""

    def __init__(self, session: MemorySession, network: MemoryNetwork, key: str, kept: int) -> None:
        self.key = key
        self.kept: ZenohSample | None = None
        self._keeps, self._session, self._network = kept > 0, session, network
        self._on_change: Callable[[bool], None] = lambda _: None
        self._was_subscribed = False
        network.publishers.append(self)

    def put(self, payload: bytes, *, attachment: bytes | None = None) -> None:
        if self._keeps:
            self.kept = ZenohSample(self.key, payload, attachment or b"")
        self._session.put(self.key, payload, attachment=attachment)

    @property
    def is_subscribed(self) -> bool:
        others = (each for each in self._network.subscribers if each[0] is not self._session)
        return any(pattern.fullmatch(self.key) for _, pattern, _ in others)

    def watch(self, on_change: Callable[[bool], None]) -> None:
        self._on_change = on_change
        self.note()

    def note(self) -> None:
        """Report a change of whether it has subscribers."""
        if self.is_subscribed is not self._was_subscribed:
            self._was_subscribed = not self._was_subscribed
            asyncio.get_running_loop().call_soon(self._on_change, self._was_subscribed)

    def close(self) -> None:
        self._network.publishers.remove(self)


def _listed(entries: list[Any], entry: Any) -> Declaration:
    entries.append(entry)
    return Declaration(lambda: entries.remove(entry))


def _pattern(keys: str) -> re.Pattern[str]:
    return re.compile(re.escape(keys).replace(r"/\*\*", "(/.*)?").replace(r"\*", "[^/]*"))
