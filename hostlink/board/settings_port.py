"""Reads and sets what a board keeps, over its serial port: requests are repeated until they are answered."""

import asyncio
import time
from collections.abc import Mapping
from typing import Final

from hostlink.board.settings import SETTINGS, AnswerReader, assignment, check_value, request_line, value_of
from hostlink.errors import HostlinkError
from hostlink.transport.base import Transport

TRY_S: Final = 1.0  # for a slow loop of the sketch
EXCHANGE_BITS: Final = 10_000  # the longest request and its answer: 1,000 bytes of 10 bits
STORE_TRIES: Final = 3
LOST: Final = "error lost"
NUMBERS: Final = 65536
_ERRORS: Final = {
    "unknown": "its sketch does not know this setting: flash one with the library of today",
    "short": "too short",
    "long": "too long",
    "value": "not a value for it",
    "stored": "its flash accepts nothing: is the EEPROM of the sketch large enough?",
}


class BoardSettings:
    """The settings of the board on one port."""

    def __init__(self, transport: Transport, *, patience_s: float, baud: int) -> None:
        """`patience_s`: a board that was reset by opening the port answers when its sketch runs."""
        self._transport = transport
        self._patience_s = patience_s
        self._try_s = max(TRY_S, EXCHANGE_BITS / baud)
        self._baud = baud
        self._number = time.monotonic_ns() % NUMBERS  # another program's answers may still be on their way
        self._reader = AnswerReader()

    async def read(self) -> dict[str, str]:
        """The settings by their names; of a secret only "set" or "unset".

        Raises:
            HostlinkError: the board does not answer.
        """
        return dict(found for words in await self._request("info", "info") if (found := value_of(words)))

    async def write(self, values: Mapping[str, str]) -> None:
        """Store all of them, or none.

        Raises:
            BadRequest: a value is none for its setting.
            HostlinkError: the board does not answer, or refuses.
        """
        for name, value in values.items():
            check_value(SETTINGS[name], value)
        try:
            for _ in range(STORE_TRIES):
                if await self._store(values):
                    return
        except BaseException:
            self._transport.write(request_line(self._next_number(), "forget"))
            raise
        raise HostlinkError(f"{self._transport.peer}: it restarts before it stores anything; is its supply too weak?")

    async def _store(self, values: Mapping[str, str]) -> bool:
        """False: the board restarted in between, which forgets what was set."""
        await self._request("forget", "forget")
        for name, value in values.items():
            await self._request(assignment(name, value), name)
        return (await self._request(f"save {len(values)}", "save"))[-1] != LOST

    async def _request(self, words: str, what: str) -> list[str]:
        """The words of each line of the answer; `what` stands in the error.

        Raises:
            HostlinkError: the board refuses, or has not answered in time.
        """
        number = self._next_number()
        answers: list[str] = []
        loop = asyncio.get_running_loop()
        deadline_s = loop.time() + self._patience_s
        while (now_s := loop.time()) < deadline_s:
            self._transport.write(request_line(number, words))
            await self._collect(answers, number, min(now_s + self._try_s, deadline_s))
            if not _is_complete(answers):
                continue
            kind, _, reason = answers[-1].partition(" ")
            if kind == "error" and answers[-1] != LOST:
                raise HostlinkError(f"{self._transport.peer}: {what}: {_ERRORS.get(reason, reason)}")
            return answers
        raise HostlinkError(self._silence())

    async def _collect(self, answers: list[str], number: int, deadline_s: float) -> None:
        """Add what answers the request, until its last line or the deadline.

        Raises:
            HostlinkError: the port is gone.
        """
        loop = asyncio.get_running_loop()
        while not _is_complete(answers) and (left_s := deadline_s - loop.time()) > 0:
            try:
                async with asyncio.timeout(left_s):
                    data = await self._transport.receive()
            except TimeoutError:
                return
            if not data:
                raise HostlinkError(f"{self._transport.peer}: the port is gone; plug the board in again")
            answers += [answer.words for answer in self._reader.feed(data) if answer.number == number]

    def _next_number(self) -> int:
        self._number = (self._number + 1) % NUMBERS
        return self._number

    def _silence(self) -> str:
        start = f"{self._transport.peer}: no answer within {self._patience_s:g} s at {self._baud} baud"
        if self._reader.has_rosserial:
            return f"{start}: it speaks rosserial on this port; its sketch needs a SettingsLine that reads it before"
        if self._reader.received_bytes:
            return f"{start}, only other bytes: is it the baud rate of its Serial.begin()? --baud names another"
        return f"{start}: its sketch needs a hostlink::SettingsLine (docs/arduino.md), and this baud rate (--baud)"


def _is_complete(answers: list[str]) -> bool:
    return bool(answers) and (answers[-1] == "ok" or answers[-1].startswith("error"))
