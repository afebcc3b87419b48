"""What is declared follows what is wanted, in steps."""

import asyncio
from dataclasses import dataclass, field

from hostlink.errors import ConfigError
from hostlink.graphs.zenoh.rmw_declared import Declared
from tests.support.virtual_loop import VirtualLoop, run_virtual

COST_S = 0.001  # of a declaration, and of its end


@dataclass
class Zenoh:
    """What is declared in it, in order."""

    present: list[str] = field(default_factory=list)
    is_closed: bool = False

    def declare(self, key: str) -> "Declaration":
        burn()
        if self.is_closed:
            raise ConfigError("zenoh", "the session is closed")
        self.present.append(key)
        return Declaration(self, key)


@dataclass
class Declaration:
    zenoh: Zenoh
    key: str

    def close(self) -> None:
        burn()
        self.zenoh.present.remove(self.key)


def burn() -> None:
    loop = asyncio.get_running_loop()
    assert isinstance(loop, VirtualLoop)
    loop.burn(COST_S)


def until_s(seconds: float) -> float:
    return asyncio.get_running_loop().time() + seconds


def test_a_step_ends_in_time_and_the_next_goes_on() -> None:
    async def test() -> None:
        zenoh = Zenoh()
        declared = Declared(zenoh.declare)
        declared.follow(f"/topic_{number}" for number in range(10))
        began_s = until_s(0)
        assert declared.step(until_s(0.003))
        assert until_s(0) - began_s <= 0.003 + COST_S
        assert zenoh.present == ["/topic_0", "/topic_1", "/topic_2"]
        while declared.step(until_s(0.003)):
            pass
        assert len(zenoh.present) == len(declared) == 10

    run_virtual(test())


def test_what_is_not_wanted_any_more_goes_first_and_what_stays_is_left_alone() -> None:
    async def test() -> None:
        zenoh = Zenoh()
        declared = Declared(zenoh.declare)
        declared.follow(["/a", "/b", "/c"])
        assert not declared.step(until_s(1))
        declared.follow(["/d", "/b"])
        assert declared.step(until_s(COST_S / 2))
        assert zenoh.present == ["/b", "/c"]
        assert not declared.step(until_s(1))
        assert zenoh.present == ["/b", "/d"]

    run_virtual(test())


def test_what_was_wanted_for_a_moment_is_never_declared() -> None:
    async def test() -> None:
        zenoh = Zenoh()
        declared = Declared(zenoh.declare)
        declared.follow(["/a"])
        declared.follow([])
        assert not declared.step(until_s(1))
        assert zenoh.present == []

    run_virtual(test())


def test_a_closed_session_is_tried_again_with_the_next_step() -> None:
    async def test() -> None:
        zenoh = Zenoh(is_closed=True)
        declared = Declared(zenoh.declare)
        declared.follow(["/a", "/b"])
        assert not declared.step(until_s(1))
        zenoh.is_closed = False
        assert not declared.step(until_s(1))
        assert zenoh.present == ["/a", "/b"]

    run_virtual(test())


def test_the_end_withdraws_everything() -> None:
    async def test() -> None:
        zenoh = Zenoh()
        declared = Declared(zenoh.declare)
        declared.follow(["/a", "/b", "/c"])
        declared.step(until_s(1))
        declared.close()
        assert zenoh.present == []
        assert not declared.step(until_s(1))
        assert zenoh.present == []

    run_virtual(test())
