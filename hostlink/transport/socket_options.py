"""Socket options of TCP connections that carry current messages: no delay, and detection of dead peers."""

import socket

# Seconds, seconds, probes: a dead peer is detected within 11 s.
KEEPALIVE = {"TCP_KEEPIDLE": 5, "TCP_KEEPINTVL": 2, "TCP_KEEPCNT": 3}


def set_options(connection: socket.socket, *, send_bytes: int, receive_bytes: int, user_timeout_ms: int) -> None:
    """Set the options of a connected socket.

    `send_bytes` and `receive_bytes` bound the kernel's buffers. `user_timeout_ms` bounds how long sent data may stay
    unacknowledged.

    Raises:
        OSError: the connection is lost.
    """
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, send_bytes)
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_bytes)
    for name, value in {**KEEPALIVE, "TCP_USER_TIMEOUT": user_timeout_ms}.items():
        option = getattr(socket, name, None)  # some systems lack some of them
        if option is not None:
            connection.setsockopt(socket.IPPROTO_TCP, option, value)
