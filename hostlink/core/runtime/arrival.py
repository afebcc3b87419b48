"""Arrival: how old the bytes may be that are read now. Pure.

The time of reading is not the time of arrival: bytes wait in a buffer, for a turn of the event loop, in the kernel, and
in the kernel of a sender that writes more than is read. Each way in that carries velocities asks one question after
each read: may there be more behind what was read? While there may, what is read next may be as old as what was read
before. `Admission` refuses a velocity that may be older than its lease.
"""

SETTLE_S = 0.02  # within which what waited behind a read follows it: a round trip, a worker of the kernel
CALM_S = 0.1  # a sender that writes all the time, and whose bytes wait less than SETTLE_S each time, is not behind


class Arrival:
    """Earliest arrival of the bytes of one source. `arrive` when there are bytes, `leave` when all of them were read.

    | since bytes waited first | may more be behind?        | next bytes                                        |
    |--------------------------|----------------------------|---------------------------------------------------|
    | less than SETTLE_S       | no                         | are new                                           |
    | less than SETTLE_S       | yes                        | may be as old, unless `settle` is called before   |
    | longer                   | yes or no, because more    | the same; are new after CALM_S in which all bytes |
    |                          | may wait at the sender     | were read within SETTLE_S and none were behind    |
    """

    __slots__ = ("_began_s", "_calm_s", "_came_s", "_is_waiting", "_number", "_since_s")

    def __init__(self, behind_since_s: float | None = None) -> None:
        """`behind_since_s`: the first bytes may have waited since then; None: they have not."""
        self._since_s = behind_since_s  # the earliest arrival of what is read; None: nothing waits, here or there
        self._is_waiting = False  # between `arrive` and `leave`
        self._number = 0  # of the newest `arrive` that found nothing waiting here
        self._came_s = 0.0  # its time
        self._began_s: float | None = None  # time of the first one since something waits, here or there
        self._calm_s: float | None = None  # of the first `leave` since then that was followed by no long wait

    def arrive(self, now_s: float) -> float:
        """Note that there are bytes, and return their earliest arrival. `now_s`: when they came, if none waited."""
        if self._since_s is None:
            self._since_s = now_s
        if not self._is_waiting:
            self._is_waiting, self._came_s = True, now_s
            self._number += 1
            if self._began_s is None:
                self._began_s = now_s
        return self._since_s

    def leave(self, now_s: float, *, is_more: bool) -> int:
        """Note that all bytes were read. `is_more`: the system may have more of them.

        Return a number for `settle`; 0 if the next bytes are new.
        """
        if not self._is_waiting or self._began_s is None:
            return 0
        self._is_waiting = False
        is_calm = not is_more and now_s < self._came_s + SETTLE_S
        if is_calm and (
            now_s < self._began_s + SETTLE_S or (self._calm_s is not None and now_s >= self._calm_s + CALM_S)
        ):
            self._since_s = self._began_s = self._calm_s = None  # as `_forget`
            return 0
        self._calm_s = None if not is_calm else now_s if self._calm_s is None else self._calm_s
        return self._number

    def settle(self, number: int) -> None:
        """Note that the event loop has read for SETTLE_S after the `leave` that returned this number.

        By a clock alone this cannot be known: a process that did not run has read nothing.
        """
        if number == self._number and not self._is_waiting:
            self._forget()

    def _forget(self) -> None:
        self._since_s = self._began_s = self._calm_s = None
