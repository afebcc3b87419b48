"""Services of the hub for ROS nodes, without sockets."""

import asyncio
from collections.abc import Mapping

import pytest
from structlog.testing import capture_logs

from hostlink.components.ros1 import services
from hostlink.components.ros1.services import ForeignService, ServiceOffer
from hostlink.components.ros1.tcpros import (
    BadHeader,
    decode_header,
    encode_answer,
    encode_failure,
    encode_header,
    encode_message,
)
from tests.support.fake_device import CATALOG
from tests.support.participants import Scene, play
from tests.support.ros1.wireless import FakeWire, local_node

SET_BOOL = CATALOG.service("std_srvs/SetBool")
assert SET_BOOL is not None
HEADER = {"callerid": "/caller", "md5sum": SET_BOOL.md5, "service": "/ros_enable"}


def offer(scene: Scene) -> ServiceOffer:
    assert SET_BOOL is not None
    node, _ = local_node(scene.hub, scene.tasks)

    async def answer(request: Mapping[str, object]) -> Mapping[str, object]:
        await asyncio.sleep(0.1)
        if not request["data"]:
            raise services.ServiceFailed("/enable", "no")
        return {"success": True, "message": "done"}

    scene.neighbour.provide("/enable", "std_srvs/SetBool", answer)
    return ServiceOffer(node, "/enable", "/ros_enable", SET_BOOL)


def answered() -> bytes:
    assert SET_BOOL is not None
    return encode_answer(SET_BOOL.response.encode({"success": True, "message": "done"}))


def test_calls_of_one_connection_are_answered_in_their_order() -> None:
    async def test(scene: Scene) -> None:
        made, wire = offer(scene), FakeWire()
        made.accept(wire.wire, HEADER)
        assert (wire.headers[0]["type"], wire.headers[0]["service"]) == ("std_srvs/SetBool", "/ros_enable")
        wire.receive([b"\x01", b"\x00"])
        wire.receive([b"\x01"])
        await asyncio.sleep(0.5)
        assert wire.answers == [answered(), encode_failure("/enable: no"), answered()]
        assert made._node.counts.failed_services == 1
        made.close()
        assert made.callers == {}

    play(test)


def test_malformed_request_is_answered_with_a_failure() -> None:
    async def test(scene: Scene) -> None:
        made, wire = offer(scene), FakeWire()
        made.accept(wire.wire, HEADER)
        wire.receive([b"too long"])
        await asyncio.sleep(0.5)
        assert [data[:1] for data in wire.answers] == [b"\x00"]
        made.close()

    play(test)


def test_probe_receives_the_type_and_holds_no_place() -> None:
    async def test(scene: Scene) -> None:
        made, wire = offer(scene), FakeWire()
        made.accept(wire.wire, HEADER | {"probe": "1", "md5sum": "*"})
        assert wire.headers[0]["md5sum"] == HEADER["md5sum"]
        assert (wire.is_closed, made.callers) == (True, {})

    play(test)


def test_caller_over_the_bound_takes_the_place_of_the_oldest_idle_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(services, "MAX_CALLERS", 2)

    async def test(scene: Scene) -> None:
        made, wires = offer(scene), [FakeWire() for _ in range(4)]
        made.accept(wires[0].wire, HEADER)
        made.accept(wires[1].wire, HEADER)
        wires[0].receive([b"\x01"])
        made.accept(wires[2].wire, HEADER)
        assert [wire.is_closed for wire in wires] == [False, True, False, False]
        assert made._node.counts.crowded_out == 1
        wires[2].receive([b"\x01"])
        with pytest.raises(BadHeader, match="more than 2 callers of /ros_enable"):
            made.accept(wires[3].wire, HEADER)
        await asyncio.sleep(0.5)
        assert wires[0].answers == [answered()]
        made.close()

    play(test)


def test_caller_with_too_many_waiting_calls_is_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(services, "MAX_WAITING", 2)

    async def test(scene: Scene) -> None:
        made, wire = offer(scene), FakeWire()
        made.accept(wire.wire, HEADER)
        wire.receive([b"\x01"] * 2)
        assert not wire.is_closed
        wire.receive([b"\x01"] * 2)
        assert wire.is_closed
        assert made._node.counts.failed_services >= 1

    play(test)


def test_caller_that_is_cut_off_because_it_reads_no_answers_is_counted_and_logged_once() -> None:
    async def test(scene: Scene) -> None:
        made = offer(scene)
        with capture_logs() as lines:
            for is_too_slow in (True, True, False):
                wire = FakeWire()
                made.accept(wire.wire, HEADER)
                wire.outgoing.is_too_slow = is_too_slow
                wire.close()
        assert made._node.counts.failed_services == 2
        (line,) = lines
        assert (line["event"], line["service"], line["caller"]) == (
            "ros1.caller_too_slow",
            "/ros_enable",
            "/caller",
        )

    play(test)


def test_caller_with_wrong_md5_sum_is_refused() -> None:
    async def test(scene: Scene) -> None:
        made, wire = offer(scene), FakeWire()
        with pytest.raises(BadHeader, match="not 0"):
            made.accept(wire.wire, HEADER | {"md5sum": "0"})
        assert (wire.headers, made.callers) == ([], {})

    play(test)


# -- services of other nodes ------------------------------------------------------------------------------------------


class FakeWriter:
    """Writer of a connection that keeps what is written."""

    def __init__(self) -> None:
        self.written = b""
        self.is_aborted = False
        self.transport = self

    def write(self, data: bytes) -> None:
        self.written += data

    def abort(self) -> None:
        self.is_aborted = True


class Foreign:
    """A node of ROS that offers /ros_enable. `answers`: what it sends on each connection."""

    def __init__(self, scene: Scene, monkeypatch: pytest.MonkeyPatch, *answers: bytes) -> None:
        assert SET_BOOL is not None
        self.node, self.rpc = local_node(scene.hub, scene.tasks)
        self.rpc.answer = lambda _uri, _method: "rosrpc://there:4000"
        self.writers: list[FakeWriter] = []
        self._answer = b"".join(answers)
        monkeypatch.setattr(services.asyncio, "open_connection", self._open)

    async def _open(self, host: str, port: int) -> tuple[asyncio.StreamReader, FakeWriter]:
        assert (host, port) == ("there", 4000)
        reader, writer = asyncio.StreamReader(), FakeWriter()
        reader.feed_data(self._answer)
        reader.feed_eof()
        self.writers.append(writer)
        return reader, writer

    def offer(self) -> ForeignService:
        assert SET_BOOL is not None
        return ForeignService(self.node, "/enable", "/ros_enable", SET_BOOL)


RESPONSE_HEADER = encode_header({"callerid": "/there", "md5sum": HEADER["md5sum"], "type": "std_srvs/SetBool"})


def test_call_of_another_nodes_service_sends_header_and_request(monkeypatch: pytest.MonkeyPatch) -> None:
    async def test(scene: Scene) -> None:
        assert SET_BOOL is not None
        foreign = Foreign(scene, monkeypatch, RESPONSE_HEADER, answered())
        made = foreign.offer()
        assert await scene.neighbour.call("/enable", {"data": True}) == {"success": True, "message": "done"}
        assert foreign.rpc.calls == [(foreign.node.master_uri, "lookupService", ("/hostlink", "/ros_enable"))]
        (writer,) = foreign.writers
        assert writer.is_aborted
        size = int.from_bytes(writer.written[:4], "little")
        assert decode_header(writer.written[4 : 4 + size]) == {
            "callerid": "/hostlink",
            "service": "/ros_enable",
            "md5sum": SET_BOOL.md5,
            "type": "std_srvs/SetBool",
        }
        assert writer.written[4 + size :] == encode_message(b"\x01")
        made.close()
        with pytest.raises(services.HostlinkError, match="enable"):
            await scene.neighbour.call("/enable", {"data": True})

    play(test)


@pytest.mark.parametrize(
    ("answers", "reason"),
    [
        ((RESPONSE_HEADER, encode_failure("not now")), "not now"),
        ((encode_header({"error": "no such service"}),), "no such service"),
        ((RESPONSE_HEADER, b"\x01"), "expected"),
        ((RESPONSE_HEADER, b"\x01\xff\xff\xff\xff"), "an answer of 4294967295 bytes, over"),
        ((b"\xff\xff\xff\xff",), "an answer of 4294967295 bytes, over"),
        ((RESPONSE_HEADER, b"\x01\x01\x00\x00\x00x"), "std_srvs/SetBoolResponse"),
    ],
)
def test_failed_call_of_another_nodes_service_has_its_reason(
    monkeypatch: pytest.MonkeyPatch, answers: tuple[bytes, ...], reason: str
) -> None:
    async def test(scene: Scene) -> None:
        foreign = Foreign(scene, monkeypatch, *answers)
        made = foreign.offer()
        with pytest.raises(services.HostlinkError, match=reason):
            await scene.neighbour.call("/enable", {"data": True})
        assert all(writer.is_aborted for writer in foreign.writers)
        made.close()

    play(test)


@pytest.mark.parametrize("address", ["http://there:4000", "rosrpc://there", "rosrpc://:4000", 7])
def test_service_without_an_address_fails(monkeypatch: pytest.MonkeyPatch, address: object) -> None:
    async def test(scene: Scene) -> None:
        foreign = Foreign(scene, monkeypatch)
        foreign.rpc.answer = lambda _uri, _method: address
        made = foreign.offer()
        with pytest.raises(services.ServiceFailed, match="not of the form rosrpc://HOST:PORT"):
            await scene.neighbour.call("/enable", {"data": True})
        assert foreign.node.counts.failed_services == 1
        made.close()

    play(test)


def test_type_of_another_nodes_service_is_asked_for_with_a_probe(monkeypatch: pytest.MonkeyPatch) -> None:
    async def test(scene: Scene) -> None:
        foreign = Foreign(scene, monkeypatch, RESPONSE_HEADER)
        assert await services.find_type(foreign.node, "/ros_enable") == ("std_srvs/SetBool", HEADER["md5sum"])
        (writer,) = foreign.writers
        header = decode_header(writer.written[4:])
        assert (header["probe"], header["md5sum"], writer.is_aborted) == ("1", "*", True)

    play(test)


def test_name_of_the_daemons_own_service_is_refused_and_nothing_joins(monkeypatch: pytest.MonkeyPatch) -> None:
    async def test(scene: Scene) -> None:
        async def answer(_: Mapping[str, object]) -> Mapping[str, object]:
            return {}

        daemon = scene.hub.join_daemon()
        daemon.provide("/enable", "std_srvs/SetBool", answer)
        foreign = Foreign(scene, monkeypatch)
        joined, join = [], foreign.node.join
        monkeypatch.setattr(foreign.node, "join", lambda who: joined.append(join(who)) or joined[-1])
        with pytest.raises(services.HostlinkError):
            foreign.offer()
        assert [each.has_left for each in joined] == [True]

    play(test)
