"""Run the tests in processes that are forked after the collection: `pytest --workers 8`.

Collecting all tests takes five seconds of CPU, and pytest-xdist does it in each worker.
"""

import contextlib
import os
import signal
import sys
import traceback
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from multiprocessing import Pipe
from multiprocessing.connection import Connection, wait

import pytest

SHARING = (  # their tests share what is slow to make: a daemon, a page, a compiled program, a large file, all sources
    "test_board_headers.py",
    "test_board_library.py",
    "test_diagnoses.py",
    "test_large_recordings.py",
    "test_page.py",
    "test_page_firefox.py",
    "test_page_hazards.py",
    "test_page_layout.py",
    "test_page_lost.py",
    "test_try_page.py",
    "test_words.py",
)
NUMBER = "PYTEST_WORKER"  # environment variable with the number of the worker
before_fork: list[Callable[[], None]] = []  # called before the workers start: what they share


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the number of workers."""
    parser.addoption("--workers", type=int, default=0, help="processes that run the tests; 0: this one")


@pytest.hookimpl(tryfirst=True)
def pytest_runtestloop(session: pytest.Session) -> bool | None:
    """Run the tests in workers, if there is more than one and the collection succeeded."""
    option = session.config.option
    if option.workers < 2 or option.collectonly or (session.testsfailed and not option.continue_on_collection_errors):
        return None
    for prepare in before_fork:
        prepare()
    pool = Pool(session)
    try:
        pool.run(option.workers)
    finally:
        pool.kill()
    return True


def shares(items: Iterable[pytest.Item]) -> deque[deque[int]]:
    """Return the places of the tests, those together that run in one worker."""
    found: dict[str, deque[int]] = {}
    for place, item in enumerate(items):
        path = item.nodeid.partition("::")[0]
        found.setdefault(path if path.endswith(SHARING) else f"{place}", deque()).append(place)
    return deque(found.values())


@dataclass(eq=False)
class Worker:
    """Process that runs tests; `given` has the test that it runs, and the one after that."""

    number: int
    pid: int
    connection: Connection
    given: deque[int] = field(default_factory=deque)
    share: deque[int] = field(default_factory=deque)
    is_last_given: bool = False


class Pool:
    """Workers that share the tests of a session. Each is given one test ahead, for pytest's `nextitem`."""

    def __init__(self, session: pytest.Session) -> None:
        self._session = session
        self._waiting = shares(session.items)
        self._workers: list[Worker] = []

    def run(self, count: int) -> None:
        """Run all tests. Report each as if it ran in this process."""
        if terminal := self._session.config.pluginmanager.get_plugin("terminalreporter"):
            terminal.showfspath = False
            terminal.flush()
        for number in range(min(count, len(self._waiting))):
            self._fork(number)
        while self._workers:
            for connection in wait([each.connection for each in self._workers]):
                self._receive(next(each for each in self._workers if each.connection is connection))
                if self._session.shouldfail:
                    raise self._session.Failed(self._session.shouldfail)
                if self._session.shouldstop:
                    raise self._session.Interrupted(self._session.shouldstop)

    def kill(self) -> None:
        """End the workers that still run."""
        for worker in self._workers:
            os.kill(worker.pid, signal.SIGKILL)
            os.waitpid(worker.pid, 0)

    def _fork(self, number: int) -> None:
        ours, theirs = Pipe()
        sys.stdout.flush()
        pid = os.fork()
        if pid == 0:
            for connection in (ours, *(each.connection for each in self._workers)):
                connection.close()
            _run_worker(self._session, number, theirs)
        theirs.close()
        worker = Worker(number, pid, ours)
        self._workers.append(worker)
        self._give(worker)
        self._give(worker)

    def _give(self, worker: Worker) -> None:
        """Give the worker one more test, or None if there are no more."""
        if not worker.share and self._waiting:
            worker.share = self._waiting.popleft()
        if worker.share:
            worker.given.append(worker.share.popleft())
            place = worker.given[-1]
        elif not worker.is_last_given:
            worker.is_last_given, place = True, None
        else:
            return
        with contextlib.suppress(ConnectionError):  # it has ended: its connection is still to be read
            worker.connection.send(place)

    def _receive(self, worker: Worker) -> None:
        config = self._session.config
        try:
            message = worker.connection.recv()
        except (EOFError, ConnectionError):
            self._bury(worker)
            return
        if message is not None:
            report = config.hook.pytest_report_from_serializable(config=config, data=message)
            config.hook.pytest_runtest_logreport(report=report)
            return
        item = self._session.items[worker.given.popleft()]
        config.hook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
        self._give(worker)

    def _bury(self, worker: Worker) -> None:
        """Remove a worker that has ended. If it ran a test, that test has failed, and another worker does the rest."""
        status = os.waitstatus_to_exitcode(os.waitpid(worker.pid, 0)[1])
        self._workers.remove(worker)
        worker.connection.close()
        if not worker.given:
            return
        item = self._session.items[worker.given.popleft()]
        text = f"the worker ended with status {status} while it ran this test"
        report = pytest.TestReport(item.nodeid, item.location, {}, "failed", text, "call")
        self._session.config.hook.pytest_runtest_logreport(report=report)
        worker.share.extendleft(reversed(worker.given))
        if worker.share:
            self._waiting.appendleft(worker.share)
        if self._waiting:
            self._fork(worker.number)


def _run_worker(session: pytest.Session, number: int, connection: Connection) -> None:
    """Run the tests whose places arrive, in a forked process, and end it."""
    try:
        os.environ[NUMBER] = str(number)
        _separate(session.config, number)
        session.config.pluginmanager.register(_Reports(session.config, connection))
        place = connection.recv()
        while place is not None:
            following = connection.recv()
            following_item = None if following is None else session.items[following]
            session.config.hook.pytest_runtest_protocol(item=session.items[place], nextitem=following_item)
            connection.send(None)
            place = following
    except BaseException:  # noqa: BLE001 - the parent reports that this process ended during a test
        traceback.print_exc()
        os._exit(1)
    os._exit(0)


def _separate(config: pytest.Config, number: int) -> None:
    """Give the process its own captured output, and its own folder for temporary files; nothing on the terminal."""
    capture = config.pluginmanager.get_plugin("capturemanager")
    capture.stop_global_capturing()
    with open(os.devnull, "w") as nothing:  # noqa: PTH123
        os.dup2(nothing.fileno(), 1)
    capture.start_global_capturing()
    capture.suspend_global_capture()
    factory = config._tmp_path_factory
    factory._basetemp = factory.getbasetemp() / f"worker-{number}"
    factory._basetemp.mkdir(exist_ok=True)


class _Reports:
    """Plugin of a worker that sends the reports to the parent."""

    def __init__(self, config: pytest.Config, connection: Connection) -> None:
        self._config, self._connection = config, connection

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Send a report."""
        self._connection.send(self._config.hook.pytest_report_to_serializable(config=self._config, report=report))
