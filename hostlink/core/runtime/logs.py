"""The log: structlog events on stderr, JSON if that is not a terminal. This list of events is a public interface.

Life of a link   link.opened, link.closed, link.trouble, link.refused, link.broken, link.crashed, link.diagnosed,
                 link.too_large, connection.refused, serial.waiting, serial.baud_tried, serial.baud_found,
                 serial.protocol_found, boards.damaged, boards.forgotten, boards.not_kept
Its messages     topics.requested, topics.negotiated, topic.refused, message.refused, device.logged, parameter.unknown,
                 parameter.refused, protocol.version_1, participant.crashed
Robots           robot.appeared, robot.numbered, robot.gone, robot.forgotten, robot.stopped, robot.locked,
                 robot.unlocked, robot.unreachable, robot.crashed, robot.settings_refused, robots.all_locked,
                 robots.all_unlocked, robot.incomplete, robot.complete, robot.device_twice, robot.device_replaced,
                 names.damaged, names.not_kept, device.unguarded_command, odometry.unreadable
Services         service.late, service.failed, service.crashed, service.cut, service.taken_over, service.unanswerable
Clients          client.connected, client.closed, client.broken, client.too_slow, client.too_fast,
                 client.refused, client.unknown_op, client.crowded, client.malformed, client.origin_refused
The daemon       daemon.started, daemon.stop_requested, daemon.stopping, daemon.stopped, daemon.failed, daemon.forced,
                 daemon.stalled, daemon.diagnosed,
                 task.crashed, diagnosis.crashed, systemd.notify_failed, config.suspicious, config.reloaded,
                 config.refused, descriptors.exhausted, loop.error, library.complained
Recordings       recording.started, recording.stopped, recording.stored, recording.failed, incident.begun,
                 incident.saved, incident.lost, incident.postponed, recording.channel_limit_reached,
                 recording.file_removed, drives.lost, black_box.volatile
A ROS 1 graph    ros1.started, ros1.ended, ros1.master_found, ros1.master_lost, ros1.registered_again, ros1.crashed,
                 ros1.name_refused, ros1.publisher_failed, ros1.publication_failed, ros1.message_refused,
                 ros1.message_malformed, ros1.topic_unknown, ros1.service_unknown, ros1.service_unusable,
                 ros1.parameter_unusable, ros1.clock_unusable, ros1.caller_too_slow
Its guardian     guardian.started, guardian.ended, guardian.start_failed, guardian.incomplete,
                 guardian.frames_dropped, guardian.stopped_robots
Zenoh            zenoh.opened, zenoh.closed, zenoh.failed, fleet.daemon_appeared, fleet.daemon_gone,
                 fleet.duplicate_name_found, fleet.name_differs, fleet.unanswered, fleet.topic_refused,
                 fleet.hearing_changed, fleet.duplicate_host_found, fleet.silent_link_closed, graph.crashed
ROS 2 on Zenoh   ros2.joined, ros2.left, ros2.trouble, ros2.refused, ros2.topic_refused, ros2.service_refused,
                 ros2.type_unknown, ros2.type_differs
Components       component.ended, component.crashed, component.late, component.end_requested
The log itself   log.lines_left_out, log.lines_lost
"""

import logging
import sys
import time
from collections.abc import Callable, Hashable, Mapping
from typing import TextIO

import structlog

from hostlink.core.runtime.log_budget import LogBudget
from hostlink.core.runtime.log_output import LogOutput

_MAX_PRINTED = 64
_BUDGET_KEY = "log_budget"  # bound around the work for a peer; never printed

Sentences = Callable[[Mapping[str, object]], str | None]  # sentence of an event for people; None: it has none

budget = LogBudget()
output = LogOutput(None)
# Called with wall time and content of each line.
listeners: dict[Hashable, Callable[[int, Mapping[str, object]], None]] = {}


def configure(*, level: str = "info", stream: TextIO | None = None, sentences: Sentences | None = None) -> None:
    """Send events at or above `level` to `stream` (stderr): readable on a terminal, otherwise one JSON object per line.

    With `sentences`, a terminal shows those and, of the other events, warnings and errors only. Recordings have all.

    Writing never blocks and never fails: lines that cannot be written are counted. Lines for a peer have a budget
    (`of_peer`).
    """
    global output  # noqa: PLW0603 - as structlog's own configuration
    output = LogOutput(sys.stderr if stream is None else stream)
    is_terminal = output.isatty()
    renderer: structlog.typing.Processor = (
        structlog.dev.ConsoleRenderer() if is_terminal else structlog.processors.JSONRenderer()
    )
    if is_terminal and sentences is not None:
        renderer = _Brief(sentences, renderer)
    structlog.configure(
        processors=[
            structlog.contextvars.merge_contextvars,
            _keep_budget,
            _round_figures,
            structlog.processors.add_log_level,
            _pass_on,
            structlog.processors.TimeStamper(fmt="%Y-%m-%d %H:%M:%S%z" if is_terminal else "iso", utc=not is_terminal),
            structlog.processors.StackInfoRenderer(),
            _make_printable if is_terminal else structlog.processors.format_exc_info,
            renderer,
        ],
        wrapper_class=structlog.make_filtering_bound_logger(logging.getLevelNamesMapping()[level.upper()]),
        logger_factory=structlog.WriteLoggerFactory(file=output),  # type: ignore[arg-type]  # write and flush suffice
        cache_logger_on_first_use=False,
    )
    logging.captureWarnings(capture=True)


class _Brief:
    """Renderer of a terminal: the sentences of events, and `render` for warnings and errors without one."""

    def __init__(self, sentences: Sentences, render: structlog.typing.Processor) -> None:
        self._sentences, self._render = sentences, render

    def __call__(
        self, logger: object, method: str, event: structlog.typing.EventDict
    ) -> structlog.typing.ProcessorReturnValue:
        if (sentence := self._sentences(event)) is not None:
            return sentence
        if event["level"] in ("debug", "info"):
            raise structlog.DropEvent
        return self._render(logger, method, event)


def of_peer(address: str) -> dict[str, str]:
    """Return the context to bind around all work for a peer, so that its log lines have a budget."""
    return {_BUDGET_KEY: address}


def log_what_is_missing() -> None:
    """Log one line for each peer with refused lines, and one for lines that could not be written."""
    log = structlog.get_logger()
    for peer, lines in budget.pop_left_out().items():
        log.warning("log.lines_left_out", about=printable(peer) or "others", lines=lines)
    lost = output.pop_lost()
    if lost:
        log.warning("log.lines_lost", lines=lost)


def _make_printable(_: object, __: str, event: structlog.typing.EventDict) -> structlog.typing.EventDict:
    """Replace unprintable characters for a terminal. JSON escapes them itself."""
    return {key: _replace(value) if isinstance(value, str) else value for key, value in event.items()}


def printable(text: str, max_chars: int = _MAX_PRINTED) -> str:
    """Make a text of a peer safe for a terminal: printable characters only, at most `max_chars`."""
    return _replace(text[:max_chars])


def _keep_budget(
    _logger: structlog.typing.WrappedLogger, _method: str, event: structlog.typing.EventDict
) -> structlog.typing.EventDict:
    peer = event.pop(_BUDGET_KEY, None)
    if peer is not None and not budget.allows(peer, time.monotonic()):
        raise structlog.DropEvent
    return event


def _round_figures(_: object, __: str, event: structlog.typing.EventDict) -> structlog.typing.EventDict:
    """Round numbers to six decimals: microseconds, if they are seconds."""
    return {key: _rounded(value) for key, value in event.items()}


def _rounded(value: object) -> object:
    if isinstance(value, dict):
        return {key: _rounded(part) for key, part in value.items()}
    return round(value, 6) if isinstance(value, float) else value


def _pass_on(_: object, __: str, event: structlog.typing.EventDict) -> structlog.typing.EventDict:
    if listeners:
        stamp_ns = time.time_ns()
        for listen in tuple(listeners.values()):
            listen(stamp_ns, event)
    return event


def _replace(text: str) -> str:
    """Replace unprintable characters, such as control characters, C1 codes and bidirectional overrides."""
    return text if text.isprintable() else "".join(char if char.isprintable() else "?" for char in text)
