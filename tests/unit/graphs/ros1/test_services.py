"""Services of the hub for ROS nodes, without sockets."""

import asyncio
from collections.abc import Mapping

import pytest

from hostlink.graphs.ros1 import services
from hostlink.graphs.ros1.services import ServiceOffer
from hostlink.graphs.ros1.tcpros import encode_answer, encode_failure
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
        assert wire.sent == [answered(), encode_failure("/enable: no"), answered()]
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
        assert [data[:1] for data in wire.sent] == [b"\x00"]
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
        made.accept(wires[3].wire, HEADER)
        assert wires[3].refusals == ["more than 2 callers of /ros_enable"]
        await asyncio.sleep(0.5)
        assert wires[0].sent == [answered()]
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


def test_caller_with_wrong_md5_sum_is_refused() -> None:
    async def test(scene: Scene) -> None:
        made, wire = offer(scene), FakeWire()
        made.accept(wire.wire, HEADER | {"md5sum": "0"})
        assert "not 0" in wire.refusals[0]
        assert made._node.counts.refused_headers == 1

    play(test)
