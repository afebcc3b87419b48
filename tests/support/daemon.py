"""The daemon in the test's own process, on ports of its own.

The test and its devices stand still with this daemon on a busy machine, and what they send is not late by that. So the
daemon takes no velocity for a late one, and no pause interrupts its robots.
tests/unit/core/hub/test_stall_watch.py, test_gates.py, tests/integration/test_admission_contract.py (every way in) and
tests/system/test_daemon_stalls.py (a process) test lateness and pauses.
"""

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass, replace
from typing import Any, cast

import aiohttp
import msgspec

from hostlink.cli.serve import running
from hostlink.components.gateway.settings import ApiConfig
from hostlink.components.recorder.settings import BlackBoxConfig, RecordingConfig
from hostlink.core.config import Config, LinkConfig
from hostlink.core.hub.hub import Hub
from hostlink.core.hub.stall_watch import StallWatch
from hostlink.core.robot.events import EventKind, RobotEvent
from hostlink.core.runtime.host_pauses import HostPauses
from tests.support.driving import put_velocity

PATIENT = LinkConfig(silence_timeout_s=None, idle_timeout_s=None)


class PunctualWatch:
    """StallWatch that reports no lateness. Links still learn of pauses: a silent device is not at fault then."""

    def __init__(self, watch: StallWatch) -> None:
        self.beat, self.expect, self.pauses = watch.beat, watch.expect, watch.pauses
        self._watch = watch

    @property
    def noticed(self) -> HostPauses:
        return self._watch.noticed

    def late_s(self, _now_s: float) -> float:
        return 0.0

    def pop_pause(self, now_s: float) -> None:
        self._watch.pop_pause(now_s)


@dataclass
class Daemon:
    """A running daemon, and a client of its REST API."""

    hub: Hub
    tcp: tuple[str, int]
    url: str
    session: aiohttp.ClientSession
    udp: tuple[str, int] | None = None

    @property
    def was_paused(self) -> bool:
        """Whether this process stood still for a lease, which ends all driving. Any thread may ask."""
        stalls = self.hub.gates._stalls
        try:
            now_s = asyncio.get_running_loop().time()
        except RuntimeError:  # another thread: the loop notices its pauses without being asked
            return stalls.noticed.was_paused(0.0)
        return stalls.pauses(now_s).was_paused(0.0)

    async def rest(self, method: str, path: str, body: bytes | None = None) -> tuple[int, Any]:
        """(status, JSON)."""
        async with self.session.request(method, self.url + path, data=body) as response:
            return response.status, msgspec.json.decode(await response.read())

    async def drive(self, robot: str, body: bytes) -> None:
        """Send a velocity until it is obeyed (`put_velocity`)."""
        await put_velocity(self.session, f"{self.url}/api/robots/{robot}", body)

    async def get(self, path: str) -> Any:
        """The JSON of a GET that must succeed."""
        status, body = await self.rest("GET", path)
        assert status == 200, body
        return body


def stops_of(host: Daemon, robot: str) -> list[object]:
    """Return the list of reasons for which drives of a robot end from now on."""
    reasons: list[object] = []

    def note(event: RobotEvent) -> None:
        if event.kind is EventKind.STOPPED and event.robot == robot:
            reasons.append(event.facts["reason"])

    host.hub.events.observe("stops", note)
    return reasons


@contextlib.asynccontextmanager
async def daemon(
    config: Config | None = None,
    *,
    has_black_box: bool = False,
    read: Callable[[], Config] | None = None,
) -> AsyncIterator[Daemon]:
    """Run a daemon within the block. Without a black box, only the test subscribes to topics.

    `read`: its configuration file, which a reload reads.
    """

    def on_free_ports(config: Config) -> Config:
        black_box = config.table("black_box", BlackBoxConfig) if has_black_box else BlackBoxConfig(enabled=False)
        recording = config.table("recording", RecordingConfig)
        recording = replace(recording, drives=recording.drives and has_black_box)
        # A fake device sends what its test says, and no more: its silence lasts for as long as the machine is busy.
        link = PATIENT if config.link == LinkConfig() else config.link
        tcp, api = replace(config.tcp, host="127.0.0.1", port=0), replace(config.table("api", ApiConfig), port=0)
        return replace(config, tcp=tcp, link=link).with_tables(black_box=black_box, recording=recording, api=api)

    read_again = None if read is None else (lambda: on_free_ports(read()))
    async with (
        running(on_free_ports(Config() if config is None else config), read=read_again) as (hub, addresses),
        aiohttp.ClientSession() as session,
    ):
        hub.gates._stalls = cast(StallWatch, PunctualWatch(hub.gates._stalls))
        yield Daemon(hub, addresses.tcp, addresses.api, session, addresses.udp)
