"""The options of a TCP connection that carries messages of now: they leave at once, and dead peers are found."""

import socket

KEEPALIVE = {"TCP_KEEPIDLE": 5, "TCP_KEEPINTVL": 2, "TCP_KEEPCNT": 3}  # seconds, seconds, probes: found within 11 s


def set_options(connection: socket.socket, *, send_bytes: int, receive_bytes: int, user_timeout_ms: int) -> None:
    """`send_bytes`, `receive_bytes`: what may wait in the kernel; `user_timeout_ms`: sent and not acknowledged so long.

    Raises:
        OSError: the connection is gone.
    """
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, send_bytes)
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_bytes)
    for name, value in {**KEEPALIVE, "TCP_USER_TIMEOUT": user_timeout_ms}.items():
        option = getattr(socket, name, None)  # not every system has each of them
        if option is not None:
            connection.setsockopt(socket.IPPROTO_TCP, option, value)
