"""Strangers at the port of the fleet, which is TLS with certificates on both sides: none of them hears a word."""

import asyncio
import contextlib
import random
import ssl

from tests.support.chaos.connection import Connection
from tests.support.chaos.devices import quietly, together
from tests.support.chaos.names import hostile_address
from tests.support.chaos.plan import Action
from tests.support.chaos.stage import TLS, Stage

HEAR_S = 1.0
TLS_ALERT = 0x15  # the kind of its record: the only answer to a peer without TLS
FIRST_WORDS = (  # of a Zenoh session, as eclipse-zenoh 1.5 opens one; its id belongs between them
    bytes.fromhex("2000c109f2"),
    bytes.fromhex("0ac8ff81c205eacba583062701"),
)
WAYS = ("plain", "garbage", "silent", "without", "wrong", "half")


async def strangers(stage: Stage, action: Action) -> None:
    """Plain TCP, TLS without a certificate or with one of another authority, half a handshake, garbage."""
    dice = action.dice()
    way, count = dice.choice(WAYS), dice.choice((1, 4, 16))
    stage.report({"action": action.number, "what": f"{count} strangers at the fleet's port, {way}"})

    async def one(_: int, own: random.Random) -> None:
        while True:
            await quietly(_come, stage, own, way)
            await asyncio.sleep(own.choice((0.01, 0.1)))

    if stage.fleet is not None:
        await together(action, one, count)


async def _come(stage: Stage, dice: random.Random, way: str) -> None:
    assert stage.fleet is not None
    if not stage.room.reserve(TLS, 1):
        raise ConnectionError("no room for another stranger")
    try:
        heard = await (_speak_tls if way in ("without", "wrong") else _speak)(stage, dice, way)
    finally:
        stage.room.give_back(TLS, 1)
    if heard:
        stage.report({"broken": "the fleet's port answers nobody without a certificate", "detail": f"{way}: {heard!r}"})


def first_words(dice: random.Random) -> bytes:
    """Return the first bytes of a session without TLS."""
    return FIRST_WORDS[0] + dice.randbytes(16) + FIRST_WORDS[1]


async def _speak(stage: Stage, dice: random.Random, way: str) -> bytes:
    """Return the received bytes that are not an alert of TLS."""
    connection = await Connection.dial(stage.fleet or ("", 0), hostile_address(dice), TLS)
    try:
        hello = {
            "plain": first_words(dice),
            "garbage": dice.randbytes(dice.choice((1, 100, 5000))),
            "half": b"\x16\x03\x01\x02\x00" + dice.randbytes(dice.randrange(400)),
        }.get(way, b"")
        await connection.send(hello)
        heard = await connection.receive_until(b"\xff\x00never\x00\xff", HEAR_S)
    finally:
        connection.close(dice.choice(("fin", "reset")))
    return b"" if heard[:1] == bytes([TLS_ALERT]) else heard[:80]


async def _speak_tls(stage: Stage, dice: random.Random, way: str) -> bytes:
    """Return the bytes received inside of TLS."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    if way == "wrong":
        context.load_cert_chain(*stage.wrong_certificate)
    heard = b""
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(3 * HEAR_S):
            reader, writer = await asyncio.open_connection(
                *(stage.fleet or ("", 0)), ssl=context, local_addr=(hostile_address(dice), 0)
            )
            try:
                writer.write(first_words(dice))
                async with asyncio.timeout(HEAR_S):
                    heard = await reader.read(80)
            finally:
                writer.transport.abort()
    return heard
