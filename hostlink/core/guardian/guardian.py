"""Guardian: the daemon's side. Starts the guardian's process, passes it the robots' connections, and replaces it.

All work is done in event loop callbacks that never wait. A guardian that hangs, ended or cannot be started neither
delays nor ends anything.
"""

import asyncio
import contextlib
import fcntl
import resource
import socket
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import structlog

from hostlink.core.guardian.records import ANSWER_BYTES, GOODBYE, PING, decode_answer, encode, encode_beat, fitting
from hostlink.core.guardian.roster import GuardedLinks, Watched
from hostlink.core.runtime.detached import start_python
from hostlink.core.runtime.stop_frames import StopFrames

log = structlog.get_logger()

PING_S = 2.0
BEAT_S = 0.2  # interval of the beats while robots are driven; the guardian acts after a second without one
ANSWER_S = 5.0  # it answers within milliseconds, on a busy machine within a second; afterwards it counts as stuck
REAP_S = 0.02
GOODBYE_S = 0.2  # a guardian that does not end in this time is killed
WRITING_S = 1.0  # longer than a guardian needs to stop the robots
SHORTEST_PAUSE_S, LONGEST_PAUSE_S = 0.25, 30.0  # before the next start; doubled each time that a process ends at once
SETTLED_S = 60.0  # a process that lived longer did not end at once
_STDERR = 2
ROOT = Path(__file__).resolve().parents[3]
CODE = (  # -I and -S allow no other import path; appended after the standard library, so that nothing shadows it
    "import sys; sys.path.append(sys.argv[1]); from hostlink.core.guardian.process import main; main(int(sys.argv[2]))"
)


@contextlib.contextmanager
def guarded(*, is_wanted: bool) -> Iterator["Guardian | None"]:
    """Yield a guardian, which the block starts. It stops the robots if an exception leaves the block."""
    if not is_wanted:
        yield None
        return
    forbid_core_dumps()
    guardian = Guardian()
    try:
        yield guardian
    except BaseException:
        guardian.abandon()
        raise
    guardian.goodbye()


def forbid_core_dumps() -> None:
    """Disable core dumps:

    a crashed process keeps its connections open until its core is written, which takes too long.
    """
    _, hard = resource.getrlimit(resource.RLIMIT_CORE)
    with contextlib.suppress(OSError, ValueError):  # systemd's sandbox forbids it; the unit sets LimitCORE
        # Core(5): 0 does not apply when cores are piped to a program.
        resource.setrlimit(resource.RLIMIT_CORE, (1, hard))


class Guardian:
    """Supervisor of one guardian process at a time.

    | state    | entered by                                             | left by                                |
    |----------|--------------------------------------------------------|----------------------------------------|
    | running  | `start`: the process runs; all links are sent to it    | its end, or no answer for ANSWER_S     |
    | ending   | the end of running; the process is killed              | the process is reaped                  |
    | waiting  | the end of ending, or a failed start                   | a pause                                |
    | over     | `goodbye`, `abandon`                                   |                                        |
    """

    def __init__(self, *, ping_s: float = PING_S, answer_s: float = ANSWER_S) -> None:
        self.restarts = 0
        self._ping_s, self._answer_s = ping_s, answer_s
        self._roster = GuardedLinks()
        self._process: subprocess.Popen[bytes] | None = None
        self._channel: socket.socket | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._started_at_s = 0.0
        # Unanswered ping: its time, and the number of guarded connections then.
        self._ping: tuple[float, int] | None = None
        self._pause_s = SHORTEST_PAUSE_S
        self._missing = ""  # reason of the last failed start
        self._is_incomplete = False
        self._cut = set[int]()  # links whose frames do not all fit a record
        self._driven = set[int]()  # of the last beat
        self._beat_s = 0.0  # time of the last beat
        self._stopped = 0  # robots that the process has stopped because of missing beats

    # -- what the daemon reports --------------------------------------------------------------------------------------

    def watch(self, number: int, connection: Callable[[], int | None], stop: StopFrames) -> None:
        """Guard a link with these frames. `connection` returns its descriptor while it is open."""
        fitted = fitting(stop)
        if fitted != stop:
            if number not in self._cut:
                log.warning("guardian.frames_dropped", link=number, guarded=len(fitted.zeros))
            self._cut.add(number)
        else:
            self._cut.discard(number)
        self._roster.watch(number, Watched(connection, fitted))
        self._send_next()

    def release(self, number: int) -> None:
        """Stop guarding a link that ended or is no longer a robot's."""
        self._cut.discard(number)
        self._roster.release(number)
        self._send_next()

    def beat(self, driven: set[int]) -> None:
        """Report that the loop runs, and which links have robots that may move."""
        now_s = asyncio.get_running_loop().time()
        is_news = bool(driven - self._driven) or (not driven and bool(self._driven))
        if not (is_news or (driven and now_s >= self._beat_s + BEAT_S)):
            return
        self._driven, self._beat_s = driven, now_s
        self._send_beat()

    def start(self) -> None:
        """Start the process. Retry later if that fails."""
        loop = asyncio.get_running_loop()
        try:
            self._channel, self._process = _spawn()
        except OSError as error:
            self._miss(error.strerror or str(error))
            return
        self._missing, self._ping, self._is_incomplete, self._stopped = "", None, False, 0
        self._started_at_s = loop.time()
        log.info("guardian.started", pid=self._process.pid)
        loop.add_reader(self._channel, self._receive)
        self._later(self._ping_s, self._check)
        self._send_next()
        if self._driven:
            self._send_beat()

    def goodbye(self) -> None:
        """End the process without a stop sequence, because the daemon has stopped the robots."""
        if self._channel is not None:
            with contextlib.suppress(OSError):  # a stuck process is killed below
                self._channel.send(encode(GOODBYE))
        self._end(GOODBYE_S)

    def abandon(self) -> None:
        """Leave the open connections to the process, because the daemon fails. Wait until it has stopped the robots."""
        self._close_channel()
        self._end(WRITING_S)

    # -- the process --------------------------------------------------------------------------------------------------

    def _send_next(self) -> None:
        """Send the records that the process has not got, as far as there is room."""
        if self._channel is None:
            return
        loop = asyncio.get_running_loop()
        while (found := self._roster.next()) is not None:
            record, descriptor = found
            try:
                _send(self._channel, record, descriptor)
            except BlockingIOError:
                loop.add_writer(self._channel, self._send_next)
                return
            except OSError as error:
                self._lose(error.strerror or str(error))
                return
            self._roster.confirm(has_descriptor=descriptor is not None)
        loop.remove_writer(self._channel)

    def _send_beat(self) -> None:
        if self._channel is not None:
            with contextlib.suppress(OSError):  # a stuck or ended process is detected by `_check` and `_receive`
                self._channel.send(encode_beat(self._driven))

    def _receive(self) -> None:
        assert self._channel is not None  # noqa: S101 - a reader is removed with its channel
        try:
            answer = self._channel.recv(ANSWER_BYTES)
        except BlockingIOError:
            return
        except OSError:
            answer = b""
        if not answer:
            self._lose("ended")
            return
        if self._ping is not None:
            connections, stopped = decode_answer(answer)
            sent = self._ping[1]
            if connections < sent and not self._is_incomplete:
                log.warning("guardian.incomplete", connections=connections, robots=sent)
            self._is_incomplete = connections < sent
            if stopped != self._stopped:
                log.warning("guardian.stopped_robots", robots=stopped - self._stopped)
                self._stopped = stopped
        self._ping = None

    def _check(self) -> None:
        """Ping the process. Replace it if the last ping is unanswered."""
        assert self._channel is not None  # noqa: S101 - the timer is replaced with the channel
        now_s = asyncio.get_running_loop().time()
        if self._ping is not None and now_s >= self._ping[0] + self._answer_s:
            self._lose("stuck")
            return
        if self._ping is None:
            self._ping = (now_s, self._roster.connections)
            with contextlib.suppress(OSError):  # no room: there will be no answer
                self._channel.send(encode(PING))
        self._later(self._ping_s, self._check)

    def _lose(self, reason: str) -> None:
        self._close_channel()
        self._roster.forget()
        if self._process is not None:
            self._process.kill()
        self._later(REAP_S, self._reap, reason)

    def _reap(self, reason: str) -> None:
        status = None if self._process is None else self._process.poll()
        if status is None:
            self._later(REAP_S, self._reap, reason)
            return
        self._process = None
        self.restarts += 1
        log.warning("guardian.ended", reason=reason, status=status, restarts=self.restarts)
        if asyncio.get_running_loop().time() >= self._started_at_s + SETTLED_S:
            self._pause_s = SHORTEST_PAUSE_S
        self._pause()

    def _miss(self, reason: str) -> None:
        if reason != self._missing:
            self._missing = reason
            log.warning("guardian.start_failed", reason=reason)
        self._pause()

    def _pause(self) -> None:
        self._later(self._pause_s, self.start)
        self._pause_s = min(2 * self._pause_s, LONGEST_PAUSE_S)

    def _later(self, wait_s: float, act: Callable[..., None], *arguments: object) -> None:
        """Replace the timer."""
        if self._timer is not None:
            self._timer.cancel()
        self._timer = asyncio.get_running_loop().call_later(wait_s, act, *arguments)

    def _close_channel(self) -> None:
        if self._channel is not None:
            loop = asyncio.get_running_loop()
            loop.remove_reader(self._channel)
            loop.remove_writer(self._channel)
            self._channel.close()
            self._channel = None

    def _end(self, wait_s: float) -> None:
        """Wait `wait_s` for the process to end, then kill it."""
        if self._timer is not None:
            self._timer.cancel()
        if self._process is not None:
            try:
                self._process.wait(wait_s)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
        self._close_channel()


def _spawn() -> tuple[socket.socket, "subprocess.Popen[bytes]"]:
    """Start the process. Return it and the channel to it.

    Raises:
        OSError: the process cannot be started.
    """
    ours, theirs = map(_above_stdio, socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET))
    with theirs, contextlib.ExitStack() as undo:
        undo.callback(ours.close)
        arguments = ["-I", "-S", "-c", CODE, str(ROOT), str(theirs.fileno())]
        process = start_python(arguments, pass_fds=(theirs.fileno(),))
        undo.pop_all()
    ours.setblocking(False)
    return ours, process


def _above_stdio(end: socket.socket) -> socket.socket:
    """Move a socket above the standard streams' numbers, which are free in a daemon that was started without them."""
    if end.fileno() > _STDERR:
        return end
    with end:
        return socket.socket(fileno=fcntl.fcntl(end.fileno(), fcntl.F_DUPFD_CLOEXEC, _STDERR + 1))


def _send(channel: socket.socket, record: bytes, descriptor: int | None) -> None:
    if descriptor is None:
        channel.send(record)
    else:
        socket.send_fds(channel, [record], [descriptor])
