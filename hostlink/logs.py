"""The log: structlog events on stderr, JSON when that is no terminal. This list of events is the log's contract.

Life of a link   link.opened, link.closed, link.trouble, link.refused, link.broken, link.crashed, link.diagnosed,
                 connection.refused, serial.waiting, serial.baud_tried, serial.baud_found
What it said     topics.asked, topics.negotiated, topic.refused, message.refused, device.logged, parameter.unknown,
                 parameter.refused, protocol.version_1
Robots           robot.appeared, robot.gone, robot.stopped, robot.locked, robot.unlocked, robot.unreachable,
                 odometry.unreadable
Services         service.late, service.failed
Clients          client.connected, client.closed, client.too_slow, client.too_fast, client.refused,
                 client.unknown_op
The daemon       daemon.started, daemon.stopping, daemon.stopped, systemd.deaf
"""

import logging
import sys
from typing import TextIO

import structlog

_MAX_PRINTED = 64


def configure(*, level: str = "info", stream: TextIO | None = None) -> None:
    """Send events at or above `level` to `stream` (stderr): readable on a terminal, else one JSON object a line."""
    out = sys.stderr if stream is None else stream
    renderer: structlog.typing.Processor = (
        structlog.dev.ConsoleRenderer() if out.isatty() else structlog.processors.JSONRenderer()
    )
    structlog.configure(
        processors=[
            structlog.contextvars.merge_contextvars,
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="iso", utc=True),
            structlog.processors.StackInfoRenderer(),
            *([] if out.isatty() else [structlog.processors.format_exc_info]),
            renderer,
        ],
        wrapper_class=structlog.make_filtering_bound_logger(logging.getLevelNamesMapping()[level.upper()]),
        logger_factory=structlog.PrintLoggerFactory(out),
        cache_logger_on_first_use=False,
    )


def printable(text: str) -> str:
    """What a peer said, safe for a terminal: printable characters only, and not too many of them."""
    return "".join(char if char.isprintable() else "?" for char in text[:_MAX_PRINTED])
