"""Captures over REST: the whole capture of a link, pieces after a position, and ended links."""

import asyncio
import json
from collections.abc import Awaitable, Callable

import pytest

from hostlink.components.gateway.captures import Captures
from hostlink.core.link.capture_buffer import CAPTURE_BYTES
from tests.support.participants import ODOMETRY_ID, POSE
from tests.support.rest_memory import RestMemory, rest_memory
from tests.support.virtual_loop import inside, run_virtual

PATH = "/api/links/1/capture"


def check(test: Callable[[RestMemory], Awaitable[None]]) -> None:
    async def run() -> None:
        async with rest_memory() as api:
            api.add(Captures(api.host.devices).routes())
            await test(api)

    run_virtual(run())


def sent_by_device(body: dict[str, object]) -> bytes:
    reads = body["reads"]
    assert isinstance(reads, list)
    return b"".join(bytes.fromhex(read["hex"]) for read in reads if read["dir"] == "device")


@inside(check)
async def test_capture_after_a_position_has_only_newer_bytes(api: RestMemory) -> None:
    status, first = await api.call("GET", f"{PATH}/0-0")
    assert (status, first["lost_bytes"], first["is_open"]) == (200, 0, True)
    assert first["reads"][0] == {"t": 0.0, "dir": "device", "hex": "", "conn": 1, "event": "open"}
    assert {read["dir"] for read in first["reads"]} == {"device", "host"}
    from_device, to_device = map(int, first["position"].split("-"))
    assert from_device == len(sent_by_device(first))
    await api.move_to(1.0, 2.0, 0.5)
    _, second = await api.call("GET", f"{PATH}/{first['position']}")
    assert POSE.pack(1.0, 2.0, 0.5) in sent_by_device(second)
    assert all("event" not in read for read in second["reads"])
    assert all(read["conn"] == 1 and 0.4 < read["t"] < 0.6 for read in second["reads"])
    assert second["position"].split("-")[0] == str(from_device + len(sent_by_device(second)))
    assert int(second["position"].split("-")[1]) >= to_device


@inside(check)
async def test_capture_that_lost_its_beginning_starts_with_the_announced_topics(api: RestMemory) -> None:
    for _ in range(CAPTURE_BYTES // POSE.size):
        await api.device.send(ODOMETRY_ID, POSE.pack(1.0, 2.0, 0.5))
    await asyncio.sleep(1.0)
    _, body = await api.call("GET", f"{PATH}/0-0")
    assert body["lost_bytes"] > 0
    assert [read["event"] for read in body["reads"][:2]] == ["open", "topics"]
    assert b"/robot_0/odometry" in bytes.fromhex(body["reads"][1]["hex"])
    times_s = [read["t"] for read in body["reads"]]
    assert times_s == sorted(times_s)


@inside(check)
async def test_capture_of_an_ended_link_ends_with_its_duration(api: RestMemory) -> None:
    await asyncio.sleep(1.5)
    await api.device.aclose()
    await asyncio.sleep(1.0)
    _, body = await api.call("GET", f"{PATH}/0-0")
    last = body["reads"][-1]
    assert (last["event"], last["hex"], body["is_open"]) == ("close", "", False)
    assert 2.0 <= last["t"] < 2.2


@pytest.mark.parametrize(
    ("path", "reason"),
    [
        ("/api/links/7/capture", "no link named 7; known: 1"),
        ("/api/links/one/capture", "no link named one"),
        (f"/api/links/{'1' * 19}/capture", "no link named 1"),
        (f"{PATH}/7", "no position named 7"),
        (f"{PATH}/x-0", "no position named x-0"),
        (f"{PATH}/0-x", "no position named 0-x"),
    ],
)
@inside(check)
async def test_capture_of_an_unknown_link_or_position_is_answered_404(api: RestMemory, path: str, reason: str) -> None:
    status, body = await api.call("GET", path)
    assert status == 404
    assert reason in body["error"]["reason"]


@inside(check)
async def test_whole_capture_is_one_json_line_for_each_read(api: RestMemory) -> None:
    _, body = await api.call("GET", f"{PATH}/0-0")
    _, lines = await api.call_raw("GET", PATH)
    assert [json.loads(line) for line in lines.splitlines()] == body["reads"]
