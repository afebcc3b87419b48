"""Actions of hostile and broken micro-ROS boards, over UDP and TCP. Each draws everything from its own dice."""

import asyncio
import contextlib
import itertools
import random
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from tests.support import xrce_board as board
from tests.support.chaos.connection import WAYS, Connection, reading
from tests.support.chaos.devices import one_after_another, together
from tests.support.chaos.names import CLASHING_NAMES, MESSAGE_TYPES, payload_of
from tests.support.chaos.plan import Action
from tests.support.chaos.stage import Stage
from tests.support.xrce_device import Device, stock

NODE = board.object_id(0, board.PARTICIPANT)
WRITER, READER = board.object_id(0, board.WRITER), board.object_id(0, board.READER)
CONNECTED_S = 0.5  # in which the host answers that it has created a client
CREATE_S = 0.5  # for the status of each object
BURST = 40  # messages of a flood at once
Messages = Iterator[bytes]
Flood = Callable[[board.Client, random.Random], Messages]

# -- boards that follow the protocol ----------------------------------------------------------------------------------


@dataclass
class Rogue:
    """A program whose topics clash with others', and which publishes what fits their types, or any bytes."""

    client: board.Client
    dice: random.Random

    def run(self) -> board.Program:
        """Connect, create, publish; begin again when the host does not answer."""
        while True:
            if (yield from self.client.connect(attempts=2)):
                yield from self._work()
            yield from self.client.listen(0.1)

    def _work(self) -> board.Program:
        dice, client = self.dice, self.client
        yield from client.create(NODE, board.participant(f"rogue_{dice.randrange(4)}"), 0, timeout_s=CREATE_S)
        writers: list[tuple[int, str]] = []
        for number in range(dice.choice((1, 2, 8, 40))):
            is_reader, name, type_ = dice.random() < 0.5, dice.choice(CLASHING_NAMES), dice.choice(MESSAGE_TYPES)
            topic_id = board.object_id(number, board.TOPIC)
            parent = board.object_id(number, board.SUBSCRIBER if is_reader else board.PUBLISHER)
            end = board.object_id(number, board.READER if is_reader else board.WRITER)
            package, _, kind = type_.partition("/")
            content = board.topic("rt/" + name.strip("/"), f"{package}::msg::dds_::{kind}_")
            yield from client.create(topic_id, content, NODE, timeout_s=CREATE_S)
            yield from client.create(parent, b"\0\0", NODE, timeout_s=CREATE_S)
            is_reliable = dice.random() < 0.5
            content = board.endpoint(topic_id, is_reader=is_reader, is_reliable=is_reliable)
            yield from client.create(end, content, parent, timeout_s=CREATE_S)
            if is_reader:
                client.read_data(end, stream=dice.choice((0x80, 1)))
            else:
                writers.append((end, type_))
        while True:
            if writers:
                end, type_ = dice.choice(writers)
                payload = dice.choice((payload_of(type_, dice), dice.randbytes(dice.randrange(2000))))
                if len(payload) > client.room_bytes - 20 or dice.random() < 0.5:
                    yield from client.publish(end, payload, timeout_s=0.2)
                else:
                    client.publish_best_effort(end, payload)
            yield from client.listen(0.02)


async def board_rogues(stage: Stage, action: Action) -> None:
    """Boards whose topics clash with each other's, the honest robot's and the daemon's; and stock boards."""
    dice = action.dice()
    count, way = dice.randint(1, 6), dice.choice(WAYS)
    stage.report({"action": action.number, "what": f"{count} micro-ROS boards publish, then {way}"})

    async def one(_: int, own: random.Random) -> None:
        key = own.choice((b"\1\2\3\4", own.randbytes(4)))
        client = board.Client(key=key, session=own.choice((0x81, 1)), mtu=own.choice((64, 512, 1400)))
        program = Rogue(client, own) if own.random() < 0.7 else stock(key=key)
        async with stage.board(own, way) as (connection, codec):
            device = Device(program, connection.offer, codec, loss=own.choice((0.0, 0.0, 0.2)))
            async with asyncio.TaskGroup() as tasks:
                running = tasks.create_task(device.run())
                with contextlib.suppress(OSError):
                    await connection.read_away(device.receive)
                running.cancel()

    await together(action, one, count)


async def board_churn(stage: Stage, action: Action) -> None:
    """Boards that connect and vanish in every state, with one key or ever new ones."""
    dice = action.dice()
    is_new, rate_hz = dice.random() < 0.6, dice.choice((5, 30, 100))
    what = f"{rate_hz} micro-ROS boards a second connect and vanish, {'new' if is_new else 'same'}"
    stage.report({"action": action.number, "what": what})

    async def one(number: int, own: random.Random) -> None:
        client = board.Client(key=struct.pack("<I", number if is_new else number % 3))
        async with stage.board(own, own.choice(WAYS[:3])) as (connection, codec):
            messages = [client.creation(), *_created(client)]
            for message in messages[: own.randrange(len(messages) + 1)]:
                await connection.send(codec.encode(message))
            await connection.receive_until(b"\xff", own.choice((0.0, 0.1, 0.3)))

    await one_after_another(action, one, rate_hz)


# -- floods: each gives messages without end --------------------------------------------------------------------------


def _created(client: board.Client) -> list[bytes]:
    """Return the messages with which a board like linorobot2 creates everything, sent without waiting."""
    for id_, content, parent in stock(key=client.key).objects():
        client.slots.clear()
        client.put(client.creating(id_, content, parent)[1])
    made, client.sent = client.sent, []
    return made


def _head(client: board.Client, stream: int, number: int) -> bytes:
    key = client.key if client.session < 0x80 else b""
    return struct.pack("<BBH", client.session, stream, number & 0xFFFF) + key


def _of(make: Callable[[board.Client, random.Random, int], bytes], stream: int) -> Flood:
    """A flood of what `make` returns for each number, as messages of a stream whose numbers ascend."""

    def flood(client: board.Client, dice: random.Random) -> Messages:
        for number in itertools.count(client.last_sent + 1):
            yield _head(client, stream, number if stream else 0) + make(client, dice, number)

    flood.__name__ = f"{make.__name__.strip('_')}_{stream:x}"
    return flood


def creations(client: board.Client, dice: random.Random) -> Messages:
    """Return requests to create a client: always this one, or ever new ones."""
    is_same = dice.random() < 0.5
    while True:
        yield (client if is_same else board.Client(key=dice.randbytes(4))).creation()


def _writes(_: board.Client, dice: random.Random, number: int) -> bytes:
    writer = dice.choice((WRITER, WRITER, board.object_id(dice.randrange(4096), board.WRITER)))
    return board.sub(board.WRITE, struct.pack(">HH", number & 0xFFFF, writer) + bytes(dice.choice((4, 400))))


def _objects(client: board.Client, dice: random.Random, number: int) -> bytes:
    kind = dice.choice((board.TOPIC, board.WRITER, board.READER, board.PARTICIPANT))
    content = board.participant("x" * dice.choice((1, 100, 400)))
    return client.creating(board.object_id(number & 0xFFF, kind), content, NODE)[1]


def _fragments(_: board.Client, dice: random.Random, number: int) -> bytes:
    return board.sub(board.FRAGMENT, bytes(dice.choice((1, 400))), dice.choice((1, 1, 1, 3)) if number % 50 else 1)


def _heartbeats(_: board.Client, dice: random.Random, number: int) -> bytes:
    return board.sub(board.HEARTBEAT, dice.randbytes(4) + bytes((dice.choice((0x80, 0x81, 0, 1)),)))


def _acknacks(_: board.Client, dice: random.Random, number: int) -> bytes:
    return board.sub(board.ACKNACK, dice.randbytes(4) + bytes((dice.choice((0x80, 0x81, 0)),)))


def _reads(_: board.Client, dice: random.Random, number: int) -> bytes:
    control = struct.pack("<HHHH", *(dice.choice((0, 1, 0xFFFF)) for _ in range(4)))
    stream = bytes((dice.choice((0x80, 1, 0, 7)), 0, 0, 1))
    return board.sub(board.READ, struct.pack(">HH", number & 0xFFFF, READER) + stream + control)


def _times(_: board.Client, dice: random.Random, number: int) -> bytes:
    return board.sub(board.TIMESTAMP, dice.randbytes(8))


def _pings(_: board.Client, dice: random.Random, number: int) -> bytes:
    return board.sub(board.GET_INFO, bytes.fromhex("000AFFFD02000000"))


def _deletes(_: board.Client, dice: random.Random, number: int) -> bytes:
    return board.sub(board.DELETE, struct.pack(">HH", number & 0xFFFF, dice.choice((NODE, WRITER, READER, 0xFFFE))))


def _resets(_: board.Client, dice: random.Random, number: int) -> bytes:
    return board.sub(board.RESET, b"")


def _claims(_: board.Client, dice: random.Random, number: int) -> bytes:
    """Return a submessage that claims another length than it has."""
    return struct.pack("<BBH", dice.randrange(16), dice.randrange(256), dice.randrange(65536)) + bytes(40)


def garbage(_: board.Client, dice: random.Random) -> Messages:
    while True:
        yield dice.randbytes(dice.choice((1, 8, 60, 1400)))


FLOODS: list[Flood] = [
    creations, garbage,
    *(_of(make, stream) for make in (_writes, _objects, _fragments) for stream in (0x80, 1)),
    *(_of(make, 0) for make in (_heartbeats, _acknacks, _times, _pings, _resets, _claims)),
    *(_of(make, 0x80) for make in (_reads, _deletes, _claims)),
]  # fmt: skip


async def board_flood(stage: Stage, action: Action) -> None:
    """One board or sixteen send one kind of message as fast as the host accepts it."""
    dice = action.dice()
    flood, count = dice.choice(FLOODS), dice.choice((1, 1, 4, 16))
    is_reading, is_known, way = dice.random() < 0.7, dice.random() < 0.7, dice.choice(WAYS)
    what = f"flood of {flood.__name__}, {count} micro-ROS boards, {'reading' if is_reading else 'not reading'}"
    stage.report({"action": action.number, "what": f"{what}, then {way}"})

    async def one(number: int, own: random.Random) -> None:
        client = board.Client(key=struct.pack("<I", number), session=own.choice((0x81, 1)))
        async with stage.board(own, way) as (connection, codec), contextlib.AsyncExitStack() as stack:
            if is_known:
                await _introduce(connection, codec, client)
            if is_reading:
                await stack.enter_async_context(reading(connection))
            messages = flood(client, own)
            while True:
                for message in itertools.islice(messages, BURST):
                    await connection.send(codec.encode(message))
                await asyncio.sleep(0)

    await together(action, one, count)


async def board_trickle(stage: Stage, action: Action) -> None:
    """Messages of every kind, some lost, doubled, out of order or damaged, with pauses in the middle of one."""
    dice = action.dice()
    way = dice.choice(WAYS)
    stage.report({"action": action.number, "what": f"micro-ROS messages of every kind, damaged, then {way}"})

    async def one(_: int, own: random.Random) -> None:
        client = board.Client(key=own.randbytes(4))
        async with stage.board(own, way) as (connection, codec), reading(connection):
            await _introduce(connection, codec, client)
            while True:
                messages = list(itertools.islice(own.choice(FLOODS)(client, own), own.randint(1, 20)))
                own.shuffle(messages)
                for message in own.choices(messages, k=len(messages)):
                    data = bytearray(codec.encode(message))
                    if own.random() < 0.2:
                        data[own.randrange(len(data))] = own.randrange(256)
                    middle = own.randrange(len(data)) if own.random() < 0.1 else 0
                    await connection.send(bytes(data[:middle]))
                    await asyncio.sleep(own.choice((0.0, 0.001, 0.02)))
                    await connection.send(bytes(data[middle:]))

    await together(action, one, dice.randint(1, 4))


async def _introduce(connection: Connection, codec: board.Datagrams, client: board.Client) -> None:
    """Create the client, and everything that a board like linorobot2 has."""
    await connection.send(codec.encode(client.creation()))
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(CONNECTED_S):
            await connection.receive()
    for message in _created(client):
        await connection.send(codec.encode(message))
