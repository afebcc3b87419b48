"""The daemon's core in a simulated world: a seed repeats a run to the last line of its log.

`run.play(seed, seconds)` runs hub, links, sessions, admission and a component in one virtual loop, with boards and
programs outside of it, and returns the log and what `oracle.py` found. `python -m tests.support.simulation 7` prints
the run of seed 7.
"""
