"""Actions of hostile and broken programs at the API. Each action draws everything from its own dice, and ends with its
time."""

import asyncio
import contextlib
import random

from tests.support.chaos import foxglove, requests
from tests.support.chaos.connection import reading
from tests.support.chaos.devices import quietly, together
from tests.support.chaos.plan import Action
from tests.support.chaos.stage import IDLE, SOCKET, STUCK, Stage

SMALL_BUFFER_BYTES = 4096
FOXGLOVE_SHARE = 0.4  # of those that speak a protocol


async def bridge(stage: Stage, action: Action) -> None:
    """rosbridge's operations, or Foxglove's, valid and invalid."""
    dice = action.dice()
    interval_s = dice.choice((0.0, 0.002, 0.05))
    way = dice.choice(("fin", "reset", "half_close", "silent"))
    is_foxglove = random.Random(f"{action.seed} protocol").random() < FOXGLOVE_SHARE
    draw = foxglove.draw_request if is_foxglove else requests.draw_operation
    handshake = foxglove.handshake if is_foxglove else requests.draw_handshake
    spoken = "Foxglove's" if is_foxglove else "rosbridge's"
    stage.report({"action": action.number, "what": f"{spoken} operations each {interval_s} s, then {way}"})

    async def one(_: int, own: random.Random) -> None:
        async with stage.websocket(own, way, handshake=handshake) as connection, reading(connection):
            while True:
                await connection.send(draw(own))
                await asyncio.sleep(interval_s)

    await together(action, one, dice.randint(1, 6))


async def subscriber(stage: Stage, action: Action) -> None:
    """Subscribers of flooded topics that read at once, slowly or never."""
    dice = action.dice()
    manner = dice.choice(("at once", "slowly", "never"))
    stage.report({"action": action.number, "what": f"subscribers of floods that read {manner}"})
    receive_bytes = 0 if manner == "at once" else SMALL_BUFFER_BYTES

    async def one(_: int, own: random.Random) -> None:
        kind = SOCKET if manner == "at once" else STUCK
        way = "silent" if manner == "never" else "fin"
        async with stage.websocket(own, way, kind=kind, receive_bytes=receive_bytes) as connection:
            await connection.send(requests.flood_subscriptions(own))
            if manner == "never":
                return
            await connection.read_away(pause_s=0.0 if manner == "at once" else 0.05)

    await together(action, one, dice.randint(1, 5))


async def publisher(stage: Stage, action: Action) -> None:
    """Programs that publish to the topics of hostile robots, and to those that the daemon derives from them."""
    dice = action.dice()
    interval_s = dice.choice((0.002, 0.01, 0.05))
    stage.report({"action": action.number, "what": f"publishers to hostile devices each {interval_s} s"})

    async def one(_: int, own: random.Random) -> None:
        async with stage.websocket(own) as connection, reading(connection):
            while True:
                await connection.send(requests.publication(own))
                await asyncio.sleep(interval_s)

    await together(action, one, dice.randint(1, 4))


async def rival(stage: Stage, action: Action) -> None:
    """A program of a lower priority that wants to drive the honest robot. It sends no stop, which ends a drive."""
    dice = action.dice()
    interval_s = dice.choice((0.02, 0.05))
    what = f"a rival drives each {interval_s} s"
    stage.report({"action": action.number, "what": what})
    is_rest = dice.random() < 0.3

    async def drive() -> None:
        async with contextlib.AsyncExitStack() as stack:
            enter = stage.program(dice) if is_rest else stage.websocket(dice)
            connection = await stack.enter_async_context(enter)
            await stack.enter_async_context(reading(connection))
            while True:
                await connection.send(requests.rival_request(dice) if is_rest else requests.rival_frame(dice))
                await asyncio.sleep(interval_s)

    await quietly(drive)


async def rest(stage: Stage, action: Action) -> None:
    """HTTP requests, right and wrong, over connections that are kept or not."""
    dice = action.dice()
    stage.report({"action": action.number, "what": "HTTP requests, right and wrong"})

    async def one(_: int, own: random.Random) -> None:
        while True:
            with contextlib.suppress(OSError):
                async with stage.program(own, own.choice(("fin", "reset", "half_close"))) as connection:
                    for _ in range(own.randint(1, 5)):
                        await connection.send(requests.draw_http(own))
                        await connection.receive_until(b"\r\n\r\n", 0.2)
            await asyncio.sleep(own.choice((0.0, 0.02)))

    await together(action, one, dice.randint(1, 6))


async def idle(stage: Stage, action: Action) -> None:
    """Hundreds of connections that send nothing, or half a request, and stay."""
    dice = action.dice()
    count = dice.choice((20, 200, 450))
    stage.report({"action": action.number, "what": f"{count} connections to the API that stay silent"})
    for _ in range(count):
        async with stage.program(dice, "silent", kind=IDLE) as connection:
            await connection.send(requests.draw_half(dice))


async def broken_websocket(stage: Stage, action: Action) -> None:
    """Send invalid WebSocket frames."""
    dice = action.dice()
    stage.report({"action": action.number, "what": "broken WebSocket frames"})

    async def one(_: int, own: random.Random) -> None:
        while True:
            with contextlib.suppress(OSError):
                async with stage.websocket(own, own.choice(("fin", "reset", "silent"))) as connection:
                    for _ in range(own.randint(1, 4)):
                        await connection.send(requests.draw_operation(own))
                        await connection.send(requests.draw_broken(own))
                    await connection.receive_until(b"\x88", 0.2)
            await asyncio.sleep(0.02)

    await together(action, one, dice.randint(1, 5))
