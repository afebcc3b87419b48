"""Processes that stand for hardware go first: no busy computer stops a real board in the middle of a frame. Those that
stand for programs of other computers go last: they load the daemon, and take no core from what is measured.
"""

import os

GOES_FIRST = ("nice", "-n", "-10") if os.geteuid() == 0 else ()  # before a command; only root may
GOES_LAST = ("nice", "-n", "10")
