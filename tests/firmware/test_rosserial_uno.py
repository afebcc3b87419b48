"""The image of a sketch on an emulated Uno (simavr), with Arduino's core, against a daemon: int has 16 bits there."""

import subprocess
from collections.abc import Iterator

import pytest

from hostlink import client
from hostlink.core.config import Config
from hostlink.core.protocol import events
from hostlink.core.protocol.rosserial.session import Session
from tests.firmware.due import ROOT, ROSSERIAL
from tests.firmware.examples import BUILD, EXAMPLES
from tests.firmware.families import UNO, image
from tests.firmware.sketches import started
from tests.support.client_topics import publish_until, received
from tests.support.compilers import SKETCH, run
from tests.support.daemon import daemon
from tests.support.once import once
from tests.support.waiting import expect

HOST = ROOT / "firmware" / "host"
EMULATOR = BUILD / "uno_emulator"
SLOW_LOOP = ROOT / "firmware" / "tests" / "slow_loop" / "slow_loop.ino"
pytestmark = pytest.mark.quiet  # on a busy machine a second of the board lasts ten


@pytest.fixture(scope="module", autouse=True)
def _built() -> None:
    """Before the time limit of the first test starts."""
    once("uno_emulator", _compile, EMULATOR)
    for name in ("pubsub", "service_server", "parameters"):
        image(UNO, EXAMPLES / name / f"{name}.ino")
    image(UNO, SLOW_LOOP)


def _compile() -> None:
    sources = [HOST / "avr_emulator" / "uno.cpp", HOST / "any_board" / "tcp_socket.cpp"]
    EMULATOR.parent.mkdir(parents=True, exist_ok=True)
    run(["g++", *SKETCH, "-O2", f"-I{ROSSERIAL}", *sources, "-lsimavr", "-o", EMULATOR])


def flashed(name: str) -> str:
    return str(UNO.folder / f"{name}_{name}.elf")


async def test_topics_of_an_emulated_uno() -> None:
    async with (
        daemon() as host,
        client.connect(host.url) as connected,
        started(EMULATOR, flashed("pubsub"), *host.tcp) as board,
    ):
        await received(connected, "/chatter", "std_msgs/String", lambda text: text == {"data": "hello world!"})
        lit = board.expect("digital 13 1")
        await publish_until(connected, "/toggle_led", {}, "std_msgs/Empty", lit)


async def test_a_service_of_an_emulated_uno() -> None:
    async with (
        daemon() as host,
        client.connect(host.url) as connected,
        started(EMULATOR, flashed("service_server"), *host.tcp) as board,
    ):
        await expect(lambda: host.hub.services.is_offered("/switch_led"), timeout_s=15.0)
        for data, text in ((True, "on"), (False, "off")):
            assert await connected.call("/switch_led", {"data": data}) == {"success": True, "message": text}
            await board.expect(f"digital 13 {int(data)}")


class SteppedBoard:
    """An emulated Uno whose time passes only in `talk`, so that no machine is too slow."""

    STEP_MS = 10

    def __init__(self, name: str) -> None:
        command = [str(EMULATOR), flashed(name)]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.session = Session(check=lambda _: None)
        self.session.open(now_s=0.0)
        self._now_ms = 0

    @property
    def now_s(self) -> float:
        return self._now_ms / 1000

    def talk(self, seconds: float) -> Iterator[tuple[float, events.Event]]:
        """Let a session talk to the board for some seconds of the board. Yield its events with their times."""
        end_ms = self._now_ms + round(seconds * 1000)
        while self._now_ms < end_ms:
            frames = iter(lambda: self.session.pop_frame(now_s=self.now_s, wall_ns=10**18), None)
            sent = self._step(b"".join(each.frame for each in frames))
            found = self.session.receive(sent, now_s=self.now_s) if sent else []
            if self.session.deadline_s() <= self.now_s:
                found += self.session.tick(now_s=self.now_s)
            yield from ((self.now_s, event) for event in found)

    def _step(self, data: bytes) -> bytes:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(f"{self.STEP_MS} {data.hex()}\n")
        self._process.stdin.flush()
        self._now_ms += self.STEP_MS
        return bytes.fromhex(next(line for line in self._process.stdout if line.startswith("sent "))[5:])

    def close(self) -> None:
        self._process.communicate()  # the end of its input ends it


def test_sketch_whose_loop_takes_seconds_sends_whole_messages_in_each_turn() -> None:
    """Topics and messages are larger than the ring of the UART. What waited for the next turn came 2.5 s later."""
    board = SteppedBoard("slow_loop")
    found = list(board.talk(12.0))
    board.close()
    assert next(at_s for at_s, event in found if isinstance(event, events.TopicsNegotiated)) < 4.0
    assert {info.name for info in board.session.topics} == {"chatter", "counter", "toggle_led"}
    assert board.session.counts.topic_requests <= 2  # the first one came before the board had started
    texts, numbers = ([event for event in messages(found) if event[1] == name] for name in ("chatter", "counter"))
    counted = [int.from_bytes(payload, "little") for _, _, payload in numbers]
    assert len(counted) >= 3
    assert counted == list(range(counted[0], counted[0] + len(counted)))
    for (text_s, _, text), (number_s, _, _) in zip(texts, numbers, strict=True):
        assert b"pressure" in text
        assert number_s - text_s <= 0.03  # 12 bytes later on the line
    assert board.session.counts.skipped_bytes == 0


def messages(found: list[tuple[float, events.Event]]) -> list[tuple[float, str, bytes]]:
    """Time, topic and payload of each message."""
    return [(at_s, each.topic.name, each.payload) for at_s, each in found if isinstance(each, events.MessageReceived)]


async def test_a_parameter_that_an_uno_has_no_room_for_is_refused() -> None:
    """65,586 is 50 in 16 bits, which is in the range of the example."""
    async with (
        daemon(Config(parameters={"/blink_ms": 65_586})) as host,
        client.connect(host.url) as connected,
        started(EMULATOR, flashed("parameters"), *host.tcp),
    ):
        await received(connected, "/rosout", "rosgraph_msgs/Log", lambda line: "parameter refused" in line["msg"])
