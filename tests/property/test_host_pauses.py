"""A host that pauses or restarts reports no healthy device, and still finds a faulty one afterwards."""

import asyncio
import contextlib
import math
from dataclasses import dataclass, field

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from hostlink.core.config import Config
from hostlink.core.diagnosis.evidence import HostClock
from hostlink.core.hub.hub import Hub
from hostlink.core.messages.catalog import Catalog
from hostlink.core.protocol.rosserial.control import encode_topic_info
from hostlink.core.protocol.rosserial.frame import Frame, Id, encode
from hostlink.core.protocol.rosserial.protocol import ROSSERIAL
from hostlink.core.protocol.rosserial.stream import FrameStream
from hostlink.core.robot.events import EventKind, RobotEvent
from tests.support.fake_device import pose, robot_topics
from tests.support.memory_transport import MemoryTransport, memory_pair
from tests.support.strategies import fewer_examples
from tests.support.virtual_loop import VirtualLoop, run_virtual

CATALOG = Catalog()
ROOM_BYTES = 1 << 20  # of a kernel: bytes that arrive during a pause of the host wait here
TIME = encode(Id.TIME, bytes(8))
ANNOUNCEMENT = TIME + b"".join(encode(info.kind, encode_topic_info(info)) for info in robot_topics())
UNANSWERED_S = 11.0  # docs/protocol.md#time: afterwards a device stops publishing
POLL_S, POSE_S = 0.1, 0.2
FINDABLE_S = 40.0  # all findings use the last 30 s


@dataclass
class Device:
    """Robot that publishes all the time. Unsent bytes wait in the ring of its WiFi module."""

    time_period_s: float = 2.5
    damages_every: int = 0  # one damaged byte per this many frames; 0: none
    ring_bytes: int = 5840  # lwIP's send buffer; the oldest bytes are lost
    is_mute: bool = False
    end: MemoryTransport | None = None
    _ring: bytes = b""
    _is_configured: bool = False
    _answered_s: float = 0.0
    _next_time_s: float = math.inf
    _next_pose_s: float = math.inf
    _poses: int = 0
    _stream: FrameStream = field(default_factory=FrameStream)

    async def run(self) -> None:
        """Do everything that is due. After a pause of the loop, all due work is done at once."""
        now_s = asyncio.get_running_loop().time
        while True:
            await asyncio.sleep(POLL_S)
            self._ring += b"" if self.is_mute else self._due(now_s())
            if self.end is None:
                self._ring = self._ring[-self.ring_bytes :]
            else:
                with contextlib.suppress(OSError):
                    self.end.write(self._ring)
                self._ring = b""

    async def connect(self, hub: Hub) -> None:
        """Serve a host until it ends the connection."""
        host_end, self.end = memory_pair(room_bytes=ROOM_BYTES)
        hub.spawn(hub.links.serve(hub.links.open(host_end, ROSSERIAL)), name="link")
        while data := await self.end.receive():
            for frame in self._stream.feed(data):
                self._read(frame, asyncio.get_running_loop().time())
        self.end = None

    def _read(self, frame: object, now_s: float) -> None:
        assert isinstance(frame, Frame)
        if frame.topic_id == Id.TIME:
            self._answered_s = now_s
        elif frame.topic_id == Id.PUBLISHER and not self.is_mute:
            self._ring += ANNOUNCEMENT
            self._is_configured, self._answered_s = True, now_s
            self._next_time_s, self._next_pose_s = now_s + self.time_period_s, now_s + POSE_S

    def _due(self, now_s: float) -> bytes:
        data = bytearray()
        while self._is_configured and (at_s := min(self._next_time_s, self._next_pose_s)) <= now_s:
            if at_s > self._answered_s + UNANSWERED_S:
                self._is_configured = False
            elif at_s == self._next_time_s:
                self._next_time_s += self.time_period_s
                data += TIME
            else:
                self._next_pose_s += POSE_S
                self._poses += 1
                wire = bytearray(pose(self._poses / 50))  # at 0.1 m/s
                if self.damages_every and self._poses % self.damages_every == 0:
                    wire[20] ^= 0x10
                data += wire
        return bytes(data)


class SteadyClock(HostClock):
    """Wall clock that follows virtual time."""

    def check(self, now_s: float, wall_ns: int) -> str:  # noqa: ARG002 - as the real one
        return ""


@dataclass
class Findings:
    """Findings with their times, and the number of ended links."""

    codes: list[tuple[float, str]] = field(default_factory=list)
    ends: list[str] = field(default_factory=list)

    def observe(self, event: RobotEvent) -> None:
        if event.kind is EventKind.DIAGNOSED:
            self.codes.append((event.at_s, str(event.facts["code"])))
        elif event.kind is EventKind.LINK_CLOSED:
            self.ends.append(str(event.facts["reason"]))


@dataclass(frozen=True)
class Pause:
    """The host's process stops for a time, after it has run for a while."""

    after_s: float
    lasts_s: float


@dataclass(frozen=True)
class Restart:
    """The host's process is absent for a time, while the device continues."""

    after_s: float
    lasts_s: float


waits = st.floats(0.3, 9.0)
pauses = st.builds(Pause, waits, st.floats(0.6, 25.0))
restarts = st.builds(Restart, waits, st.floats(0.1, 25.0))
disturbances = st.lists(pauses | restarts, min_size=1, max_size=6)


async def live(device: Device, disturbed: list[Pause | Restart], findings: Findings, *, then_s: float) -> float:
    """Run one device and its hosts. Return the end of the last disturbance."""
    loop = asyncio.get_running_loop()
    assert isinstance(loop, VirtualLoop)
    over_s = 0.0
    async with asyncio.TaskGroup() as tasks:
        running = tasks.create_task(device.run())
        rest = list(disturbed)
        while True:
            hub = Hub(Config(), CATALOG, reraises=True)
            hub.diagnoses._clock = SteadyClock()
            hub.events.observe("test", findings.observe)
            serving = tasks.create_task(hub.run())
            await hub.is_running.wait()
            talking = tasks.create_task(device.connect(hub))
            away = None
            while rest and away is None:
                what = rest.pop(0)
                await asyncio.sleep(what.after_s)
                if isinstance(what, Restart):
                    away = what
                else:
                    loop.burn(what.lasts_s)  # in the next round the timers are due and nothing is read yet
                    await asyncio.sleep(0)
                over_s = loop.time()
            if away is None:
                await asyncio.sleep(then_s)
            hub.events.leave("test")
            serving.cancel()
            await asyncio.sleep(0.01)
            talking.cancel()
            device.end = None
            if away is None:
                running.cancel()
                return over_s
            await asyncio.sleep(away.lasts_s)
            over_s = loop.time()
    raise AssertionError("the group ends by `return` alone")


@pytest.mark.slow
@fewer_examples(2)
@given(disturbances, st.sampled_from([64, 777, 5840, 1 << 20]))
@example([Pause(6.0, 9.0)], 5840)
@example([Pause(2.0, 12.0)] * 4, 5840)
@example([Restart(6.0, 9.0)], 1 << 20)
@example([Restart(6.0, 3.0)] * 5, 777)
def test_host_pauses_and_restarts_cause_no_finding_about_a_healthy_device(
    disturbed: list[Pause | Restart], ring_bytes: int
) -> None:
    findings = Findings()
    run_virtual(live(Device(ring_bytes=ring_bytes), disturbed, findings, then_s=15.0))
    assert findings.codes == []
    assert "idle" not in findings.ends


SICK = {
    "clock_trouble": {"time_period_s": 2.2},
    "time_stopped": {"time_period_s": math.inf},
    "damaged": {"damages_every": 7},
}


BESIDE = {"damaged": {"boot_noise"}}  # damage at the beginning of a link looks like a boot message


@pytest.mark.slow
@pytest.mark.parametrize("code", SICK)
@fewer_examples(5)
@given(disturbed=disturbances)
@example([Pause(1.5, 10.0)])
@example([Pause(1.5, 1.0), Pause(7.0, 10.0)])
def test_sick_device_is_found_after_the_host_has_recovered(code: str, disturbed: list[Pause | Restart]) -> None:
    findings = Findings()
    run_virtual(live(Device(**SICK[code]), disturbed, findings, then_s=FINDABLE_S))  # type: ignore[arg-type]
    found = {each for _, each in findings.codes}
    assert code in found
    assert found <= {code, *BESIDE.get(code, ())}


@fewer_examples(5)
@given(disturbed=disturbances, wait_s=st.floats(0.0, 4.0))
def test_device_that_falls_silent_is_found_once_after_the_host_has_recovered(
    disturbed: list[Pause | Restart], wait_s: float
) -> None:
    findings, device = Findings(), Device()

    async def fall_silent() -> None:
        await asyncio.sleep(sum(each.after_s + each.lasts_s for each in disturbed) + 8.0 + wait_s)
        device.is_mute = True

    async def run() -> None:
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(fall_silent())
            await live(device, disturbed, findings, then_s=FINDABLE_S)

    run_virtual(run())
    assert [found for _, found in findings.codes] == ["went_silent"]
    assert findings.ends[-1] == "idle"
