"""The guardian's process with a daemon's side in the test: what it holds, what it writes, when it does not."""

import asyncio
import contextlib
import itertools
import os
import resource
import select
import signal
import socket
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Iterator
from pathlib import Path

import pytest
from structlog.testing import capture_logs

from hostlink.core.guardian.frames import stop_sequence
from hostlink.core.guardian.guardian import CODE, Guardian, _spawn
from hostlink.core.guardian.records import GOODBYE, MAX_FRAMES_BYTES, PING, WATCH
from hostlink.core.guardian.records import encode as encode_record
from hostlink.core.protocol.rosserial.frame import STOP_REQUEST, encode
from tests.support.killing import guarded_by
from tests.support.logs import logged
from tests.support.process import is_running
from tests.support.pty_pair import pty_pair
from tests.support.rosserial_stop import rosserial_stop
from tests.support.stopwatch import Stopwatch
from tests.support.waiting import TIMEOUT_S, expect

ZERO = encode(100, bytes(48))
OTHER = encode(107, bytes(92))
SEQUENCE = b"".join(part for _, part in stop_sequence(rosserial_stop((ZERO,))))
ROBOTS = 200
MORE_KIB = 2048  # than the interpreter takes by itself, which differs from version to version
SIGNALS = signal.valid_signals() - {signal.SIGKILL, signal.SIGSTOP}


class Peer:
    """The device's end of a connection that the daemon has."""

    def __init__(self, ours: socket.socket, theirs: socket.socket) -> None:
        self.ours, self.theirs = ours, theirs

    def read_all(self) -> tuple[bytes, float]:
        """Read until the end. Return the bytes, and how long the first byte took."""
        self.theirs.settimeout(5)
        data, began_s, first_s = b"", time.monotonic(), float("inf")
        while part := self.theirs.recv(65536):
            first_s = min(first_s, time.monotonic() - began_s)
            data += part
        return data, first_s


@contextlib.contextmanager
def connections(count: int = 1) -> Iterator[list[Peer]]:
    """TCP connections: the daemon's ends and the devices'."""
    with contextlib.ExitStack() as ends:
        listener = ends.enter_context(socket.create_server(("127.0.0.1", 0), backlog=count))
        peers = []
        for _ in range(count):
            theirs = ends.enter_context(socket.create_connection(listener.getsockname()))
            ours = ends.enter_context(listener.accept()[0])
            ours.setblocking(False)
            peers.append(Peer(ours, theirs))
        yield peers


@contextlib.asynccontextmanager
async def guardian(**times: float) -> AsyncIterator[Guardian]:
    """A running one; it is said goodbye to at the end, if it is not over."""
    ours = Guardian(**times)
    ours.start()
    try:
        yield ours
    finally:
        ours.goodbye()


def pid(ours: Guardian) -> int:
    assert ours._process is not None
    return ours._process.pid


def watch(ours: Guardian, peers: list[Peer]) -> None:
    for number, peer in enumerate(peers):
        ours.watch(number, lambda peer=peer: peer.ours.fileno(), rosserial_stop((ZERO,)))


def descriptors(number: int) -> list[str]:
    return sorted(str(link.readlink()).split(":")[0] for link in Path(f"/proc/{number}/fd").iterdir())


def memory_kib(number: int) -> dict[str, int]:
    return parsed_kib(Path(f"/proc/{number}/smaps_rollup").read_text())


def interpreter_kib() -> int:
    """Return the memory of a Python interpreter that does nothing."""
    code = "print(open('/proc/self/smaps_rollup').read())"
    bare = subprocess.run([sys.executable, "-I", "-S", "-c", code], capture_output=True, text=True, check=True)
    return parsed_kib(bare.stdout)["Rss"]


def parsed_kib(rollup: str) -> dict[str, int]:
    lines = rollup.splitlines()
    return {line.split(":")[0]: int(line.split()[1]) for line in lines if line.endswith("kB")}


def guarded(ours: Guardian) -> int:
    """Return the number of connections that the guardian holds; -1 while it starts, or waits for its start."""
    return -1 if ours._process is None else guarded_by(pid(ours))


async def test_a_daemon_that_is_gone_leaves_zeros_then_id_11_then_the_end() -> None:
    with connections() as (peer,):
        async with guardian() as ours:
            watch(ours, [peer])
            peer.ours.close()
            ours.abandon()
        assert peer.read_all()[0] == SEQUENCE
        assert 3 * ZERO + STOP_REQUEST == SEQUENCE


async def test_every_velocity_topic_of_a_device_is_stopped() -> None:
    with connections(1) as (peer,):
        async with guardian() as ours:
            ours.watch(1, peer.ours.fileno, rosserial_stop((ZERO, OTHER)))
            await expect(lambda: guarded(ours) == 1)
            ours.abandon()
        assert peer.read_all()[0] == 3 * (ZERO + b"\0" + OTHER) + STOP_REQUEST


async def test_a_serial_port_gets_the_same_and_is_free_afterwards() -> None:
    with pty_pair() as (device, path):
        port = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        async with guardian() as ours:
            ours.watch(1, lambda: port, rosserial_stop((ZERO,)))
            await expect(lambda: guarded(ours) == 1)  # the start of an interpreter is not measured
            lasted = Stopwatch()
            ours.abandon()
            assert lasted.seconds < 0.4  # it waits for no peer to close
        os.close(port)
        assert os.read(device, 1000) == SEQUENCE


async def test_after_a_goodbye_nothing_is_written() -> None:
    with connections() as (peer,):
        async with guardian() as ours:
            watch(ours, [peer])
            number = pid(ours)
        assert not is_running(number)
        peer.ours.close()
        assert peer.read_all()[0] == b""


async def test_a_released_connection_is_closed_and_nothing_is_written_to_it() -> None:
    with connections(2) as peers:
        async with guardian() as ours:
            watch(ours, peers)
            await expect(lambda: guarded(ours) == 2)
            ours.release(0)
            peers[0].ours.close()
            assert peers[0].read_all()[0] == b""  # the connection ended, so the guardian does not hold it
            ours.abandon()
        assert peers[1].read_all()[0] == SEQUENCE


async def test_a_link_that_gets_another_velocity_topic_is_stopped_by_that_one() -> None:
    with connections() as (peer,):
        async with guardian() as ours:
            watch(ours, [peer])
            ours.watch(0, peer.ours.fileno, rosserial_stop((OTHER,)))
            peer.ours.close()
            ours.abandon()
        assert peer.read_all()[0] == 3 * OTHER + STOP_REQUEST


async def test_two_hundred_robots_stop_at_once_and_one_that_reads_nothing_delays_none() -> None:
    with connections(ROBOTS) as peers:
        async with guardian() as ours:
            watch(ours, peers)
            with contextlib.suppress(BlockingIOError):
                while True:
                    peers[0].ours.send(bytes(65536))
            await expect(lambda: guarded(ours) == ROBOTS)
            for peer in peers:
                peer.ours.close()
            assert ours._channel is not None
            lasted = Stopwatch(pid(ours))
            ours._channel.shutdown(socket.SHUT_RDWR)  # as the kernel does when the daemon is gone
            for peer in peers[1:]:
                peer.theirs.settimeout(5)
                assert peer.theirs.recv(56) == ZERO
            assert lasted.seconds < 0.2
            for peer in peers[1:]:
                assert peer.read_all()[0] == SEQUENCE[56:]


async def test_device_that_keeps_sending_reads_all_before_its_connection_ends() -> None:
    with connections() as (peer,):
        peer.theirs.sendall(bytes(100_000))
        async with guardian() as ours:
            watch(ours, [peer])
            peer.ours.close()
            ours.abandon()
        assert peer.read_all()[0] == SEQUENCE


HANG = b"".join(part for _, part in stop_sequence(rosserial_stop((ZERO,), end=b"")))


def waiting_bytes(peer: Peer) -> bytes:
    """Return the received bytes without waiting."""
    peer.theirs.setblocking(False)
    try:
        return peer.theirs.recv(65536)
    except BlockingIOError:
        return b""


async def received(peer: Peer, wanted: bytes) -> None:
    """Wait for these bytes, and no others before them."""
    data = b""
    async with asyncio.timeout(TIMEOUT_S):
        while len(data) < len(wanted):
            data += waiting_bytes(peer)
            await asyncio.sleep(0.005)
    assert data == wanted


async def test_guardian_of_a_hanging_daemon_sends_zeros_to_driven_robots_and_keeps_their_connections() -> None:
    with connections(2) as peers, capture_logs() as lines:
        async with guardian(ping_s=0.05) as ours:
            watch(ours, peers)
            ours.beat({0})
            began_s = time.monotonic()
            await received(peers[0], HANG)
            assert time.monotonic() - began_s > 0.9  # and not sooner
            assert waiting_bytes(peers[1]) == b""  # it is not driven
            peers[0].theirs.send(b"for the daemon")
            assert peers[0].ours.recv(100) == b"for the daemon"
            peers[0].ours.send(b"by the daemon")
            await received(peers[0], b"by the daemon")
            await expect(lambda: any(line["event"] == "guardian.stopped_robots" for line in lines))
            ours.beat({0})  # the daemon continues, and hangs again
            await received(peers[0], HANG)
            for peer in peers:
                peer.ours.close()
            ours.abandon()  # and now it is killed
        for peer in peers:
            peer.theirs.setblocking(True)
            assert peer.read_all()[0] == SEQUENCE
    assert [line["robots"] for line in lines if line["event"] == "guardian.stopped_robots"][:1] == [1]


async def test_guardian_of_a_daemon_that_beats_or_drives_no_robot_sends_nothing() -> None:
    with connections() as (peer,):
        async with guardian() as ours:
            watch(ours, [peer])
            beats_s = []
            for _ in range(12):
                ours.beat({0})
                beats_s.append(time.monotonic())
                await asyncio.sleep(0.1)
            ours.beat(set())
            await asyncio.sleep(1.2)
            was_paused = any(later_s - before_s > 0.5 for before_s, later_s in itertools.pairwise(beats_s))
            assert waiting_bytes(peer) == b"" or was_paused


async def test_a_daemon_that_hangs_while_its_guardian_was_replaced_is_noticed_by_the_next_one() -> None:
    with connections() as (peer,), capture_logs() as lines:
        async with guardian() as ours:
            watch(ours, [peer])
            ours.beat({0})
            os.kill(pid(ours), signal.SIGKILL)
            await expect(lambda: sum(line["event"] == "guardian.started" for line in lines) == 2)
            await received(peer, HANG)  # without any further beat


async def test_a_device_that_reads_nothing_delays_no_other_when_the_daemon_hangs() -> None:
    with connections(2) as peers:
        async with guardian() as ours:
            watch(ours, peers)
            with contextlib.suppress(BlockingIOError):
                while True:
                    peers[0].ours.send(bytes(65536))
            ours.beat({0, 1})
            await received(peers[1], HANG)


async def test_a_guardian_that_is_killed_is_replaced_by_one_that_guards_everything_again() -> None:
    with connections(3) as peers, capture_logs() as lines:
        async with guardian() as ours:
            watch(ours, peers)
            await expect(lambda: guarded(ours) == 3)
            first = pid(ours)
            os.kill(first, signal.SIGKILL)
            await expect(lambda: sum(line["event"] == "guardian.started" for line in lines) == 2)
            assert pid(ours) != first
            for peer in peers:
                peer.ours.setblocking(False)
            await expect(lambda: guarded(ours) == 3)
            for peer in peers:
                peer.ours.close()
            ours.abandon()
        assert [peer.read_all()[0] for peer in peers] == [SEQUENCE] * 3
    ended = next(line for line in lines if line["event"] == "guardian.ended")
    assert (ended["status"], ended["reason"], ended["restarts"]) == (-signal.SIGKILL, "ended", 1)


async def test_a_guardian_that_does_not_answer_is_replaced() -> None:
    with connections() as (peer,), capture_logs() as lines:
        async with guardian(
            ping_s=0.02, answer_s=1.0
        ) as ours:  # on a busy machine the new one is slow, and replaced, too
            os.kill(pid(ours), signal.SIGSTOP)
            watch(ours, [peer])
            await expect(lambda: sum(line["event"] == "guardian.started" for line in lines) >= 2 and guarded(ours) == 1)
    assert next(line for line in lines if line["event"] == "guardian.ended")["reason"] == "stuck"


async def test_a_stopped_guardian_delays_no_link_and_no_goodbye() -> None:
    with connections() as (peer,):
        async with guardian() as ours:
            number = pid(ours)
            os.kill(number, signal.SIGSTOP)
            lasted = Stopwatch()
            for turn in range(5000):  # more than its queue takes
                ours.watch(turn, peer.ours.fileno, rosserial_stop((ZERO,)))
                ours.release(turn)
            assert lasted.seconds < 2.0
            ours.goodbye()
            assert not is_running(number)
            peer.ours.close()
            assert peer.read_all()[0] == b""


async def test_a_guardian_without_descriptors_reports_it_and_stops_those_that_it_has() -> None:
    with connections(3) as peers, capture_logs() as lines:
        async with guardian(ping_s=0.02) as ours:
            await expect(lambda: guarded(ours) == 0)
            watch(ours, peers[:1])
            await expect(lambda: guarded(ours) == 1)
            resource.prlimit(pid(ours), resource.RLIMIT_NOFILE, (5, 5))  # numbers 3 and 4
            watch(ours, peers)
            await expect(lambda: any(line["event"] == "guardian.incomplete" for line in lines))
            for peer in peers:
                peer.ours.close()
            ours.abandon()
        assert peers[0].read_all()[0] == SEQUENCE
    incomplete = [line for line in lines if line["event"] == "guardian.incomplete"]
    assert [(line["connections"], line["robots"]) for line in incomplete] == [(2, 3)]


async def test_frames_that_do_not_fit_are_dropped_with_one_warning_and_the_others_are_written() -> None:
    with connections() as (peer,), capture_logs() as lines:
        async with guardian() as ours:
            for _ in range(3):
                zeros = [ZERO, bytes(MAX_FRAMES_BYTES), OTHER]
                ours.watch(0, peer.ours.fileno, rosserial_stop(zeros))
            await expect(lambda: guarded(ours) == 1)
            peer.ours.close()
            ours.abandon()
        assert peer.read_all()[0] == 3 * (ZERO + b"\0" + OTHER) + STOP_REQUEST
    dropped = [line for line in lines if line["event"] == "guardian.frames_dropped"]
    assert [(line["link"], line["guarded"]) for line in dropped] == [(0, 2)]


async def test_the_longest_record_reaches_the_process_and_an_empty_end_is_not_written() -> None:
    zero = bytes(range(1, 256)) * 16
    with connections() as (peer,):
        async with guardian() as ours:
            ours.watch(0, peer.ours.fileno, rosserial_stop([zero], end=b""))
            await expect(lambda: guarded(ours) == 1)
            peer.ours.close()
            ours.abandon()
        assert peer.read_all()[0] == 3 * zero


async def test_a_daemon_without_descriptors_starts_its_guardian_when_it_has_some() -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    with connections() as (peer,), capture_logs() as lines:
        ours = Guardian()
        watch(ours, [peer])
        resource.setrlimit(resource.RLIMIT_NOFILE, (3, hard))
        try:
            ours.start()
        finally:
            resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
        assert logged(lines) == ["guardian.start_failed"]
        await expect(lambda: any(line["event"] == "guardian.started" for line in lines))
        await expect(lambda: guarded(ours) == 1)
        ours.goodbye()


@pytest.mark.parametrize("is_orderly", [True, False])
async def test_answers_that_the_daemon_did_not_read_do_not_hide_its_last_words(*, is_orderly: bool) -> None:
    """The kernel tells of them before it gives out what still waits: ECONNRESET."""
    with connections() as (peer,):
        channel, process = _spawn()
        with channel:
            socket.send_fds(channel, [encode_record(WATCH, 1, rosserial_stop((ZERO,)))], [peer.ours.fileno()])
            channel.send(encode_record(PING))
            await expect(lambda: guarded_by(process.pid) == 1)
            await expect(lambda: select.select([channel], [], [], 0)[0])  # the answer waits
            os.kill(process.pid, signal.SIGSTOP)
            if is_orderly:
                channel.send(encode_record(GOODBYE))
        peer.ours.close()
        os.kill(process.pid, signal.SIGCONT)
        assert peer.read_all()[0] == (b"" if is_orderly else SEQUENCE)
        assert process.wait(5) == 0


async def test_signals_to_the_whole_group_or_service_do_not_end_it() -> None:
    with connections() as (peer,):
        async with guardian() as ours:
            watch(ours, [peer])  # it has just been started
            for number in SIGNALS:
                os.kill(pid(ours), number)
            assert os.getsid(pid(ours)) == pid(ours)
            peer.ours.close()
            ours.abandon()
        assert peer.read_all()[0] == SEQUENCE


async def test_guardian_has_only_its_own_descriptors_and_little_memory() -> None:
    async with guardian() as ours:
        await expect(lambda: guarded(ours) == 0)
        assert descriptors(pid(ours)) == ["/dev/null", "/dev/null", "/dev/null", "socket"]
        sizes = memory_kib(pid(ours))
        with connections(ROBOTS) as peers:  # more memory for more robots, and for longer frames, would be too much
            for number, peer in enumerate(peers):
                zeros = [encode(100 + number + each, bytes(92)) for each in range(4)]  # of four TwistStamped
                ours.watch(number, peer.ours.fileno, rosserial_stop(zeros, 65543))
            await expect(lambda: guarded(ours) == ROBOTS)
            with_robots = memory_kib(pid(ours))
        most_kib = interpreter_kib() + MORE_KIB
        assert with_robots["Rss"] < most_kib
        print(f"with {ROBOTS} robots {with_robots['Rss']} KiB")  # noqa: T201
        print(f"resident {sizes['Rss']} KiB, of that its share {sizes['Pss']} KiB")  # noqa: T201
        assert sizes["Rss"] < most_kib


def test_guardian_program_imports_the_standard_library_alone() -> None:
    """-I and -S: no site-packages; the modules that are there afterwards are few."""
    listing = "; import sys; sys.stdout.write(' '.join(sys.modules))"
    code = CODE.replace("main(int(sys.argv[2]))", "pass") + listing
    root = Path(__file__).parents[2]
    python = [sys.executable, "-I", "-S", "-c", code, str(root)]
    modules = set(subprocess.run(python, capture_output=True, text=True, check=True).stdout.split())
    assert not modules & {
        "socket",
        "signal",
        "enum",
        "asyncio",
        "logging",
        "typing",
        "dataclasses",
        "numpy",
        "structlog",
    }
    assert {name for name in modules if name.startswith("hostlink.")} == {
        "hostlink.core",
        "hostlink.core.guardian",
        "hostlink.core.runtime",
        "hostlink.core.runtime.remains",
        "hostlink.core.runtime.stop_frames",
        *(f"hostlink.core.guardian.{part}" for part in ("process", "connection", "frames", "records")),
    }
