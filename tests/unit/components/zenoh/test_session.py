"""ZenohSession without a network: which samples arrive, and what Zenoh's errors do."""

import asyncio
import sys
import threading
from collections.abc import Awaitable, Callable
from types import SimpleNamespace
from typing import Any

import pytest
from structlog.testing import capture_logs

from hostlink.components.zenoh import session as module
from hostlink.components.zenoh.session import (
    MAX_ANSWERS,
    MAX_ATTACHMENT_BYTES,
    MAX_KEY_CHARS,
    MAX_PAYLOAD_BYTES,
    Query,
    Token,
    ZenohSample,
    ZenohSession,
    opened,
)
from hostlink.components.zenoh.settings import ZenohSettings, library
from hostlink.core.hub.isolation import Isolation
from hostlink.errors import ConfigError, LibraryMissing
from tests.support.logs import logged
from tests.support.virtual_loop import run_virtual

PUT, DELETE = "put", "delete"


class Payload(bytes):
    """Bytes as Zenoh gives them."""

    def to_bytes(self) -> bytes:
        return bytes(self)


def sample(key: str, payload: bytes = b"", *, kind: str = PUT, attachment: bytes | None = None) -> Any:
    return SimpleNamespace(
        key_expr=key,
        payload=Payload(payload),
        kind=kind,
        attachment=None if attachment is None else Payload(attachment),
    )


class ZError(Exception):
    """The only error of Zenoh."""


class FakeZenoh:
    """The library, and a session of it that notes what is declared, put and requested."""

    ZError = ZError
    SampleKind = SimpleNamespace(PUT=PUT)
    Locality = SimpleNamespace(REMOTE="remote")
    Priority = SimpleNamespace(REAL_TIME="real time", DATA="data")
    CongestionControl = SimpleNamespace(DROP="drop")
    QueryTarget = SimpleNamespace(ALL="all")

    def __init__(self) -> None:
        self.handlers = SimpleNamespace(Callback=lambda call, end, *, indirect: (call, end, indirect))
        self.info = SimpleNamespace(
            zid=lambda: "1a",
            links=lambda: [
                SimpleNamespace(zid="2b", auth_identifier=None),
                SimpleNamespace(zid="2b", auth_identifier="desk"),
                SimpleNamespace(zid="3c", auth_identifier=None),
            ],
        )
        self.received: dict[str, Callable[[Any], None]] = {}
        self.options: dict[str, dict[str, Any]] = {}
        self.puts: list[tuple[str, bytes, dict[str, Any]]] = []
        self.replies: list[Any] = []
        self.publishers: dict[str, FakePublisher] = {}
        self.settings: Any = None
        self.has_failed = False
        self.is_closed = False

    def _declare(self, key: str, callback: Any = None, **options: Any) -> Any:
        self._check()
        self.options[key] = options
        if callback is not None:
            assert not callback[2]  # Zenoh makes no thread for it
            self.received[key] = callback[0]
        return SimpleNamespace(undeclare=lambda: self._undeclare(key))

    declare_subscriber = declare_queryable = declare_token = _declare

    def declare_publisher(self, key: str, **options: Any) -> "FakePublisher":
        self._declare(key, **options)
        return FakePublisher(self, key)

    def open(self, settings: Any) -> "FakeZenoh":
        self._check()
        self.settings = settings
        return self

    def liveliness(self) -> "FakeZenoh":
        return self

    def put(self, key: str, payload: bytes, **options: Any) -> None:
        self._check()
        self.puts.append((key, payload, options))

    def get(self, _selector: str, callback: Any, **_: Any) -> None:
        self._check()
        for reply in self.replies:
            callback[0](reply)
        callback[1]()

    def close(self) -> None:
        self.is_closed = True

    def _check(self) -> None:
        if self.has_failed:
            raise ZError("session closed")

    def _undeclare(self, key: str) -> None:
        self._check()
        del self.options[key]


class FakePublisher:
    """A key on which a session of FakeZenoh publishes."""

    def __init__(self, zenoh: FakeZenoh, key: str) -> None:
        self._zenoh, self._key = zenoh, key
        self.is_matching = False
        zenoh.publishers[key] = self

    @property
    def matching_status(self) -> Any:
        self._zenoh._check()
        return SimpleNamespace(matching=self.is_matching)

    def put(self, payload: bytes, **options: Any) -> None:
        self._zenoh.put(self._key, payload, **options)

    def declare_matching_listener(self, callback: Any) -> Any:
        self.notice = callback[0]
        return self._zenoh._declare(f"{self._key} matching")

    def undeclare(self) -> None:
        self._zenoh._undeclare(self._key)


class FakeQuery:
    """A query of another session, which keeps its answers."""

    def __init__(self, key: str, payload: bytes | None = None, attachment: bytes | None = None) -> None:
        self.key_expr = key
        self.payload, self.attachment = (None if each is None else Payload(each) for each in (payload, attachment))
        self.answers: list[tuple[str, bytes, bytes | None]] = []
        self.dropped = threading.Event()

    def reply(self, key: str, payload: bytes, *, attachment: bytes | None) -> None:
        self.answers.append((key, payload, attachment))

    def drop(self) -> None:
        self.dropped.set()


def with_session(test: Callable[[ZenohSession, FakeZenoh], Awaitable[None]]) -> None:
    async def run() -> None:
        zenoh = FakeZenoh()
        await test(ZenohSession(zenoh, zenoh, Isolation(reraises=True).around), zenoh)

    run_virtual(run())


def test_samples_within_the_bounds_arrive_and_others_are_counted() -> None:
    async def test(session: ZenohSession, zenoh: FakeZenoh) -> None:
        received: list[ZenohSample] = []
        declared = session.subscribe("a/**", received.append, max_bytes=3)
        put = zenoh.received["a/**"]
        put(sample("a/b", b"123", attachment=b"x"))
        put(sample("a/b", b"1234"))
        put(sample("a/b", b"123", kind=DELETE))
        put(sample("k" * MAX_KEY_CHARS))
        put(sample("k" * (MAX_KEY_CHARS + 1)))
        put(sample("a/b", b"123", attachment=bytes(MAX_ATTACHMENT_BYTES + 1)))
        await asyncio.sleep(0.1)
        assert received == [ZenohSample("a/b", b"123", b"x"), ZenohSample("k" * MAX_KEY_CHARS, b"")]
        assert session.counts == {"oversized": 3}
        assert zenoh.options["a/**"] == {"allowed_origin": "remote"}
        declared.close()
        declared.close()
        put(sample("a/b"))
        await asyncio.sleep(0.1)
        assert (len(received), zenoh.options) == (2, {})

    with_session(test)


def test_source_that_floods_loses_its_own_samples_only() -> None:
    async def test(session: ZenohSession, zenoh: FakeZenoh) -> None:
        received: list[bytes] = []
        session.subscribe(
            "**",
            lambda each: received.append(each.payload),
            source_of=lambda each: (each.key, each.attachment),
            max_waiting=1,
        )
        for number in b"12":
            zenoh.received["**"](sample("a", bytes([number]), attachment=b"x"))
            zenoh.received["**"](sample("a", bytes([number]), attachment=b"y"))
        zenoh.received["**"](sample("b", b"3"))
        await asyncio.sleep(0.1)
        assert (received, session.counts) == ([b"2", b"2", b"3"], {"dropped": 2})

    with_session(test)


def test_sources_that_are_not_known_share_one_queue() -> None:
    async def test(session: ZenohSession, zenoh: FakeZenoh) -> None:
        received: list[str] = []
        session.subscribe(
            "**",
            lambda each: received.append(each.key),
            source_of=lambda each: each.key,
            is_known=lambda source: source == "known",
            max_waiting=1,
        )
        for key in ("known", "a", "b"):
            zenoh.received["**"](sample(key))
        await asyncio.sleep(0.1)
        assert (received, session.counts) == (["known", "b"], {"dropped": 1})

    with_session(test)


def test_tokens_say_whether_their_owner_lives() -> None:
    async def test(session: ZenohSession, zenoh: FakeZenoh) -> None:
        tokens: list[Token] = []
        session.subscribe_tokens("alive/*", tokens.append)
        for kind in (PUT, DELETE):
            zenoh.received["alive/*"](sample("alive/a", kind=kind))
        await asyncio.sleep(0.1)
        assert tokens == [Token("alive/a", is_alive=True), Token("alive/a", is_alive=False)]
        assert zenoh.options["alive/*"] == {"history": True}

    with_session(test)


@pytest.mark.parametrize("is_urgent", [False, True])
def test_urgent_message_is_sent_before_others_and_in_no_batch(is_urgent: bool) -> None:
    async def test(session: ZenohSession, zenoh: FakeZenoh) -> None:
        session.put("a", b"1", is_urgent=is_urgent)
        ((key, payload, options),) = zenoh.puts
        assert (key, payload, options["express"]) == ("a", b"1", is_urgent)
        assert options["priority"] == ("real time" if is_urgent else "data")
        assert (options["congestion_control"], options["allowed_destination"]) == ("drop", "remote")

    with_session(test)


def test_error_of_zenoh_is_counted_and_a_failed_declaration_is_an_error() -> None:
    async def test(session: ZenohSession, zenoh: FakeZenoh) -> None:
        declared = session.declare_token("alive/a")
        zenoh.has_failed = True
        session.put("a", b"1")
        declared.close()
        assert await session.get("topics/a", timeout_s=1.0) == []
        assert session.counts == {"failed": 3}
        with pytest.raises(ConfigError, match="alive/b cannot be declared"):
            session.declare_token("alive/b")

    with_session(test)


def test_answers_to_a_query_are_bounded_and_errors_among_them_left_out() -> None:
    async def test(session: ZenohSession, zenoh: FakeZenoh) -> None:
        zenoh.replies = [
            SimpleNamespace(ok=None),
            SimpleNamespace(ok=sample("a", bytes(MAX_PAYLOAD_BYTES + 1))),
            SimpleNamespace(ok=sample("a", b"1", attachment=b"x")),
        ]
        assert await session.get("topics/a", timeout_s=1.0) == [ZenohSample("a", b"1", b"x")]
        zenoh.replies = [SimpleNamespace(ok=sample("a"))] * (MAX_ANSWERS + 1)
        assert len(await session.get("topics/a", timeout_s=1.0)) == MAX_ANSWERS

    with_session(test)


@pytest.mark.parametrize(("zid", "name"), [("2b", "desk"), ("3c", ""), ("4d", "")])
def test_certificate_is_that_of_the_neighbour_of_the_id(zid: str, name: str) -> None:
    async def test(session: ZenohSession, zenoh: FakeZenoh) -> None:
        assert zenoh.options == {}
        assert (session.zid, session.certificate_of(zid)) == ("1a", name)

    with_session(test)


def test_publisher_sends_on_its_key_and_knows_its_subscribers() -> None:
    async def test(session: ZenohSession, zenoh: FakeZenoh) -> None:
        made = session.declare_publisher("a", is_urgent=True)
        assert (zenoh.options["a"]["express"], zenoh.options["a"]["priority"]) == (True, "real time")
        changes: list[bool] = []
        made.watch(changes.append)
        raw = zenoh.publishers["a"]
        for is_matching in (True, False):
            raw.is_matching = is_matching
            raw.notice(SimpleNamespace(matching=is_matching))
            await asyncio.sleep(0.01)
            assert changes[-1] is is_matching
        made.put(b"1", attachment=b"x")
        assert zenoh.puts == [("a", b"1", {"attachment": b"x"})]
        made.close()
        assert zenoh.options == {}

    with_session(test)


def test_publisher_reports_no_subscriber_after_its_end() -> None:
    async def test(session: ZenohSession, zenoh: FakeZenoh) -> None:
        made = session.declare_publisher("a")
        changes: list[bool] = []
        made.watch(changes.append)
        zenoh.publishers["a"].notice(SimpleNamespace(matching=True))  # in a thread of Zenoh's
        made.close()
        await asyncio.sleep(0.01)
        assert changes == []

    with_session(test)


def test_publisher_of_a_failed_session_sends_nothing() -> None:
    async def test(session: ZenohSession, zenoh: FakeZenoh) -> None:
        made = session.declare_publisher("a")
        zenoh.publishers["a"].is_matching = zenoh.has_failed = True
        made.put(b"1")
        assert zenoh.puts == []
        made.close()
        assert session.counts == {"failed": 2}
        with pytest.raises(ConfigError, match="b cannot be declared"):
            session.declare_publisher("b")

    with_session(test)


def test_query_is_answered_in_order_on_its_key_or_another_and_ended() -> None:
    async def test(session: ZenohSession, zenoh: FakeZenoh) -> None:
        queries: list[Query] = []
        declared = session.serve("a/**", queries.append)
        assert zenoh.options["a/**"] == {"complete": True}
        asked = FakeQuery("a/b", b"1", b"x")
        large = FakeQuery("a/b", bytes(MAX_PAYLOAD_BYTES + 1)), FakeQuery("a/b", b"", bytes(MAX_ATTACHMENT_BYTES + 1))
        for query in (asked, *large, FakeQuery("a/c")):
            zenoh.received["a/**"](query)
        await asyncio.sleep(0.01)
        assert [(each.payload, each.attachment) for each in queries] == [(b"1", b"x"), (b"", b"")]
        assert session.counts == {"oversized": 2}
        queries[0].reply(b"2")
        queries[0].reply(b"3", key="a/d", attachment=b"y")
        queries[0].close()
        assert asked.dropped.wait(10.0)
        assert asked.answers == [("a/b", b"2", None), ("a/d", b"3", b"y")]
        declared.close()
        assert zenoh.options == {}
        await session.aclose()
        queries[1].reply(b"late")  # its thread has ended

    with_session(test)


def test_closed_session_undeclares_nothing_and_logs_no_errors() -> None:
    async def test(session: ZenohSession, zenoh: FakeZenoh) -> None:
        declared = session.declare_token("alive/a")
        await session.aclose()
        assert zenoh.is_closed
        declared.close()
        assert "alive/a" in zenoh.options
        zenoh.has_failed = True
        with capture_logs() as logs:
            session.put("a", b"1")
        assert logged(logs) == []

    with_session(test)


def test_opened_session_is_closed_at_the_end_of_its_block(monkeypatch: pytest.MonkeyPatch) -> None:
    zenoh = FakeZenoh()
    monkeypatch.setattr(module, "library", lambda: zenoh)
    monkeypatch.setattr(module, "settings_of", lambda _: "settings")
    monkeypatch.setattr(module, "reach_of", lambda *_: ("loopback",))

    async def run(config: ZenohSettings) -> None:
        async with opened(config, Isolation(reraises=True).around) as session:
            assert (session.zid, zenoh.settings, zenoh.is_closed) == ("1a", "settings", False)
        assert zenoh.is_closed

    with capture_logs() as logs:
        run_virtual(run(ZenohSettings(name="lab")))
    assert logged(logs) == ["zenoh.opened", "zenoh.closed"]
    assert logs[0]["zid"] == "1a"
    zenoh.has_failed = True
    with pytest.raises(ConfigError, match="the session cannot be opened: session closed"):
        run_virtual(run(ZenohSettings(name="lab")))


def test_missing_library_is_named_with_its_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "zenoh", None)
    with pytest.raises(LibraryMissing, match="eclipse-zenoh"):
        library()
