"""The image of a sketch on an emulated Uno (simavr), with Arduino's core, against a daemon: int has 16 bits there."""

import pytest

from hostlink import client
from hostlink.config import Config
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
pytestmark = pytest.mark.quiet  # on a busy machine a second of the board lasts ten


@pytest.fixture(scope="module", autouse=True)
def _built() -> None:
    """Before the time limit of the first test starts."""
    once("uno_emulator", _compile, EMULATOR)
    for name in ("pubsub", "service_server", "parameters"):
        image(UNO, EXAMPLES / name / f"{name}.ino")


def _compile() -> None:
    sources = [HOST / "avr_emulator" / "uno.cpp", HOST / "any_board" / "tcp_socket.cpp"]
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


async def test_a_parameter_that_an_uno_has_no_room_for_is_refused() -> None:
    """65,586 is 50 in 16 bits, which is in the range of the example."""
    async with (
        daemon(Config(parameters={"/blink_ms": 65_586})) as host,
        client.connect(host.url) as connected,
        started(EMULATOR, flashed("parameters"), *host.tcp),
    ):
        await received(connected, "/rosout", "rosgraph_msgs/Log", lambda line: "parameter refused" in line["msg"])
