"""Actions of hostile and broken devices. Each action draws everything from its own dice, and ends with its time."""

import asyncio
import contextlib
import itertools
import random
from collections.abc import Awaitable, Callable
from typing import Any

from hostlink.core.protocol.rosserial.frame import encode
from tests.support.chaos import frames
from tests.support.chaos.connection import WAYS, Connection, reading
from tests.support.chaos.plan import Action
from tests.support.chaos.stage import Stage, introduce

FEW_TOPICS = 100  # a device that announces more connects alone
TURN_S = 0.02


async def flood(stage: Stage, action: Action) -> None:
    """One connection or sixteen send one kind of frame, or a mix, as fast as the line accepts it."""
    dice = action.dice()
    maker = dice.choice(frames.FLOODS)
    count = dice.choice((1, 1, 4, 16))
    is_reading, is_known, way = dice.random() < 0.7, dice.random() < 0.7, dice.choice(WAYS)
    what = f"flood of {maker.__name__}, {count} connections, {'reading' if is_reading else 'not reading'}, then {way}"
    stage.report({"action": action.number, "what": what})

    async def one(number: int, own: random.Random) -> None:
        async with stage.device(own, way) as connection:
            if is_known:
                await introduce(connection, frames.introduction(frames.robot(f"rogue_{number % 4}")))
            async with contextlib.AsyncExitStack() as stack:
                if is_reading:
                    await stack.enter_async_context(reading(connection))
                for block in maker(own):
                    await connection.send(block)
                    await asyncio.sleep(0)

    await together(action, one, count)


async def announce(stage: Stage, action: Action) -> None:
    """Devices whose topics clash with each other's, the honest robot's and the daemon's, and messages on them."""
    dice = action.dice()
    infos = frames.draw_announcement(dice)
    count = dice.randint(1, 6) if len(infos) < FEW_TOPICS else 1
    way = dice.choice(WAYS)
    stage.report({"action": action.number, "what": f"{count} devices announce {len(infos)} topics or so, then {way}"})

    async def one(number: int, own: random.Random) -> None:
        mine = infos if number == 0 else frames.draw_announcement(own)[:FEW_TOPICS]
        async with stage.device(own, way) as connection, reading(connection):
            await introduce(connection, frames.introduction(mine))
            while True:
                chosen = own.choices(mine, k=10)
                await connection.send(b"".join(frames.data_frame(info, own) for info in chosen))
                if own.random() < 0.02:
                    mine = frames.draw_announcement(own)[:FEW_TOPICS]
                    await connection.send(frames.introduction(mine))
                await asyncio.sleep(TURN_S)

    await together(action, one, count)


async def trickle(stage: Stage, action: Action) -> None:
    """Frames of every kind in pieces, with pauses in the middle of a frame, bytes lost and damaged."""
    dice = action.dice()
    way = dice.choice(WAYS)
    stage.report({"action": action.number, "what": f"frames of every kind in pieces, then {way}"})

    async def one(_: int, own: random.Random) -> None:
        async with stage.device(own, way) as connection, reading(connection):
            await introduce(connection, frames.introduction(frames.draw_announcement(own)[:20]))
            while True:
                piece = bytearray(next(iter(own.choice(frames.FLOODS)(own)))[: own.randrange(1, 3000)])
                for _ in range(own.choice((0, 0, 1, 5))):
                    piece[own.randrange(len(piece))] = own.randrange(256)
                await connection.send(bytes(piece))
                await asyncio.sleep(own.choice((0.0, 0.001, TURN_S, 0.2)))

    await together(action, one, dice.randint(1, 4))


async def churn(stage: Stage, action: Action) -> None:
    """Devices that connect and vanish in every state, as the same or as ever new robots."""
    dice = action.dice()
    is_new, rate_hz = dice.random() < 0.6, dice.choice((5, 30, 100))
    word = f"brief_{action.number}"
    what = f"{rate_hz} devices a second connect and vanish, {'new' if is_new else 'same'}"
    stage.report({"action": action.number, "what": what})

    async def one(number: int, own: random.Random) -> None:
        hello = frames.introduction(frames.robot(f"{word}_{number if is_new else number % 3}"))
        async with stage.device(own, own.choice(WAYS[:3])) as connection:
            stage_of_life = own.randrange(4)
            if stage_of_life == 1:
                await introduce(connection, hello[: own.randrange(len(hello))])
            elif stage_of_life > 1:
                await introduce(connection, hello)
                await connection.receive_until(b"\xff", own.choice((0.0, 0.1, 0.3)))

    await one_after_another(action, one, rate_hz)


async def silent(stage: Stage, action: Action) -> None:
    """Devices that connect, some of which announce a robot, and then stay silent."""
    dice = action.dice()
    count, is_known = dice.choice((1, 10, 60)), dice.random() < 0.5
    what = f"{count} devices fall silent, {'known' if is_known else 'unknown'}"
    stage.report({"action": action.number, "what": what})
    for number in range(count):
        async with stage.device(dice, "silent") as connection:
            if is_known:
                await connection.send(frames.introduction(frames.robot(f"silent_{action.number}_{number}")))
        await asyncio.sleep(0)


async def copy(stage: Stage, action: Action) -> None:
    """Boards with the honest robot's firmware, from other addresses; each reconnects after it was refused."""
    dice = action.dice()
    stage.report({"action": action.number, "what": "copies of the honest robot's firmware"})

    async def one(_: int, own: random.Random) -> None:
        while True:
            with contextlib.suppress(OSError):
                async with stage.device(own, own.choice(WAYS[:3])) as connection:
                    await introduce(connection, frames.honest_introduction())
                    async with asyncio.timeout(own.uniform(0.2, 1.0)):
                        await keep_company(connection)
            await asyncio.sleep(0.05)

    await together(action, one, dice.randint(1, 3))


async def keep_company(connection: Connection) -> None:
    """Poses of another place, ten a second."""
    async with reading(connection):
        while True:
            await connection.send(encode(125, bytes(16) + b"\0\0\0\0\0\0\x08\x40"))
            await asyncio.sleep(0.1)


async def together(action: Action, one: Callable[[int, random.Random], Awaitable[None]], count: int) -> None:
    """So many at once, each with its own dice; one that is sent away leaves the others alone."""
    async with asyncio.TaskGroup() as tasks:
        for number in range(count):
            tasks.create_task(quietly(one, number, action.dice_of(number)))


async def one_after_another(
    action: Action, one: Callable[[int, random.Random], Awaitable[None]], rate_hz: float
) -> None:
    """Begin another one at this rate, without end, each with its own dice."""
    async with asyncio.TaskGroup() as tasks:
        for number in itertools.count():
            tasks.create_task(quietly(one, number, action.dice_of(number)))
            await asyncio.sleep(1 / rate_hz)


async def quietly(work: Callable[..., Awaitable[None]], *arguments: Any) -> None:
    """Do the work. The daemon may end the connection of a hostile peer at any time."""
    try:
        await work(*arguments)
    except* OSError:  # a TimeoutError is one
        pass
