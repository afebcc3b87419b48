"""The unmodified sketch between a device on a 38400 baud UART and a host on TCP, under what networks do to it.

The sketch runs with AddressSanitizer and a watchdog; how it ends is checked by running_sketch().
"""

import signal
import socket
import struct
import time
from collections.abc import Iterator

import pytest

from hostlink.core.protocol.rosserial.frame import Id, encode
from tests.firmware.esp8266 import Sketch, running, running_sketch

pytestmark = pytest.mark.usefixtures("esp8266_built")

POSE = encode(125, bytes(range(24)))
TWIST = encode(126, bytes(range(48)))
COMMAND = encode(101, bytes(48))
HALF, REST = POSE[:20], bytes(len(POSE) - 20)  # of a frame that the end of a link cuts
LINE_BYTES_S = 3840
LIMIT_S = 15


def receive(sock: socket.socket, count: int) -> bytes:
    data = b""
    while len(data) < count:
        part = sock.recv(count - len(data))
        assert part, f"closed after {len(data)} of {count} bytes"
        data += part
    return data


def receive_behind_rest(link: socket.socket, count: int) -> bytes:
    """Receive bytes, without those of the cut frame, which pass only after a pause of the line or as a whole."""
    data = receive(link, count)
    for cut in (HALF + REST, REST):
        if data.startswith(cut):
            return data[len(cut) :] + receive(link, len(cut))
    return data


class Host:
    def __init__(self) -> None:
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.listener.settimeout(LIMIT_S)
        self.port = self.listener.getsockname()[1]

    def accept(self) -> socket.socket:
        connection, _ = self.listener.accept()
        connection.settimeout(LIMIT_S)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return connection

    def restart(self) -> None:
        self.listener = socket.create_server(("127.0.0.1", self.port))
        self.listener.settimeout(LIMIT_S)


@pytest.fixture
def host() -> Iterator[Host]:
    host = Host()
    yield host
    host.listener.close()


def open_device(sketch: Sketch) -> socket.socket:
    device = socket.create_connection(("127.0.0.1", sketch.uart_port), LIMIT_S)
    device.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return device


def assert_passes_both_ways(device: socket.socket, link: socket.socket) -> None:
    """Frames pass; the first bytes that the host sees of a link are the start of a frame."""
    device.sendall(POSE)
    assert receive(link, len(POSE)) == POSE
    link.sendall(COMMAND)
    assert receive(device, len(COMMAND)) == COMMAND


def test_a_full_line_passes_at_its_rate_each_frame_in_one_write(host: Host) -> None:
    with running_sketch(host.port) as sketch, open_device(sketch) as device, host.accept() as link:
        assert_passes_both_ways(device, link)
        before = sketch.command("stats")["tcp_writes"]
        wire = (POSE + TWIST) * 44  # 3872 bytes
        started_s = time.monotonic()
        device.sendall(wire)
        link.sendall(wire)
        assert receive(link, len(wire)) == wire
        assert receive(device, len(wire)) == wire
        assert time.monotonic() - started_s == pytest.approx(len(wire) / LINE_BYTES_S, rel=0.3)
        stats = sketch.command("stats")
        assert stats["tcp_writes"] - before <= 88
        assert stats["uart_overflowed_bytes"] == stats["uart_lost_bytes"] == 0


def test_bytes_outside_frames_pass(host: Host) -> None:
    with running_sketch(host.port) as sketch, open_device(sketch) as device, host.accept() as link:
        assert_passes_both_ways(device, link)
        text = b"hello \xff\xfe\xff\xff and goodbye"
        device.sendall(text)
        link.sendall(text)
        assert receive(link, len(text)) == text
        assert receive(device, len(text)) == text


def test_a_frame_that_the_network_cuts_reaches_the_device_in_one_piece(host: Host) -> None:
    with running_sketch(host.port) as sketch, open_device(sketch) as device, host.accept() as link:
        assert_passes_both_ways(device, link)
        before = sketch.command("stats")["uart_transmitted_bytes"]
        link.sendall(COMMAND[:20])
        assert sketch.command("wait 100")["uart_transmitted_bytes"] == before
        link.sendall(COMMAND[20:])
        assert receive(device, len(COMMAND)) == COMMAND


def test_more_than_fits_the_buffers_is_slowed_down_and_not_lost(host: Host) -> None:
    with (
        running_sketch(host.port, "--write-limit", "7") as sketch,
        open_device(sketch) as device,
        host.accept() as link,
    ):
        assert_passes_both_ways(device, link)
        wire = encode(126, bytes(1024)) * 5
        link.sendall(wire)
        assert receive(device, len(wire)) == wire
        device.sendall(wire)
        assert receive(link, len(wire)) == wire
        assert sketch.command("stats")["uart_overflowed_bytes"] == 0


@pytest.mark.parametrize("is_reset", [False, True], ids=["closed", "reset"])
def test_a_closed_connection_is_made_anew(host: Host, is_reset: bool) -> None:
    with running_sketch(host.port) as sketch, open_device(sketch) as device:
        for _ in range(3):
            with host.accept() as link:
                device.sendall(REST + POSE)
                assert receive_behind_rest(link, len(POSE)) == POSE
                link.sendall(COMMAND)
                assert receive(device, len(COMMAND)) == COMMAND
                link.sendall(TWIST[:30])  # never complete, so never at the device
                if is_reset:
                    link.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            ended_s = time.monotonic()
            device.sendall(HALF)  # arrives without a link, or is half a frame on the next one
        with host.accept() as link:
            assert time.monotonic() - ended_s < 1
            device.sendall(REST + TWIST)
            assert receive_behind_rest(link, len(TWIST)) == TWIST


def test_a_host_that_was_away_gets_its_robot_back_within_3_s(host: Host) -> None:
    with running_sketch(host.port) as sketch, open_device(sketch) as device:
        with host.accept() as link:
            assert_passes_both_ways(device, link)
            host.listener.close()
        sketch.command("wait 3000")
        host.restart()
        restarted_s = time.monotonic()
        with host.accept() as link:
            assert time.monotonic() - restarted_s < 3
            assert_passes_both_ways(device, link)
        assert sketch.command("stats")["wifi_begins"] == 1


def test_wifi_after_an_interruption_reconnects(host: Host) -> None:
    with running_sketch(host.port) as sketch, open_device(sketch) as device, host.accept() as old_link:
        assert_passes_both_ways(device, old_link)
        sketch.signal(signal.SIGUSR1)
        sketch.command("wait 500")
        sketch.signal(signal.SIGUSR2)
        with host.accept() as link:
            assert_passes_both_ways(device, link)
        old_link.setblocking(False)
        with pytest.raises(BlockingIOError):  # the host was not informed that the old connection is dead
            old_link.recv(1)


def test_a_link_that_accepts_no_more_bytes_is_given_up(host: Host) -> None:
    options = ("--send-buffer", "1072")
    with running_sketch(host.port, *options) as sketch, open_device(sketch) as device, host.accept() as old_link:
        assert_passes_both_ways(device, old_link)
        sketch.command("radio mute")
        device.sendall(POSE * 60)  # half a second of the wire fills more than the send buffer
        assert sketch.command("wait 2000")["closed_in_silence"] == 0
        assert sketch.command("wait 1000")["closed_in_silence"] == 1
        sketch.command("radio clear")
        with host.accept() as link:
            assert_passes_both_ways(device, link)


def test_a_link_without_time_answers_is_given_up(host: Host) -> None:
    with running_sketch(host.port) as sketch, open_device(sketch) as device, host.accept() as old_link:
        assert_passes_both_ways(device, old_link)
        device.sendall(encode(Id.TIME, bytes(8)))
        assert sketch.command("wait 5800")["connects"] == 1
        with host.accept() as link:
            assert receive(old_link, 16) == encode(Id.TIME, bytes(8))
            assert old_link.recv(1) == b""
            assert_passes_both_ways(device, link)


def test_a_server_that_cannot_be_reached_does_not_stop_the_uart(host: Host) -> None:
    with running_sketch(host.port, "--connect-ms", "300") as sketch, open_device(sketch) as device:
        with host.accept() as link:
            assert_passes_both_ways(device, link)
            sketch.command("connect hang")
        overflowed = sketch.command("stats")["uart_overflowed_bytes"]
        for _ in range(20):  # as much as a robot sends: 880 bytes a second
            device.sendall(POSE + TWIST)
            sketch.command("wait 100")
        assert sketch.command("connect normal")["uart_overflowed_bytes"] == overflowed
        with host.accept() as link:
            assert_passes_both_ways(device, link)


def test_boot_noise_reaches_no_host_and_disturbs_no_frame(host: Host) -> None:
    with running_sketch(host.port, "--boot-noise", "300", "--wait-for-device") as sketch, open_device(sketch) as device:
        device.sendall(bytes(range(200, 256)) * 3 + TWIST[:9])
        noise = receive(device, 300)
        assert b"\xff" in noise
        with host.accept() as link:
            assert_passes_both_ways(device, link)


def test_a_restarted_device_is_found_again(host: Host) -> None:
    with running_sketch(host.port) as sketch, host.accept() as link:
        for _ in range(2):
            with open_device(sketch) as device:
                assert_passes_both_ways(device, link)


def test_original_passthrough_overflows_its_buffer(host: Host) -> None:
    with running("esp8266_original", host.port) as sketch, open_device(sketch), host.accept() as link:
        link.sendall(bytes(1000))
        status, errors = sketch.crash()
        assert status != 0
        assert "global-buffer-overflow" in errors


def test_original_passthrough_without_wifi_trips_the_watchdog(host: Host) -> None:
    with running("esp8266_original", host.port, "--join-ms", "60000") as sketch:
        status, errors = sketch.crash()
        assert status == 70
        assert "soft watchdog" in errors
