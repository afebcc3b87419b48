"""End of a program: the calls that each connection receives."""

import concurrent.futures
import threading
import time
from collections.abc import Callable

from hostlink.client import loop_thread
from hostlink.client.driver import Repeated
from tests.support.stopwatch import Stopwatch


class SilentConnection:
    """Connection to a daemon that does not answer."""

    def __init__(self, order: list[str]) -> None:
        self._order = order

    def begin_stop(self, is_meant: Callable[[Repeated], bool] | None = None) -> concurrent.futures.Future[None]:
        is_of_ended_threads = is_meant is Repeated.is_of_ended_thread
        self._order.append("stop what ended threads drove" if is_of_ended_threads else "stop")
        return concurrent.futures.Future()

    def end(self) -> None:
        self._order.append("end")

    def finish(self) -> None:
        self._order.append("finished")


def test_a_daemon_that_does_not_answer_delays_no_stop_at_another() -> None:
    order: list[str] = []
    connections = [SilentConnection(order) for _ in range(3)]
    for connection in connections:
        loop_thread._watched.add(connection)
    watch = Stopwatch()
    loop_thread._stop_all(timeout_s=0.05)
    assert watch.seconds < 1.0
    assert order == ["stop"] * 3
    loop_thread._finish_all()
    assert order[3:] == ["end"] * 3 + ["finished"] * 3


def test_the_end_of_the_main_thread_stops_only_what_ended_threads_drove() -> None:
    order: list[str] = []
    connection = SilentConnection(order)
    loop_thread._watched.add(connection)
    thread = threading.Thread(target=time.sleep, args=(0.01,))
    thread.start()
    loop_thread._stop_behind(thread)
    loop_thread._watched.discard(connection)
    assert order == ["stop what ended threads drove"]
