"""Programs that give the API much to keep or to do: bodies, latched messages, readers of incidents. As in programs."""

import asyncio
import contextlib
import json
import random

from tests.support.chaos import requests
from tests.support.chaos.connection import Connection, reading
from tests.support.chaos.devices import quietly, together
from tests.support.chaos.names import HONEST
from tests.support.chaos.plan import Action
from tests.support.chaos.stage import UPLOAD, Stage

PIECE_BYTES = 64 * 1024
TRICKLE_S = 0.05
ANSWER_S = 3.0
HISTORY_S = 10.0
BODIES = (  # where they go; none is a velocity or a stop of the honest robot
    ("POST", "/api/robots/zzz/lock"),
    ("POST", "/api/robots/rogue_0/lock"),
    ("PUT", "/api/robots/rogue_0/velocity"),
    ("PUT", f"/api/robots/{HONEST}/velocity"),  # nothing but x: refused
    ("POST", "/api/incidents"),
    ("POST", "/api/reload"),
    ("POST", "/nowhere"),
)


async def bodies(stage: Stage, action: Action) -> None:
    """Bodies of requests: small to huge, whole, slow, cut or in chunks, over many connections at once."""
    dice = action.dice()
    count, manner = dice.choice((1, 20, 100)), dice.choice(("whole", "whole", "whole", "chunks", "slow", "cut"))
    size = dice.choice((900, 60_000, 1_000_000, 1_000_000))
    method, path = dice.choice(BODIES)
    what = f"{count} connections upload {size} bytes to {method} {path}, {manner}"
    stage.report({"action": action.number, "what": what})

    async def one(_: int, own: random.Random) -> None:
        while True:
            with contextlib.suppress(OSError):
                async with stage.program(own, own.choice(("fin", "reset")), kind=UPLOAD) as connection:
                    await _upload(connection, method, path, size, manner)
            await asyncio.sleep(0.02)

    await together(action, one, count)


async def _upload(connection: Connection, method: str, path: str, size: int, manner: str) -> None:
    """One body after the other, until the daemon closes the connection."""
    head = f"{method} {path} HTTP/1.1\r\nHost: 127.0.0.1\r\n".encode()
    length = b"Transfer-Encoding: chunked\r\n\r\n" if manner == "chunks" else b"Content-Length: %d\r\n\r\n" % size
    async with reading(connection):
        while True:
            await connection.send(head + length)
            for start in range(0, size // 2 if manner == "cut" else size, PIECE_BYTES):
                piece = b"x" * min(PIECE_BYTES, size - start)
                await connection.send(b"%x\r\n%b\r\n" % (len(piece), piece) if manner == "chunks" else piece)
                await asyncio.sleep(TRICKLE_S if manner == "slow" else 0)
            if manner == "chunks":
                await connection.send(b"0\r\n\r\n")
            if manner == "cut":
                await asyncio.sleep(ANSWER_S)


async def latch(stage: Stage, action: Action) -> None:
    """Programs with large messages on latched topics, and some that subscribe to them."""
    dice = action.dice()
    count, topics = dice.choice((1, 8, 30)), dice.choice((1, 4, 16))
    size = dice.choice((1000, 100_000, 900_000))
    what = f"{count} programs with {topics} latched messages of {size} bytes each"
    stage.report({"action": action.number, "what": what})

    async def one(number: int, own: random.Random) -> None:
        async with stage.websocket(own, own.choice(("fin", "reset", "silent"))) as connection, reading(connection):
            while True:
                for each in range(topics):
                    name = f"/latched_{action.number}_{number}_{each}"
                    fields = {"topic": name, "type": "std_msgs/String", "latch": True}
                    await connection.send(requests.operation(op="publish", msg={"data": "x" * size}, **fields))
                    if own.random() < 0.3:
                        await connection.send(requests.operation(op="subscribe", topic=name))
                await asyncio.sleep(own.uniform(0.2, 2.0))

    await together(action, one, count)


async def history(stage: Stage, action: Action) -> None:
    """Readers of incidents, some of which save more of them; and of all that the daemon measures."""
    dice = action.dice()
    count = dice.choice((1, 3, 8))
    stage.report({"action": action.number, "what": f"{count} readers of incidents and of /metrics"})

    async def one(_: int, own: random.Random) -> None:
        while True:
            await quietly(_read_incidents, stage, own)
            await asyncio.sleep(own.choice((0.0, 0.05)))

    await together(action, one, count)


async def _read_incidents(stage: Stage, dice: random.Random) -> None:
    body = json.dumps({"robot": dice.choice((HONEST, "rogue_0", "none")), "reason": "chaos"}).encode()
    await _ask(stage, dice, requests.http("POST", "/api/incidents", body, b"Connection: close\r\n"), ANSWER_S)
    await _ask(stage, dice, requests.http("GET", "/metrics", headers=b"Connection: close\r\n"), ANSWER_S)
    listed = await _ask(stage, dice, requests.http("GET", "/api/incidents", headers=b"Connection: close\r\n"), ANSWER_S)
    try:
        files = [each["file"] for each in json.loads(listed.partition(b"\r\n\r\n")[2])["incidents"] if each["file"]]
    except (ValueError, KeyError):
        files = []
    name = dice.choice([*files[:5], "none.mcap", "..%2f..%2fhostlink.toml"])
    for path in dice.choices((f"/api/incidents/{name}/history", f"/api/incidents/{name}"), (4, 1), k=2):
        await _ask(stage, dice, requests.http("GET", path, headers=b"Connection: close\r\n"), HISTORY_S)


async def _ask(stage: Stage, dice: random.Random, request: bytes, timeout_s: float) -> bytes:
    """The answer, as much of it as came in that time."""
    async with stage.program(dice, dice.choice(("fin", "fin", "reset"))) as connection:
        await connection.send(request)
        return await connection.receive_until(b"\xff\x00never\x00\xff", timeout_s)
