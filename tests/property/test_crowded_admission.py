"""Admission in a crowd: a stream that continues through an interruption moves no robot, with a record or without."""

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.core.robot.admission import LEASE_S, MAX_SOURCES, Admission, Command
from hostlink.core.robot.velocity import ZERO, PlanarVelocity

FORWARD = PlanarVelocity(0.2)
TICK_S = 0.05
STREAMS = MAX_SOURCES + 4


@pytest.mark.slow
@given(st.integers(0, 2**32), st.sampled_from(["stop", "lock", "pause", "reconnect"]))
def test_stream_through_an_interruption_is_refused_until_it_is_silent_for_a_lease(seed: int, event: str) -> None:
    chance = random.Random(seed)
    admission, now_s = Admission("rover"), 100.0
    admission.connect(now_s)
    periods = {number: chance.choice([1, 1, 2, 4, 9]) for number in range(STREAMS)}  # ticks, shorter than a lease
    priorities = {number: chance.choice([0, 50, 50, 100]) for number in range(STREAMS)}
    begins = {number: chance.randrange(20) for number in range(STREAMS)}
    ends = {number: chance.randrange(20, 80) for number in range(STREAMS)}
    at = chance.randrange(21, 40)
    was_commanding: set[int] = set()
    last: dict[int, int] = {}
    for tick in range(80):
        now_s += TICK_S
        if tick == at:
            was_commanding = {number for number, before in last.items() if tick - before < LEASE_S / TICK_S - 1e-9}
            match event:
                case "stop":
                    admission.interrupt(now_s, came_s=now_s)
                case "lock":
                    admission.lock("smoke", now_s)
                    admission.unlock(now_s)
                case "pause":
                    admission.interrupt(now_s, since_s=now_s, came_s=now_s)
                case "reconnect":
                    admission.disconnect(now_s)
                    admission.connect(now_s)
        for number in chance.sample(range(STREAMS), STREAMS):
            if not begins[number] <= tick <= ends[number] or (tick - begins[number]) % periods[number]:
                if tick > ends[number] and number in last and chance.random() < 0.3:
                    admission.withdraw(number)
                    last.pop(number)
                    was_commanding.discard(number)
                continue
            if chance.random() < 0.02:
                admission.decide(Command(ZERO, number, priorities[number], now_s), now_s)
                last.pop(number, None)
                was_commanding.discard(number)
                continue
            last[number] = tick
            decision = admission.decide(Command(FORWARD, number, priorities[number], now_s), now_s)
            assert not (decision.is_admitted and tick >= at and number in was_commanding), (number, tick)
