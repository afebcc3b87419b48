"""Processes that stand for hardware go first: no busy computer stops a real board in the middle of a frame."""

import os

GOES_FIRST = ("nice", "-n", "-10") if os.geteuid() == 0 else ()  # before a command; only root may
