"""Guardian: the daemon's side of the guardian's process. It starts it, passes it the robots' connections, replaces it.

Everything happens in callbacks of the event loop that do not wait: a guardian that is stuck, gone or cannot be started
delays nothing and ends nothing.
"""

import asyncio
import contextlib
import fcntl
import resource
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import structlog

from hostlink.guardian.records import ANSWER_BYTES, decode_answer, encode_beat, encode_goodbye, encode_ping
from hostlink.guardian.roster import Roster, Watched

log = structlog.get_logger()

PING_S = 2.0
BEAT_S = 0.2  # between two beats while robots are driven; a second without one is a daemon that hangs
ANSWER_S = 5.0  # it answers within milliseconds, on a loaded machine within a second: after that it is stuck
REAP_S = 0.02
GOODBYE_S = 0.2  # a guardian that does not end by itself is killed; it has nothing to do any more
WRITING_S = 1.0  # longer than a guardian stops robots
SHORTEST_PAUSE_S, LONGEST_PAUSE_S = 0.25, 30.0  # before another is started; doubled each time that one ends at once
SETTLED_S = 60.0  # one that has lived longer did not end at once
_STDERR = 2
ROOT = Path(__file__).resolve().parents[2]
CODE = (  # -I and -S leave no other way to find it; behind the standard library, so that nothing shadows that
    "import sys; sys.path.append(sys.argv[1]); from hostlink.guardian.process import main; main(int(sys.argv[2]))"
)


@contextlib.contextmanager
def guarded(*, is_wanted: bool) -> Iterator["Guardian | None"]:
    """A guardian for the length of a block, in a running event loop. It acts when an exception leaves the block."""
    if not is_wanted:
        yield None
        return
    forbid_core_dumps()
    guardian = Guardian()
    guardian.start()
    try:
        yield guardian
    except BaseException:
        guardian.abandon()
        raise
    guardian.goodbye()


def forbid_core_dumps() -> None:
    """A process that crashed keeps its connections open until its core is written: longer than a robot may wait."""
    _, hard = resource.getrlimit(resource.RLIMIT_CORE)
    with contextlib.suppress(OSError, ValueError):  # systemd's sandbox forbids it; the unit has LimitCORE
        resource.setrlimit(resource.RLIMIT_CORE, (1, hard))  # core(5): 0 would not hold for a core that goes to a pipe


class Guardian:
    """One process at a time.

    | state    | entered by                                             | left by                                |
    |----------|--------------------------------------------------------|----------------------------------------|
    | running  | `start`: the process is there; it is sent all links     | its end, or no answer for ANSWER_S     |
    | ending   | the above; it is killed                                | the process is reaped                  |
    | waiting  | the above, or a start that failed                      | a pause                                |
    | over     | `goodbye`, `abandon`                                   |                                        |
    """

    def __init__(self, *, ping_s: float = PING_S, answer_s: float = ANSWER_S) -> None:
        self.restarts = 0
        self._ping_s, self._answer_s = ping_s, answer_s
        self._roster = Roster()
        self._process: subprocess.Popen[bytes] | None = None
        self._channel: socket.socket | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._started_at_s = 0.0
        self._ping: tuple[float, int] | None = None  # an unanswered ping: when, and what was guarded then
        self._pause_s = SHORTEST_PAUSE_S
        self._missing = ""  # why the last start failed
        self._is_incomplete = False
        self._driven = set[int]()  # of the last beat
        self._beat_s = 0.0  # when it was sent
        self._stopped = 0  # robots that the process has stopped because no beat came

    # -- what the daemon reports --------------------------------------------------------------------------------------

    def watch(
        self, number: int, connection: Callable[[], int | None], *, topic_ids: Sequence[int], claim_bytes: int
    ) -> None:
        """A link has these velocity topics; `connection` gives its descriptor while it is open."""
        self._roster.watch(number, Watched(connection, tuple(topic_ids), claim_bytes))
        self._send_next()

    def release(self, number: int) -> None:
        """A link has ended, or is no robot's any more."""
        self._roster.release(number)
        self._send_next()

    def beat(self, driven: set[int]) -> None:
        """The loop runs, and these links have robots that may move."""
        now_s = asyncio.get_running_loop().time()
        is_news = bool(driven - self._driven) or (not driven and bool(self._driven))
        if not (is_news or (driven and now_s >= self._beat_s + BEAT_S)):
            return
        self._driven, self._beat_s = driven, now_s
        self._send_beat()

    def start(self) -> None:
        """Start the process, now or as soon as it can be."""
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
        """The daemon has stopped the robots by itself: end the process, which sends nothing."""
        if self._channel is not None:
            with contextlib.suppress(OSError):  # it is stuck or gone, and will be killed
                self._channel.send(encode_goodbye())
        self._end(GOODBYE_S)

    def abandon(self) -> None:
        """The daemon fails: leave what is still connected to the process, and wait until it has done its work."""
        self._close_channel()
        self._end(WRITING_S)

    # -- the process --------------------------------------------------------------------------------------------------

    def _send_next(self) -> None:
        """Send what the process does not know yet, as far as there is room."""
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
            with contextlib.suppress(OSError):  # no room: it is stuck or gone, which `_check` and `_receive` notice
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
            self._compare(connections, self._ping[1])
            if stopped != self._stopped:
                log.warning("guardian.stopped_robots", robots=stopped - self._stopped)
                self._stopped = stopped
        self._ping = None

    def _compare(self, connections: int, sent: int) -> None:
        if connections < sent and not self._is_incomplete:
            log.warning("guardian.incomplete", connections=connections, robots=sent)
        self._is_incomplete = connections < sent

    def _check(self) -> None:
        """Request a sign of life; replace it when it has not answered the last request."""
        assert self._channel is not None  # noqa: S101 - the timer is replaced with the channel
        now_s = asyncio.get_running_loop().time()
        if self._ping is not None and now_s >= self._ping[0] + self._answer_s:
            self._lose("stuck")
            return
        if self._ping is None:
            self._ping = (now_s, self._roster.connections)
            with contextlib.suppress(OSError):  # no room: no answer will come
                self._channel.send(encode_ping())
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
            log.warning("guardian.missing", reason=reason)
        self._pause()

    def _pause(self) -> None:
        self._later(self._pause_s, self.start)
        self._pause_s = min(2 * self._pause_s, LONGEST_PAUSE_S)

    def _later(self, wait_s: float, act: Callable[..., None], *arguments: object) -> None:
        """The one thing that happens next by itself."""
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
        """Wait a moment for the process to end by itself, then end it."""
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
    """The process and the way to it. An OSError where it cannot be."""
    ours, theirs = map(_above_stdio, socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET))
    with theirs, contextlib.ExitStack() as undo:
        undo.callback(ours.close)
        with _signals_blocked():
            process = subprocess.Popen(  # noqa: S603 - every argument is our own
                [sys.executable, "-I", "-S", "-c", CODE, str(ROOT), str(theirs.fileno())],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                pass_fds=(theirs.fileno(),),
                start_new_session=True,
            )
        undo.pop_all()
    ours.setblocking(False)
    return ours, process


@contextlib.contextmanager
def _signals_blocked() -> Iterator[None]:
    """What is started meanwhile has them blocked for ever: those to the daemon's terminal or service are not for it."""
    before = signal.pthread_sigmask(signal.SIG_SETMASK, signal.valid_signals())
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _above_stdio(end: socket.socket) -> socket.socket:
    """A daemon that was started without stdin has its number free, and the process gets a stdin of its own there."""
    if end.fileno() > _STDERR:
        return end
    with end:
        return socket.socket(fileno=fcntl.fcntl(end.fileno(), fcntl.F_DUPFD_CLOEXEC, _STDERR + 1))


def _send(channel: socket.socket, record: bytes, descriptor: int | None) -> None:
    if descriptor is None:
        channel.send(record)
    else:
        socket.send_fds(channel, [record], [descriptor])
