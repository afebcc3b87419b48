"""Declared: what is declared in the session, a few milliseconds' worth in each turn of the loop."""

import asyncio
import contextlib
from collections.abc import Callable, Iterable
from typing import Generic, Protocol, TypeVar

from hostlink.errors import ConfigError


class Closing(Protocol):
    """What is declared until it is closed."""

    def close(self) -> None:
        """Withdraw it."""


Key = TypeVar("Key")
Value = TypeVar("Value", bound=Closing)


class Declared(Generic[Key, Value]):
    """Keeps what is declared equal to what is wanted. A hundred robots that come at once cost a second of Zenoh's."""

    def __init__(self, make: Callable[[Key], Value]) -> None:
        """`make` declares; a ConfigError of it means that the session is closed."""
        self._make = make
        self._present: dict[Key, Value] = {}
        self._wanted: dict[Key, None] = {}

    def __len__(self) -> int:
        return len(self._present)

    def follow(self, wanted: Iterable[Key]) -> None:
        """Declare these, and no others, with the next steps."""
        self._wanted = dict.fromkeys(wanted)

    def step(self, until_s: float) -> bool:
        """Withdraw and declare until this time of the loop; returns whether something is left to do."""
        now_s = asyncio.get_running_loop().time
        for key in [key for key in self._present if key not in self._wanted]:
            self._present.pop(key).close()
            if now_s() >= until_s:
                return True
        for key in [key for key in self._wanted if key not in self._present]:
            with contextlib.suppress(ConfigError):
                self._present[key] = self._make(key)
            if now_s() >= until_s:
                return True
        return False

    def close(self) -> None:
        """Withdraw everything."""
        self._wanted.clear()
        while self._present:
            self._present.popitem()[1].close()
