"""UvLoop: uvloop's event loop with the clock and the timers of asyncio's."""

import math
import time
from asyncio import TimerHandle
from collections.abc import Callable
from contextvars import Context
from typing import TypeVarTuple

import uvloop

Ts = TypeVarTuple("Ts")
MS_PER_S = 1000


class UvLoop(uvloop.Loop):
    """uvloop with a clock of nanoseconds, and with timers that are never early.

    uvloop's own clock counts whole milliseconds, and it rounds a timer to the nearest one. A turn of FairShare lasts
    0.2 ms, so each piece of work would cost 0 or 1 ms. A message that is held back until a time is sent by a timer, and
    would stay in its queue if the timer fired before that time.
    """

    name = "uvloop"
    time = staticmethod(time.monotonic)

    def call_at(
        self, when: float, callback: Callable[[*Ts], object], *args: *Ts, context: Context | None = None
    ) -> TimerHandle:
        """Call back in the first millisecond of uvloop's clock that is not before `when`, as asyncio does."""
        wait_ms = math.ceil(when * MS_PER_S) - round(super().time() * MS_PER_S) if math.isfinite(when) else math.inf
        return super().call_later(max(1, wait_ms) / MS_PER_S, callback, *args, context=context)

    def call_later(
        self, delay: float, callback: Callable[[*Ts], object], *args: *Ts, context: Context | None = None
    ) -> TimerHandle:
        """Call back after `delay` seconds."""
        return self.call_at(time.monotonic() + delay, callback, *args, context=context)
