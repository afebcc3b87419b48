"""Each example of firmware/rosserial against a real daemon: what a user sees who builds it."""

import asyncio
import base64
import contextlib
import math
import re
import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest

from hostlink import client
from hostlink.core.config import Config, TcpConfig
from hostlink.core.messages.catalog import Catalog
from hostlink.core.protocol.rosserial.frame import OVERHEAD_BYTES, TOPICS_REQUEST
from tests.firmware.examples import EXAMPLES
from tests.firmware.sketches import KEY, WITH_KEY, build, running
from tests.support.client_topics import publish_until, received
from tests.support.daemon import daemon as in_process
from tests.support.process import Process, free_port, serve
from tests.support.tcp_server import tcp_server
from tests.support.waiting import expect

NOTHING = (math.inf, None)  # a range: REST has no infinity


@pytest.fixture(scope="module", autouse=True)
def built() -> None:
    """Compiled before the time limit of the first test starts."""
    build("pubsub")


@pytest.fixture
async def daemon(tmp_path: Path) -> AsyncIterator[Process]:
    settings = tmp_path / "hostlink.toml"
    settings.write_text('[parameters]\n"/blink_ms" = 50\n"/text" = "from the host"\n')
    async with serve("--config", str(settings)) as started:
        yield started


async def test_pubsub(daemon: Process) -> None:
    async with client.connect(daemon.url) as host, running("pubsub", daemon.tcp) as board:
        assert await received(host, "/chatter", "std_msgs/String") == {"data": "hello world!"}
        await host.publish("/toggle_led", {}, type_name="std_msgs/Empty")
        await board.expect("digital 13 1")


@pytest.mark.long
async def test_hello_world(daemon: Process) -> None:
    async with client.connect(daemon.url) as host, running("hello_world", daemon.tcp):
        assert await received(host, "/chatter", "std_msgs/String") == {"data": "hello world!"}


async def test_blink(daemon: Process) -> None:
    async with client.connect(daemon.url) as host, running("blink", daemon.tcp) as board:
        for data in (True, False):
            message, done = {"data": data}, board.expect(f"digital 13 {int(data)}")
            await publish_until(host, "/led", message, "std_msgs/Bool", done)


@pytest.mark.parametrize("name", ["motors_l298", pytest.param("motors_tb6612", marks=pytest.mark.long)])
async def test_motors_roll_as_commanded_and_stop_without_commands(daemon: Process, name: str) -> None:
    async with client.connect(daemon.url) as host, running(name, daemon.tcp) as board:
        message = {"linear": {"x": 0.25}, "angular": {"z": 1.0}}

        async def roll() -> None:
            await board.expect("analog 5 76")  # (0.25 - 0.1) of 0.5 m/s
            await board.expect("analog 6 178")
            await board.expect("digital 7 1")

        await publish_until(host, "/cmd_vel", message, "geometry_msgs/Twist", roll())
        await board.expect("analog 5 0")  # the commands have ended
        await board.expect("analog 6 0")


async def test_motors_stop_when_the_host_is_gone(daemon: Process) -> None:
    async with client.connect(daemon.url) as host, running("motors_l298", daemon.tcp) as board:
        message = {"linear": {"x": -0.5}}
        await publish_until(host, "/cmd_vel", message, "geometry_msgs/Twist", board.expect("analog 5 255"))
        assert board.last("digital 8") == "digital 8 1", "backwards"
        daemon.child.kill()
        await board.expect("analog 5 0")


@pytest.mark.long
async def test_servo(daemon: Process) -> None:
    async with client.connect(daemon.url) as host, running("servo", daemon.tcp) as board:
        for angle, turned in ((45, 45), (1000, 180)):
            done = board.expect(f"servo 9 {turned}")
            await publish_until(host, "/servo", {"data": angle}, "std_msgs/UInt16", done)


@pytest.mark.parametrize(
    ("name", "messages"),
    [
        (
            "odometry",
            {
                "nav_msgs/Odometry": {"header": {"frame_id": "odom"}, "child_frame_id": "base_link"},
                "tf/tfMessage": {"transforms": [{"header": {"frame_id": "odom"}, "child_frame_id": "base_link"}]},
            },
        ),
        ("imu", {"sensor_msgs/Imu": {"header": {"frame_id": "imu"}}}),
    ],
)
def test_period_of_an_example_leaves_a_fifth_of_its_line_free(name: str, messages: dict[str, dict[str, Any]]) -> None:
    """The comment of the example promises the rate that follows from its baud rate."""
    text = (EXAMPLES / name / f"{name}.ino").read_text()
    claimed, baud = re.findall(r"kBytes = ([\d +]+);", text)[0], int(re.findall(r"kBaud = (\d+);", text)[0])
    catalog = Catalog()
    frames = []
    for type_name, message in messages.items():
        type_ = catalog.message(type_name)
        assert type_ is not None
        frames.append(OVERHEAD_BYTES + len(type_.encode(message)))
    assert [int(each) for each in claimed.split("+")] == frames
    assert "kPeriodMs = 1 + kBytes * 10 * 1000 / kBaud * 5 / 4;" in text
    period_ms = 1 + sum(frames) * 10 * 1000 // baud * 5 // 4
    assert sum(frames) * 10 * 1000 / period_ms <= 0.81 * baud
    assert "setBaud(kBaud)" in text
    words = {11: "eleven times", 28: "28 times"}
    assert words[round(1000 / period_ms)] in text


async def test_odometry_of_two_encoders_and_its_transform(daemon: Process) -> None:
    async with client.connect(daemon.url) as host, running("odometry", daemon.tcp) as board:
        assert (await received(host, "/odom", "nav_msgs/Odometry"))["child_frame_id"] == "base_link"
        for turn in range(100):
            board.set(f"digital 2 {turn % 2}")  # B does not move: forwards, backwards, forwards, ...
            board.set(f"digital 4 {1 - turn % 2}")
            board.set(f"digital 3 {turn % 2}")
            board.set(f"digital 5 {1 - turn % 2}")

        odometry = await received(
            host, "/odom", "nav_msgs/Odometry", lambda odometry: abs(odometry["pose"]["pose"]["position"]["x"]) > 0.04
        )
        assert odometry["pose"]["pose"]["orientation"]["w"] == pytest.approx(1.0, abs=0.01)
        assert odometry["header"]["frame_id"] == "odom"
        (transform,) = (await received(host, "/tf", "tf/tfMessage"))["transforms"]
        assert transform["child_frame_id"] == "base_link"
        assert abs(transform["transform"]["translation"]["x"]) > 0.04


@pytest.mark.long
async def test_imu_with_diagnostics(daemon: Process) -> None:
    async with client.connect(daemon.url) as host, running("imu", daemon.tcp) as board:
        for number, value in enumerate((0x40, 0x00, 0xC0, 0x00, 0, 0, 0, 0, 0, 131)):
            board.set(f"register {0x3B + number} {value}")
        imu = await received(host, "/imu/data_raw", "sensor_msgs/Imu", lambda imu: imu["linear_acceleration"]["x"])
        assert imu["linear_acceleration"]["x"] == pytest.approx(9.80665)
        assert imu["linear_acceleration"]["y"] == pytest.approx(-9.80665)
        assert imu["angular_velocity"]["x"] == pytest.approx(math.radians(1.0))
        assert imu["orientation_covariance"][0] == -1.0
        of_board = await received(
            host, "/diagnostics", "diagnostic_msgs/DiagnosticArray", lambda sent: sent["status"][0]["name"] == "imu"
        )  # the daemon publishes its own diagnostics there, too
        (status,) = of_board["status"]
        assert (status["hardware_id"], status["message"]) == ("MPU-6050", "OK")
        measurements, dropped = status["values"]
        assert int(measurements["value"]) % 50 == 0
        assert dropped == {"key": "dropped", "value": "0"}


@pytest.mark.long
async def test_sonar(daemon: Process) -> None:
    async with client.connect(daemon.url) as host, running("sonar", daemon.tcp) as board:
        assert (await received(host, "/ultrasound", "sensor_msgs/Range"))["range"] in NOTHING
        board.set("pulse 8 5831")
        message = await received(
            host, "/ultrasound", "sensor_msgs/Range", lambda range_: range_["range"] not in NOTHING
        )
        assert message["range"] == pytest.approx(1.0, abs=0.001)


@pytest.mark.long
async def test_sensors_and_a_transform() -> None:
    """At the same time, as four boards of one host."""
    async with contextlib.AsyncExitStack() as stack:
        daemon = await stack.enter_async_context(in_process())
        host = await stack.enter_async_context(client.connect(daemon.url))
        temperature, ranger, adc, _ = [
            await stack.enter_async_context(running(name, daemon.tcp))
            for name in ("temperature", "ir_ranger", "adc", "transform")
        ]
        temperature.set("register 0 231")  # -25 degrees, in 12 bits
        temperature.set("register 1 0")
        ranger.set("analog 100 409")
        adc.set("analog 3 77")
        cold = await received(host, "/temperature", "sensor_msgs/Temperature", lambda sent: sent["temperature"] < 0)
        assert (cold["temperature"], cold["header"]["frame_id"]) == (-25.0, "board")
        near = await received(host, "/range", "sensor_msgs/Range", lambda sent: sent["range"] not in NOTHING)
        assert near["range"] == pytest.approx(0.125, abs=0.001)
        inputs = await received(host, "/adc", "rosserial_arduino/Adc", lambda sent: sent["adc3"])
        assert inputs == {"adc0": 0, "adc1": 0, "adc2": 0, "adc3": 77, "adc4": 0, "adc5": 0}
        (sent,) = (await received(host, "/tf", "tf/tfMessage"))["transforms"]
        assert (sent["header"]["frame_id"], sent["child_frame_id"]) == ("base_link", "camera")
        assert sent["transform"]["translation"]["z"] == pytest.approx(0.2)


async def test_a_service_that_the_board_provides(daemon: Process) -> None:
    async with client.connect(daemon.url) as host, running("service_server", daemon.tcp) as board:
        await daemon.read_log("topics.negotiated")
        for data, text in ((True, "on"), (False, "off")):
            assert await host.call("/switch_led", {"data": data}) == {"success": True, "message": text}
            await board.expect(f"digital 13 {int(data)}")


async def test_a_service_that_the_board_calls(daemon: Process) -> None:
    async with client.connect(daemon.url) as host, running("service_client", daemon.tcp):
        assert await received(host, "/chatter", "std_msgs/String") == {"data": "no service named trigger"}

        async def pull(_: dict[str, Any]) -> dict[str, Any]:
            return {"success": True, "message": "pulled"}

        async with host.serve("/trigger", "std_srvs/Trigger", pull):
            await received(host, "/chatter", "std_msgs/String", lambda text: text == {"data": "pulled"})


async def test_a_call_without_an_answer_ends_after_its_deadline(daemon: Process) -> None:
    async with client.connect(daemon.url) as host:

        async def never(_: dict[str, Any]) -> dict[str, Any]:
            await asyncio.Event().wait()
            return {}

        async with host.serve("/trigger", "std_srvs/Trigger", never), running("service_client", daemon.tcp):
            await received(host, "/chatter", "std_msgs/String", lambda text: text == {"data": "no answer"})


async def test_parameters(daemon: Process) -> None:
    async with client.connect(daemon.url) as host, running("parameters", daemon.tcp):
        await received(host, "/chatter", "std_msgs/String", lambda text: text == {"data": "from the host"})


async def test_wifi(daemon: Process) -> None:
    async with client.connect(daemon.url) as host, running("wifi", daemon.tcp):
        assert await received(host, "/chatter", "std_msgs/String") == {"data": "hello over the air"}


@pytest.mark.long
async def test_ethernet(daemon: Process) -> None:
    async with client.connect(daemon.url) as host, running("ethernet", daemon.tcp):
        assert await received(host, "/chatter", "std_msgs/String") == {"data": "hello over a cable"}


async def test_udp(tmp_path: Path) -> None:
    settings, port = tmp_path / "hostlink.toml", free_port()
    settings.write_text(f'[udp]\nhost = "127.0.0.1"\nport = {port}\n')
    serving = serve("--config", str(settings))
    async with serving as daemon, client.connect(daemon.url) as host, running("udp", ("127.0.0.1", port)):
        assert await received(host, "/chatter", "std_msgs/String") == {"data": "hello in a datagram"}


async def test_board_reconnects_to_a_restarted_host() -> None:
    port = free_port()
    async with running("wifi", ("127.0.0.1", port)):
        for _ in range(2):
            async with serve("--listen", f"127.0.0.1:{port}") as daemon, client.connect(daemon.url) as host:
                assert await received(host, "/chatter", "std_msgs/String") == {"data": "hello over the air"}


@pytest.mark.parametrize("is_right", [True, False])
async def test_a_board_and_its_host_prove_the_key_to_each_other(tmp_path: Path, is_right: bool) -> None:
    (tmp_path / "key").write_text(KEY if is_right else KEY[::-1])
    config = Config(tcp=TcpConfig(key_file=tmp_path / "key"))
    async with in_process(config) as host, running(WITH_KEY, host.tcp):
        if is_right:
            await expect(lambda: host.hub.topics.find_or_none("/chatter") is not None, timeout_s=15.0)
        else:
            await expect(lambda: host.hub.counts.refused["wrong_key"] > 1, timeout_s=15.0)  # the board reconnects
        assert not is_right or not host.hub.counts.refused


async def test_a_host_without_the_key_gets_no_byte() -> None:
    received_bytes = asyncio.Queue[bytes]()

    async def serve_without_key(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(TOPICS_REQUEST * 3)
        received_bytes.put_nowait(await reader.read())

    async with tcp_server(serve_without_key) as address, running(WITH_KEY, address), asyncio.timeout(15.0):
        assert [await received_bytes.get() for _ in range(2)] == [b"", b""]


@contextlib.asynccontextmanager
async def uart() -> AsyncIterator[int]:
    """The wires between two boards, as a port: bytes of one connection are sent on the other."""
    ends: list[asyncio.StreamWriter] = []

    async def pass_on(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        ends.append(writer)
        while data := await reader.read(4096):
            for end in ends:
                if end is not writer:
                    end.write(data)
        ends.remove(writer)

    async with tcp_server(pass_on) as (_, port):
        yield port


async def test_a_board_behind_another_that_has_the_network(daemon: Process) -> None:
    nobody = ("127.0.0.1", free_port())
    async with (
        uart() as port,
        running("passthrough", daemon.tcp, port),
        running("pubsub", nobody, port) as board,
        client.connect(daemon.url) as host,
    ):
        assert await received(host, "/chatter", "std_msgs/String") == {"data": "hello world!"}
        await host.publish("/toggle_led", {}, type_name="std_msgs/Empty")
        await board.expect("digital 13 1")


async def test_motors_behind_a_passthrough_stop_when_the_host_is_gone_and_roll_again() -> None:
    nobody, address = ("127.0.0.1", free_port()), ("127.0.0.1", free_port())
    listen = ("--listen", f"127.0.0.1:{address[1]}")
    message = {"linear": {"x": -0.5}}
    async with uart() as port, running("passthrough", address, port), running("motors_l298", nobody, port) as board:
        for _ in range(2):
            async with serve(*listen) as daemon, client.connect(daemon.url) as host:
                await publish_until(host, "/cmd_vel", message, "geometry_msgs/Twist", board.expect("analog 5 255"))
                daemon.child.kill()
                await board.expect("analog 5 0")


async def test_time_and_log(daemon: Process) -> None:
    async with client.connect(daemon.url) as host, running("time_and_log", daemon.tcp):
        now = (await received(host, "/clock", "std_msgs/Time", lambda time_: time_["data"]["secs"]))["data"]
        assert abs(time.time() - now["secs"] - now["nsecs"] * 1e-9) < 1.0
        line = await daemon.read_log("device.logged")
        assert (line["level_name"], line["text"]) == ("info", "connected")


@pytest.mark.long
async def test_button_and_analog_inputs(daemon: Process) -> None:
    async with client.connect(daemon.url) as host, running("button", daemon.tcp) as board:
        board.set("analog 101 512")
        async with host.subscribe("/pushed", type_name="std_msgs/Bool") as pushes:
            adc = "std_msgs/UInt16MultiArray"
            await received(host, "/adc", adc, lambda adc: adc["data"] == [0, 512, 0, 0])
            # The host has subscribed to the first topic when it sends on the second.
            board.set("digital 7 0")
            assert await asyncio.wait_for(anext(aiter(pushes)), 15.0) == {"data": True}


async def test_picture_that_is_too_large_is_refused_and_the_next_one_arrives(daemon: Process) -> None:
    async with client.connect(daemon.url) as host, running("camera", daemon.tcp):
        picture = await received(host, "/image/compressed", "sensor_msgs/CompressedImage")
        assert len(base64.b64decode(picture["data"])) == 1000
