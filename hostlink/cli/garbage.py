"""Memory of the daemon: short pauses of the garbage collector and of other threads, large blocks that are returned."""

import asyncio
import contextlib
import ctypes
import gc
import sys

from hostlink.core.hub.robots import Robots

SWITCH_INTERVAL_S = 0.0005  # a tenth of Python's default
M_MMAP_THRESHOLD = -3  # of malloc.h
LARGE_BYTES = 128 * 1024  # glibc's own threshold at the start
# Often, so that each collection lasts a millisecond or two; the oldest generation after 50,000 objects.
GC_THRESHOLDS = (100, 5, 100)
CHECK_INTERVAL_S = 1.0
WHOLE_INTERVAL_S = 60.0  # between two looks at all objects while little is freed: 0.25 s with a thousand robots
REST_S = 10.0  # before all objects are looked at: a stop between two drives would wait for that long
RESTLESS_S = 600.0  # between two such looks while robots never rest for so long
ENOUGH = 20  # collections of the younger generation: about a hundred connections since the last full one
WORTH = 1000  # collected objects: those of a dozen connections


def shorten_pauses() -> None:
    """Keep the garbage collector and other threads from stopping the loop.

    The daemon makes no cycles, and objects of the start live for ever: with a thousand robots a full collection took
    0.23 s, ten times as long as a stop may wait. A thread that examines bytes holds the loop up for an interval.
    """
    gc.collect()
    gc.freeze()
    gc.set_threshold(*GC_THRESHOLDS)
    sys.setswitchinterval(SWITCH_INTERVAL_S)


def return_large_blocks() -> None:
    """Return the memory of large messages to the system when they are deleted.

    glibc returns a freed block of LARGE_BYTES once, then keeps blocks of that size in its heap, where small objects
    between them hold the rest: 30 programs with 4 latched messages of 900 KB each left 40 to 48 MiB behind, and 10 MiB
    with a fixed threshold. Other C libraries have no such function, or ignore the option.
    """
    with contextlib.suppress(AttributeError):
        ctypes.CDLL(None).mallopt(M_MMAP_THRESHOLD, LARGE_BYTES)


async def collect_while_idle(robots: Robots) -> None:
    """Collect garbage while nothing moves, until cancelled.

    Many robots make enough objects for a collection each second, but leave no cycles behind. The objects that such a
    collection leaves are therefore not looked at again before WHOLE_INTERVAL_S, or before a collection frees much;
    and only while all robots have been at rest for REST_S, or after RESTLESS_S.
    """
    now_s = asyncio.get_running_loop().time
    whole_at_s = rested_at_s = now_s()
    has_freed_much = is_left = False  # is_left: what was frozen while it was in use may be garbage by now
    while True:
        await asyncio.sleep(CHECK_INTERVAL_S)
        if robots.may_move(now_s()):
            rested_at_s = now_s() + REST_S
            continue
        is_due = now_s() >= whole_at_s or has_freed_much
        is_whole = (is_due and now_s() >= rested_at_s) or now_s() >= whole_at_s + RESTLESS_S
        has_worked = gc.get_count()[2] >= ENOUGH
        if not has_worked and not (is_left and is_whole):
            continue
        if is_whole:
            gc.unfreeze()
            whole_at_s = now_s() + WHOLE_INTERVAL_S
        is_left = has_worked
        has_freed_much = gc.collect() >= WORTH
        gc.freeze()  # Python collects by itself, too, also while a robot moves
