"""Byte budget of everything that clients make the daemon keep, and its release."""

import asyncio

import msgspec
import pytest

from hostlink.components.gateway.settings import ApiConfig
from hostlink.core.config import Config
from hostlink.core.hub.byte_budget import OWN_LATCHED_BYTES, SHARES
from tests.support.api_loads import frame, websocket_head
from tests.support.daemon import daemon
from tests.support.rosbridge import client
from tests.support.waiting import expect

BODY = "x" * 1_000_000


async def test_latched_messages_over_the_budget_are_delivered_and_not_kept_and_all_is_given_back() -> None:
    async with daemon() as host, client(host) as listener:
        await listener.send(op="subscribe", topic="/latched_5", type="std_msgs/String")
        latched = host.hub.budget["latched"]
        async with client(host) as program:
            for number in range(6):
                wire = {"op": "publish", "id": f"{number}", "topic": f"/latched_{number}", "latch": True}
                await program.send(**wire, type="std_msgs/String", msg={"data": BODY})
            refused = await program.receive()
            assert refused["id"] == "4"
            assert f"a participant may latch {OWN_LATCHED_BYTES} bytes" in refused["msg"]
            assert (await listener.receive())["msg"]["data"] == BODY
            assert OWN_LATCHED_BYTES - len(BODY) < latched.held_bytes <= OWN_LATCHED_BYTES
            metrics = await (await host.session.get(host.url + "/metrics")).text()
            assert 'hostlink_kept_bytes{kind="latched"}' in metrics
            assert 'hostlink_kept_refused_total{kind="latched"} 2.0' in metrics
        await expect(lambda: latched.held_bytes == 0)


async def test_pieces_calls_watches_and_what_waits_are_given_back_when_a_client_leaves() -> None:
    async with daemon() as host:
        async with client(host) as server, client(host) as program:
            await server.send(op="advertise_service", service="/slow", type="std_srvs/SetBool")
            await expect(lambda: "/slow" in host.hub.services.names())
            await program.send(op="fragment", id="1", num=0, total=2, data=BODY)
            await program.send(op="call_service", id="2", service="/slow", args={"data": True})
            async with host.session.ws_connect(host.url, protocols=("foxglove.sdk.v1",)) as watcher:
                names = [f"/{number}" * 100 for number in range(100)]
                await watcher.send_bytes(b"")
                request = {"op": "subscribeParameterUpdates", "parameterNames": names}
                await watcher.send_str(msgspec.json.encode(request).decode())
                for kind in ("fragments", "calls", "watches"):
                    await expect(lambda kind=kind: host.hub.budget[kind].held_bytes > 0)  # type: ignore[misc]
        await expect(lambda: not any(share.held_bytes for share in host.hub.budget.shares.values()))


async def test_message_larger_than_the_budget_occupies_all_of_it_alone() -> None:
    config = Config().with_tables(api=ApiConfig(max_message_bytes=2 * SHARES["receiving"]))
    async with daemon(config) as host, client(host) as large:
        await large.send(op="publish", topic="/large", type="std_msgs/String", msg={"data": BODY})
        assert await large.call("/rosapi/topic_type", topic="/large") == {"type": "std_msgs/String"}
        await expect(lambda: host.hub.budget["receiving"].held_bytes == 0)


@pytest.mark.parametrize("broken", [frame(b"\xff\xfe\xfd"), frame(b"x", 3)], ids=["text", "kind"])
async def test_a_frame_that_is_broken_closes_its_client_alone(broken: bytes, caplog: pytest.LogCaptureFixture) -> None:
    async with daemon() as host:
        reader, writer = await asyncio.open_connection("127.0.0.1", int(host.url.rpartition(":")[2]))
        writer.write(websocket_head("") + broken)
        await reader.readuntil(b"\r\n\r\n")
        assert (await reader.read())[:1] == b"\x88"  # a frame that closes
        writer.close()
        assert (await host.rest("GET", "/healthz"))[0] == 200
    assert not [record for record in caplog.records if record.exc_info]


def test_the_shares_together_leave_room_for_the_daemon() -> None:
    """docs/reliability.md promises 250 MiB, of which the daemon itself has 80."""
    assert sum(SHARES.values()) <= 120 * 1024 * 1024
