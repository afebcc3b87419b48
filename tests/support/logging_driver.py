"""A device in a process of its own that drives another one and logs on the same connection, until it is stopped.

python -m tests.support.logging_driver 127.0.0.1 11411 --log-bytes-s 1000000
"""

import argparse
import select
import socket
import time

from hostlink.core.protocol.endpoint import EndpointKind
from hostlink.core.protocol.rosserial.control import Log
from hostlink.core.protocol.rosserial.frame import Frame, Id, encode
from hostlink.core.protocol.rosserial.stream import FrameStream
from hostlink.core.robot.velocity import TWIST_TYPE, PlanarVelocity
from tests.support.api_loads import encode_time
from tests.support.device_codec import encode_log
from tests.support.fake_device import announcement, topic

DRIVE_HZ = 20.0
TICK_S = 0.01
TEXT = "wheels at 12.3 rad/s"
TOPIC_ID = 126


def drive(address: tuple[str, int], velocity_topic: str, *, log_bytes_s: float, send_buffer_bytes: int) -> None:
    """Send velocities that tell when they were sent, and log lines between them; never return."""
    line = encode(Id.LOG, encode_log(Log(1, TEXT)))
    connection = socket.create_connection(address)
    if send_buffer_bytes:
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, send_buffer_bytes)
    stream, known = FrameStream(), announcement([topic(EndpointKind.PUBLISHER, TOPIC_ID, velocity_topic, TWIST_TYPE)])
    began_s = next_s = time.monotonic()
    logged_bytes, is_announced = 0, False
    while True:
        if select.select([connection], [], [], 0 if is_announced else 1.0)[0]:
            data = connection.recv(65536)
            for frame in stream.feed(data):
                if isinstance(frame, Frame) and frame.topic_id == Id.PUBLISHER:
                    connection.sendall(known)
                    is_announced = True
                    print("announced", flush=True)  # noqa: T201 - for the test
                    began_s, logged_bytes = time.monotonic(), 0
        if not is_announced:
            continue
        now_s = time.monotonic()
        if now_s >= next_s:
            next_s = now_s + 1 / DRIVE_HZ
            connection.sendall(encode(TOPIC_ID, PlanarVelocity(encode_time(now_s)).encode()))
        lines = int((log_bytes_s * min(now_s - began_s, 3600.0) - logged_bytes) / len(line))
        if lines > 0:
            logged_bytes += lines * len(line)
            connection.sendall(line * min(lines, int(2 * log_bytes_s * TICK_S / len(line)) + 1))
        time.sleep(TICK_S / 2)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("host")
    parser.add_argument("port", type=int)
    parser.add_argument("--topic", default="/robot_0/velocity_commands")
    parser.add_argument("--log-bytes-s", type=float, default=1e6)
    parser.add_argument("--send-buffer-bytes", type=int, default=0)
    given = parser.parse_args()
    drive(
        (given.host, given.port),
        given.topic,
        log_bytes_s=given.log_bytes_s,
        send_buffer_bytes=given.send_buffer_bytes,
    )
