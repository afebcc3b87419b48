"""ZenohSession: one Zenoh session on the event loop. Callbacks in the loop receive what Zenoh's threads deliver."""

import asyncio
import contextlib
import functools
from collections import Counter
from collections.abc import AsyncIterator, Callable, Hashable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any, NamedTuple

import structlog

from hostlink.components.zenoh.lingering import SWEEP_INTERVAL_S, end_lingering, shut_down
from hostlink.components.zenoh.settings import ZenohSettings, library, reach_of, reason_of, settings_of
from hostlink.core.mirror.inbox import MAX_WAITING, ThreadInbox
from hostlink.core.runtime.logs import printable
from hostlink.errors import ConfigError

log = structlog.get_logger()

Around = Callable[..., AbstractContextManager[None]]  # as `Host.around`: a failure of a callback is logged and counted

CLOSE_TIMEOUT_S = 1.0
MAX_PAYLOAD_BYTES = 1024 * 1024
MAX_KEY_CHARS = 512
MAX_ATTACHMENT_BYTES = 1024  # 33 in ROS 2: number, time and sender
MAX_ANSWERS = 1024  # to one query
HEARTBEAT_S = 0.5  # while something is kept for later subscribers: a subscriber notices that it has missed it


class ZenohSample(NamedTuple):
    """Message on a key."""

    key: str
    payload: bytes
    attachment: bytes = b""


class Token(NamedTuple):
    """Liveliness token: its owner lives, or has ended."""

    key: str
    is_alive: bool


@dataclass(frozen=True, slots=True)
class Query:
    """Query; `reply` may be called later, and at most once for each key. `close` ends it."""

    payload: bytes
    attachment: bytes
    reply: Callable[..., None]
    close: Callable[[], None]


class Declaration:
    """Something that is declared in the session, until it is closed."""

    def __init__(self, *undeclare: Callable[[], None]) -> None:
        self._undeclare = undeclare

    def close(self) -> None:
        """Undeclare it; it may be closed already."""
        undeclare, self._undeclare = self._undeclare, ()
        for each in undeclare:
            each()


class ZenohPublisher:
    """A key on which this daemon publishes. Nothing is sent without a subscriber."""

    def __init__(self, session: "ZenohSession", publisher: Any) -> None:
        self._session, self._publisher = session, publisher
        self._listener = Declaration()

    def put(self, payload: bytes, *, attachment: bytes | None = None) -> None:
        """Publish; while the network is behind it is dropped."""
        with self._session.guarded("put"):
            self._publisher.put(payload, attachment=attachment)

    def watch(self, on_change: Callable[[bool], None]) -> None:
        """Call `on_change` in the loop when another session subscribes, also already, and when no more do."""
        inbox = self._session.inbox(on_change)
        with self._session.guarded("match"):
            notice = self._session.callback(lambda status: inbox.put("", status.matching))
            listener = self._publisher.declare_matching_listener(notice)
            self._listener = Declaration(inbox.close, listener.undeclare)

    def close(self) -> None:
        """Undeclare the publisher."""
        with self._session.guarded("undeclare"):
            self._listener.close()
            self._publisher.undeclare()


class ZenohSession:
    """One Zenoh session. Its methods are called in the loop, wait for nothing, and do not raise what Zenoh raises.

    `counts`: `links` that were opened, `dropped` and `oversized` of what came, `failed` calls of Zenoh; what `receive`
    callbacks raise is passed to `around`.
    """

    def __init__(self, zenoh: Any, session: Any, around: Around) -> None:
        self.counts: Counter[str] = Counter()
        self.zid = str(session.info.zid())
        self._zenoh, self._session, self._around = zenoh, session, around
        self._is_closed = False
        self._thread = ThreadPoolExecutor(1, "zenoh")  # for answers

    # -- what is sent -------------------------------------------------------------------------------------------------

    def put(self, key: str, payload: bytes, *, attachment: bytes | None = None, is_urgent: bool = False) -> None:
        """Publish once, on a key that is used seldom; `is_urgent`: before everything else, and never in a batch."""
        with self.guarded("put"):
            self._session.put(key, payload, attachment=attachment, **self._quality(is_urgent=is_urgent))

    def declare_publisher(self, key: str, *, is_urgent: bool = False, kept: int = 0) -> ZenohPublisher:
        """Publish on a key again and again. `kept`: as many of the newest are sent to those who subscribe later.

        Raises:
            ConfigError: the session is closed, or the key is invalid.
        """
        declare = (
            functools.partial(_declare_keeping_publisher, self._session, kept)
            if kept
            else self._session.declare_publisher
        )
        return ZenohPublisher(self, self._declare(declare, key, **self._quality(is_urgent=is_urgent)))

    def declare_token(self, key: str) -> Declaration:
        """Show that this daemon lives, or has something, until the declaration or the session is closed.

        Raises:
            ConfigError: the session is closed, or the key is invalid.
        """
        token = self._declare(self._session.liveliness().declare_token, key)
        return Declaration(lambda: self._undeclare(token))

    # -- receiving ----------------------------------------------------------------------------------------------------

    def subscribe(
        self,
        key_expr: str,
        receive: Callable[[ZenohSample], None],
        *,
        source_of: Callable[[ZenohSample], Hashable] = lambda _: "",
        is_known: Callable[[Any], bool] = lambda _: True,
        max_bytes: int = MAX_PAYLOAD_BYTES,
        max_waiting: int = MAX_WAITING,
        needed: Callable[[Sequence[ZenohSample]], list[ZenohSample]] | None = None,
        has_history: bool = False,
    ) -> Declaration:
        """Call `receive` for each sample of others that fits in `max_bytes`; not for those of this session.

        `source_of`: in whose queue a sample waits, and `is_known`: whether that source has one of its own, both called
        in a thread; `max_waiting`, `needed`: as in ThreadInbox; `has_history`: kept messages arrive first.

        Raises:
            ConfigError: the session is closed, or the key expression is invalid.
        """
        inbox = self.inbox(receive, max_waiting=max_waiting, needed=needed, is_known=is_known)

        def put(sample: Any) -> None:
            with self.guarded("receive"):
                key = str(sample.key_expr)
                is_put = sample.kind == self._zenoh.SampleKind.PUT
                if self._fits(key, len(sample.payload), max_bytes, sample.attachment) and is_put:
                    received = ZenohSample(key, sample.payload.to_bytes(), _bytes(sample.attachment))
                    inbox.put(source_of(received), received)

        declare = self._session.declare_subscriber
        if has_history:
            declare = functools.partial(_declare_history_subscriber, self._session)
        subscriber = self._declare(declare, key_expr, self.callback(put), allowed_origin=self._zenoh.Locality.REMOTE)
        return Declaration(inbox.close, lambda: self._undeclare(subscriber))

    def subscribe_tokens(self, key_expr: str, receive: Callable[[Token], None]) -> Declaration:
        """Call `receive` for each liveliness token that exists, appears or ends, of this session too.

        Raises:
            ConfigError: the session is closed, or the key expression is invalid.
        """
        inbox = self.inbox(receive, max_waiting=MAX_WAITING * 64)

        def put(sample: Any) -> None:
            with self.guarded("receive"):
                key = str(sample.key_expr)
                if self._fits(key, 0, 0):
                    inbox.put("", Token(key, sample.kind == self._zenoh.SampleKind.PUT))

        subscriber = self._declare(
            self._session.liveliness().declare_subscriber, key_expr, self.callback(put), history=True
        )
        return Declaration(inbox.close, lambda: self._undeclare(subscriber))

    def serve(self, key_expr: str, answer: Callable[[Query], None]) -> Declaration:
        """Call `answer` for each query.

        Raises:
            ConfigError: the session is closed, or the key expression is invalid.
        """
        inbox = self.inbox(answer)

        def put(query: Any) -> None:
            with self.guarded("receive"):
                key, payload = str(query.key_expr), _bytes(query.payload)
                if self._fits(key, len(payload), MAX_PAYLOAD_BYTES, query.attachment):
                    reply, close = self._replies(query)
                    inbox.put("", Query(payload, _bytes(query.attachment), reply, close))

        queryable = self._declare(self._session.declare_queryable, key_expr, self.callback(put), complete=True)
        return Declaration(inbox.close, lambda: self._undeclare(queryable))

    async def get(
        self, selector: str, payload: bytes | None = None, *, attachment: bytes | None = None, timeout_s: float
    ) -> list[ZenohSample]:
        """Return the answers to a query that arrived in time."""
        loop, answers = asyncio.get_running_loop(), list[ZenohSample]()
        done = asyncio.Event()

        def put(reply: Any) -> None:
            with self.guarded("receive"):
                sample = reply.ok
                if sample is not None and len(answers) < MAX_ANSWERS and len(sample.payload) <= MAX_PAYLOAD_BYTES:
                    answers.append(
                        ZenohSample(str(sample.key_expr), sample.payload.to_bytes(), _bytes(sample.attachment))
                    )

        def end() -> None:
            with contextlib.suppress(RuntimeError):  # the loop has ended
                loop.call_soon_threadsafe(done.set)

        with self.guarded("get"):
            self._session.get(
                selector,
                self.callback(put, end),
                payload=payload,
                attachment=attachment,
                timeout=timeout_s,
                target=self._zenoh.QueryTarget.ALL,
            )
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(timeout_s + CLOSE_TIMEOUT_S):
                    await done.wait()
        return list(answers)

    def certificate_of(self, zid: str) -> str:
        """The common name in the certificate of the neighbour of this id; empty without one, or behind a router."""
        with self.guarded("links"):
            names = [link.auth_identifier for link in self._session.info.links() if str(link.zid) == zid]
            return next((name for name in names if name), "")
        return ""

    def close_links(self, zid: str) -> None:
        """Close the connections to the neighbour of this id; Zenoh makes them anew."""
        with self.guarded("links"):
            ends = {(str(link.src), str(link.dst)) for link in self._session.info.links() if str(link.zid) == zid}
            self.counts["closed"] += shut_down(ends)

    # -- its life -----------------------------------------------------------------------------------------------------

    async def run(self) -> None:
        """Keep the end of one link from delaying all others, until the session is closed."""
        while not self._is_closed:
            self.counts["links"] += end_lingering()
            await asyncio.sleep(SWEEP_INTERVAL_S)

    async def aclose(self) -> None:
        """End the session: tokens and declarations go, for everybody at once. It waits for a second at most."""
        self._is_closed = True
        self._thread.shutdown(wait=False, cancel_futures=True)
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(CLOSE_TIMEOUT_S):
                await asyncio.to_thread(self._close)

    def _close(self) -> None:
        with self.guarded("close"):
            self._session.close()

    # -- for its parts ------------------------------------------------------------------------------------------------

    @contextlib.contextmanager
    def guarded(self, what: str) -> Any:
        """Count and log an error of Zenoh instead of raising it, also in Zenoh's threads."""
        try:
            yield
        except self._zenoh.ZError as error:
            self.counts["failed"] += 1
            if not self._is_closed:
                log.debug("zenoh.failed", what=what, cause=printable(str(error), 200))

    def inbox(
        self,
        deliver: Callable[[Any], None],
        *,
        max_waiting: int = MAX_WAITING,
        needed: Callable[[Sequence[Any]], list[Any]] | None = None,
        is_known: Callable[[Any], bool] = lambda _: True,
    ) -> ThreadInbox[Any]:
        """A queue from Zenoh's threads to the loop."""
        return ThreadInbox(
            deliver,
            guarded=lambda: self._around("graph", graph="zenoh"),
            counts=self.counts,
            max_waiting=max_waiting,
            needed=needed,
            is_known=is_known,
        )

    def _replies(self, query: Any) -> tuple[Callable[..., None], Callable[[], None]]:
        """Return functions that answer a query, and end it.

        They work in a thread, in the order of the calls, and not after the end of the session: an answer waits for a
        neighbour who calls more than he reads, until he is cut off.
        """

        def reply(payload: bytes, *, key: str = "", attachment: bytes | None = None) -> None:
            submit(query.reply, key or str(query.key_expr), payload, attachment=attachment)

        def submit(work: Callable[..., None], *arguments: Any, **options: Any) -> None:
            with contextlib.suppress(RuntimeError):  # the session is closed
                self._thread.submit(self._work, work, *arguments, **options)

        return reply, lambda: submit(query.drop)

    def _work(self, work: Callable[..., None], *arguments: Any, **options: Any) -> None:
        with self.guarded("reply"):
            work(*arguments, **options)

    def _fits(self, key: str, payload_bytes: int, max_bytes: int, attachment: Any = None) -> bool:
        attached_bytes = 0 if attachment is None else len(attachment)
        if payload_bytes <= max_bytes and len(key) <= MAX_KEY_CHARS and attached_bytes <= MAX_ATTACHMENT_BYTES:
            return True
        self.counts["oversized"] += 1
        return False

    def _declare(self, declare: Callable[..., Any], key: str, *arguments: Any, **options: Any) -> Any:
        try:
            return declare(key, *arguments, **options)
        except self._zenoh.ZError as error:
            raise ConfigError("zenoh", f"{printable(key)} cannot be declared: {error}") from error

    def _undeclare(self, declared: Any) -> None:
        if not self._is_closed:
            with self.guarded("undeclare"):
                declared.undeclare()

    def callback(self, call: Callable[[Any], None], end: Callable[[], None] = lambda: None) -> Any:
        """Called in Zenoh's own threads, without one of its own: it only queues."""
        return self._zenoh.handlers.Callback(call, end, indirect=False)

    def _quality(self, *, is_urgent: bool) -> dict[str, Any]:
        priority = self._zenoh.Priority.REAL_TIME if is_urgent else self._zenoh.Priority.DATA
        return {
            "congestion_control": self._zenoh.CongestionControl.DROP,
            "priority": priority,
            "express": is_urgent,
            "allowed_destination": self._zenoh.Locality.REMOTE,  # nothing in this session receives from it
        }


# -- messages that publishers keep for later subscribers, as rmw_zenoh does for transient local durability -----------


def _declare_keeping_publisher(session: Any, kept: int, key: str, **quality: Any) -> Any:
    """Declare a publisher that sends the newest messages, as many as are `kept`, to each later subscriber."""
    from zenoh import ext  # noqa: PLC0415 - an optional dependency

    return ext.declare_advanced_publisher(
        session,
        key,
        cache=ext.CacheConfig(kept),
        sample_miss_detection=ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=HEARTBEAT_S),
        publisher_detection=True,
        **quality,
    )


def _declare_history_subscriber(session: Any, key: str, callback: Any, *, allowed_origin: Any) -> Any:
    """Declare a subscriber that requests the newest message that each publisher keeps."""
    from zenoh import ext  # noqa: PLC0415 - an optional dependency

    return ext.declare_advanced_subscriber(
        session,
        key,
        callback,
        allowed_origin=allowed_origin,
        history=ext.HistoryConfig(detect_late_publishers=True, max_samples=1),
        recovery=ext.RecoveryConfig(periodic_queries=None, heartbeat=True),
        subscriber_detection=True,
    )


@contextlib.asynccontextmanager
async def opened(config: ZenohSettings, around: Around) -> AsyncIterator[ZenohSession]:
    """A session for the length of the block.

    Raises:
        ConfigError: eclipse-zenoh is not installed, or the settings are refused.
    """
    zenoh, settings = library(), settings_of(config)
    try:
        raw = await asyncio.to_thread(lambda: zenoh.open(settings))
    except (zenoh.ZError, ValueError) as error:
        raise ConfigError("zenoh", f"the session cannot be opened: {reason_of(error)}") from error
    session = ZenohSession(zenoh, raw, around)
    log.info("zenoh.opened", zid=session.zid, mode=config.mode, reach="; ".join(reach_of(settings, config)))
    try:
        yield session
    finally:
        await session.aclose()
        log.info("zenoh.closed", **session.counts)


def _bytes(payload: Any) -> bytes:
    return b"" if payload is None else bytes(payload.to_bytes())
