"""The OpenAPI document: true for every request that schemathesis thinks of, and complete."""

import asyncio
import json
from pathlib import Path
from typing import Any

import schemathesis
from hypothesis import HealthCheck, Phase, given, settings

from hostlink.components.gateway.settings import ApiConfig
from hostlink.core.config import Config
from hostlink.core.robot.command_endpoint import CommandEndpoint
from hostlink.errors import DeviceGone
from tests.support.daemon import daemon
from tests.support.fake_device import fake_device, pose, robot_topics
from tests.support.remote_robots import RecordingHosts, reach

EXAMPLES = 8  # a path
PROMISED = Path(__file__).with_name("openapi.json")
GENEROUS = Config().with_tables(api=ApiConfig(max_requests_s=1e6))


def try_everything(url: str, document: dict[str, Any]) -> list[str]:
    """Call every operation with data that fits the document and data that does not; returns what was called."""
    schema = schemathesis.openapi.from_dict(document)
    called = []
    for result in schema.get_all_operations():
        operation = result.ok()
        if "text/event-stream" in str(operation.definition.raw):
            continue  # it does not end by itself; it has tests of its own
        if "'binary'" in str(operation.definition.raw):
            continue  # a schema cannot describe an MCAP file: tests/integration/test_recordings.py

        @settings(
            max_examples=EXAMPLES,
            deadline=None,
            database=None,
            phases=[Phase.generate],
            suppress_health_check=list(HealthCheck),
        )
        @given(operation.as_strategy())
        def check(case: schemathesis.Case) -> None:
            case.call_and_validate(base_url=url)

        check()
        called.append(operation.label)
    return called


async def test_the_document_is_the_promised_one() -> None:
    """A change of the public JSON changes this file: its difference shows keys, units and what may be null."""
    async with daemon() as host:
        document = await host.get("/api/openapi.json")
    del document["info"]["version"]
    assert json.dumps(document, indent=1) + "\n" == PROMISED.read_text()


async def test_the_document_is_true() -> None:
    async with daemon(GENEROUS, has_black_box=True) as host, fake_device(host.tcp, robot_topics()) as device:
        await device.send(pose(1.0, 2.0, 0.5))
        document = await host.get("/api/openapi.json")
        called = await asyncio.to_thread(try_everything, host.url, document)
        assert len(called) >= 12
        assert (await host.get("/healthz"))["status"] == "alive"
        assert (await host.get("/api/links"))["crashes"] == 0


class Silent(RecordingHosts):
    """Another daemon of the fleet, which has not answered in time."""

    async def settled(self) -> list[CommandEndpoint]:
        raise DeviceGone("lab-2", "it has not answered")


async def test_a_daemon_of_the_fleet_that_does_not_answer_is_in_the_document() -> None:
    paths = ["/api/stop", *(f"/api/robots/{{name}}/{verb}" for verb in ("stop", "lock", "unlock"))]
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device:
        await device.send(pose(1.0, 2.0, 0.5))
        document = await host.get("/api/openapi.json")
        provision = reach(host.hub, Silent())
        for path in paths:
            assert (await host.rest("POST", path.format(name="robot_0")))[0] == 503, path
            assert "503" in document["paths"][path]["post"]["responses"]
        host.hub.gates.providers.remove(provision)
