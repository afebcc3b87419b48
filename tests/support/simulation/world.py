"""World: a daemon that restarts, boards, programs, and the weather that happens to all of them. A seed draws it."""

import asyncio
import contextlib
import random
from collections import Counter
from collections.abc import Callable, Iterator

import structlog
from structlog.contextvars import merge_contextvars

from hostlink.core.components import supervise
from hostlink.core.config import Config, LinkConfig
from hostlink.core.guardian.frames import StopWriter
from hostlink.core.guardian.process import HANG_S
from hostlink.core.hub.hub import Hub
from hostlink.core.runtime.cancellation import meanwhile
from hostlink.core.runtime.stop_frames import StopFrames
from tests.support.fake_device import CATALOG
from tests.support.simulation.board import TWIST, Board
from tests.support.simulation.clock import WorldLoop
from tests.support.simulation.journal import Began, Ended, Failed, Journal, Opened, Paused, Stuck, Written
from tests.support.simulation.micro_ros import MicroRosBoard
from tests.support.simulation.programs import Entrance, Program, Programs, number_of
from tests.support.simulation.wire import Connection
from tools.faults import Habits, Kind, Span

WALL_NS = 1_800_000_000_000_000_000  # at the start of a run
RECOVERY_S = 15.0  # in which boards and programs find the daemon again after the last fault
RIDE_S = 1.5
MICRO_ROS_SHARE = 0.8  # of the boards of every second world; the others have boards of rosserial alone
LEAVE_S = 13.0  # in which the daemon notices that all have left: a silent link ends after 11 s


class Guardian:
    """The daemon's second process: it writes the frames of the daemon when that hangs or is gone."""

    def __init__(self, world: "World") -> None:
        self._world = world
        self._zeros: dict[int, tuple[Callable[[], int | None], StopFrames]] = {}
        self._driven = set[int]()
        self._beat = 0

    def watch(self, number: int, connection: Callable[[], int | None], stop: StopFrames) -> None:
        self._zeros[number] = connection, stop

    def release(self, number: int) -> None:
        self._zeros.pop(number, None)

    def beat(self, driven: set[int]) -> None:
        self._driven, self._beat = set(driven), self._beat + 1
        if driven:
            self._world.loop.at(self._world.loop.time() + HANG_S, self._miss, self._beat)

    def _miss(self, beat: int) -> None:
        if beat == self._beat and self._world.guardian is self:
            for number in sorted(self._driven):
                self._write(number, is_end=False)

    def take_over(self) -> set[int | None]:
        """Stop everything, because the daemon is gone. Return the connections, which are closed later."""
        for number in sorted(self._zeros):
            self._write(number, is_end=True)
        return {found[0]() for found in self._zeros.values()}

    def _write(self, number: int, *, is_end: bool) -> None:
        found = self._zeros.get(number)
        connection = None if found is None else self._world.connections.get(found[0]() or 0)
        if found is None or connection is None:
            return
        writer, began_s = StopWriter(found[1], has_end=is_end), self._world.loop.world_s

        def step() -> None:
            while data := writer.pop_due(self._world.loop.world_s - began_s + 1e-9):
                connection.to_peer.send(data, self._world.loop.world_s)
                self._world.note_written(connection, data, by_guardian=True)
                writer.written(len(data))
            next_s = writer.next_s()
            if next_s is not None:
                self._world.loop.at(began_s + next_s, step)
            elif is_end:
                connection.closed_by_host()

        step()


class World:
    """All that one run has."""

    def __init__(self, loop: WorldLoop, seed: int, seconds: float) -> None:
        self.loop, self.journal, self.seconds = loop, Journal(), seconds
        self._seed, self._dice = seed, random.Random(f"{seed} world")
        self._calls = random.Random(f"{seed} calls")
        self.connections: dict[int, Connection] = {}
        self.guardian: Guardian | None = None
        self.hub: Hub | None = None
        self._entrance = Entrance(self.journal)
        self._number = self._connection_number = 0
        self._robots: dict[int, Board] = {}  # by connection
        self._is_ending = asyncio.Event()
        self._daemon: asyncio.Task[None] | None = None
        self._config = self._draw_config()
        count = self._dice.choice((1, 2, 2, 3))
        self._board_habits = [self._draw_habits() for _ in range(count)]
        self._is_clean = [self._dice.random() < 0.8 for _ in range(count)]
        self.boards = [
            self._kind(number)(loop, self.journal, self._dial_board, number, random.Random(f"{seed} board {number}"))
            for number in range(count)
        ]
        robots = [board.name for board in self.boards]
        self.programs = [
            Program(
                loop,
                self.journal,
                self._dial_program,
                self.draw_number,
                name=number,
                robots=robots,
                dice=random.Random(f"{seed} program {number}"),
            )
            for number in range(self._dice.choice((2, 3, 4)))
        ]
        self._program_habits = [self._draw_habits() for _ in self.programs]
        self._weather = self._draw_weather()

    # -- what is drawn ------------------------------------------------------------------------------------------------

    def _draw_config(self) -> Config:
        dice = self._dice
        return Config(link=LinkConfig(uart_bytes_s=dice.choice((None, None, 3840, 11520))))

    def _draw_habits(self) -> Habits:
        dice = self._dice
        split_bytes = dice.choice((None, None, None, Span(1, 40)))
        return Habits(
            split_bytes=split_bytes,
            delay_s=dice.choice((Span(0.001, 0.001), Span(0.001, 0.01), Span(0.0, 0.1), Span(0.05, 0.3))),
            merge_s=dice.choice((0.0, 0.0, 0.0, 0.05)) if split_bytes is None else 0.0,  # else it is too slow
            rate_bytes_s=dice.choice((None, None, None, 12000.0)),
        )

    def _draw_weather(self) -> list[tuple[float, Callable[[random.Random], None]]]:
        """Return what happens, and how many times a second. Each seed has some kinds of it, so that rare ones meet."""
        kinds: list[tuple[float, Callable[[random.Random], None]]] = [
            (0.1, self._cut_board),
            (0.05, self._close_board),
            (0.05, self._vanish_board),
            (0.2, self._stall_board),
            (0.05, self._hang_board),
            (0.05, self._reboot_board),
            (0.1, self._harm_board),
            (0.2, self._stall_program),
            (0.1, self._cut_program),
            (0.4, self._be_late),
            (0.1, self._pause),
            (0.05, self._fail_component),
            (0.03, self._kill_daemon),
            (0.03, self._restart_daemon),
        ]
        chosen = self._dice.sample(kinds, self._dice.randint(1, len(kinds)))
        return chosen if self._dice.random() < 0.9 else []

    def _kind(self, number: int) -> type[Board]:
        share = 0.0 if self._seed % 2 else MICRO_ROS_SHARE
        return MicroRosBoard if random.Random(f"{self._seed} protocol {number}").random() < share else Board

    def draw_number(self) -> int:
        """Return a number that no other command has."""
        self._number += 1
        return self._number

    # -- the run ------------------------------------------------------------------------------------------------------

    async def live(self) -> None:
        """Run to the end."""
        task = asyncio.current_task()
        assert task is not None
        task.set_name("world")
        with _logging_to(self.journal, self.loop):
            self._start_daemon()
            for number, board in enumerate(self.boards):
                self.loop.at(0.05 * number, board.start)
            for program in self.programs:
                program.start()
            for number, (rate_hz, happen) in enumerate(self._weather):
                self._plan_weather(rate_hz, happen, random.Random(f"{self._seed} weather {number}"))
            await self._until(self.seconds)
            await self._calm_down()
            await self._ride_once_more()
            await self._empty()
            await self._end_daemon()

    async def _until(self, at_s: float) -> None:
        """Wait in the world's time; a daemon that crashes ends the run."""
        passed = asyncio.Event()
        self.loop.at(at_s, passed.set)
        assert self._daemon is not None
        waiting = self.loop.create_task(passed.wait(), name="end")
        while not waiting.done():
            daemon = self._daemon
            await asyncio.wait((waiting, daemon), return_when=asyncio.FIRST_COMPLETED)
            if daemon.done() and daemon is self._daemon:
                waiting.cancel()
                daemon.result()
                raise AssertionError("the daemon has ended by itself")

    async def _calm_down(self) -> None:
        """No more weather; programs go."""
        self._weather.clear()
        self.journal.say(self.loop.world_s, "calm")
        for program in self.programs:
            program.leave()
        for connection in self.connections.values():
            connection.heal()
        for _ in range(int(RECOVERY_S / 0.5)):
            await self._until(self.loop.world_s + 0.5)
            if self._is_whole():
                return
        missing = [board.name for board in self.boards if not self._has(board)]
        self.journal.add(Failed(self.loop.world_s, f"{RECOVERY_S:g} s after the last fault the daemon lacks {missing}"))

    def _is_whole(self) -> bool:
        return self._entrance.accept is not None and all(map(self._has, self.boards))

    def _has(self, board: Board) -> bool:
        """Whether the daemon has a board's robot on its newest connection, with all of its topics."""
        if self.hub is None or board.connection is None:
            return False
        peers = [robot.link.peer for robot in self.hub.robots.here() if robot.name == board.name and robot.link]
        topics = [len(link.session.topics) for link in self.hub.links.all() if [link.peer] == peers]
        return peers == [board.connection.host.peer] and topics == [len(board.topics)]

    async def _ride_once_more(self) -> None:
        """A new program unlocks and drives each robot: refusing everything keeps no promise."""
        program = Program(
            self.loop,
            self.journal,
            self._dial_program,
            self.draw_number,
            name=len(self.programs),
            robots=[board.name for board in self.boards],
            dice=random.Random("calm"),
        )
        self._program_habits.append(Habits(delay_s=Span(0.001, 0.001)))
        program.connection = self._dial_program(program)
        program.send({"name": program.name, "priority": 50})
        program.send({"op": "unlock", "robot": ""})
        await self._until(self.loop.world_s + 1.0)
        for board in self.boards:
            before = sum(isinstance(each, Written) and each.number > 0 for each in self.journal.records)
            connection = board.connection if self._has(board) else None
            program.ride(board.name, RIDE_S)
            await self._until(self.loop.world_s + RIDE_S + 1.0)
            after = sum(isinstance(each, Written) and each.number > 0 for each in self.journal.records)
            is_same = connection is not None and board.connection is connection  # an earlier fault may end it only now
            if after < before + board.least_velocities and is_same:
                self.journal.add(Failed(self.loop.world_s, f"{board.name} cannot be driven when nothing happens"))
            if any(board.velocity) and is_same:  # a new connection begins with a zero
                self.journal.add(Failed(self.loop.world_s, f"{board.name} drives on after the last zero"))
        program.leave()

    async def _empty(self) -> None:
        """All have left: nothing is kept for them."""
        for board in self.boards:
            board.leave()
        await self._until(self.loop.world_s + LEAVE_S)
        assert self.hub is not None
        held = {kind: share.held_bytes for kind, share in self.hub.budget.shares.items() if share.held_bytes}
        if held:
            self.journal.add(Failed(self.loop.world_s, f"the byte budget holds {held} for those who have left"))
        tasks = Counter(task.get_name() for task in asyncio.all_tasks())
        extra = {name: count for name, count in sorted(tasks.items()) if name not in OWN_TASKS or count > 1}
        if extra:
            self.journal.add(Failed(self.loop.world_s, f"tasks of those who have left: {extra}"))
        links = [link.peer for link in self.hub.links.all()]
        if links:
            self.journal.add(Failed(self.loop.world_s, f"links of those who have left: {links}"))

    # -- the daemon ---------------------------------------------------------------------------------------------------

    def _start_daemon(self) -> None:
        self._daemon = self.loop.create_task(self._run_daemon(), name="daemon")

    async def _run_daemon(self) -> None:
        self.guardian, self._is_ending = Guardian(self), asyncio.Event()
        hub = Hub(
            self._config,
            CATALOG,
            reraises=True,
            guard=self.guardian,
            wall_ns=lambda: WALL_NS + round(self.loop.time() * 1e9),
            first_epoch=lambda: self._dice.getrandbits(40),
            first_call=lambda: self._calls.getrandbits(32),
        )
        async with meanwhile(("hub", hub.run())):
            await hub.is_running.wait()
            async with meanwhile(("programs", supervise(hub, "programs", lambda: Programs(self._entrance)))):
                self.hub = hub
                self.journal.add(Began(self.loop.time(), is_begun=True, was_killed=False))
                await self._is_ending.wait()
                await hub.shutdown()
                self.hub = None
        self.journal.add(Began(self.loop.time(), is_begun=False, was_killed=False))

    async def _end_daemon(self) -> None:
        assert self._daemon is not None
        self._is_ending.set()
        await self._daemon
        for connection in list(self.connections.values()):
            connection.host.close()
        left = sorted(task.get_name() for task in asyncio.all_tasks() - {asyncio.current_task()})
        if left:
            self.journal.add(Failed(self.loop.world_s, f"tasks after the daemon's end: {left}"))

    def _dial_board(self, board: Board) -> Connection | None:
        if self.hub is None:
            return None
        number = self.boards.index(board)
        connection = self._connect(board.address, self._board_habits[number], board)
        self._robots[connection.number] = board
        self.journal.add(Opened(self.loop.world_s, connection.number, board.name, self._is_clean[number], board.held_s))
        connection.host.on_written = lambda data: self.note_written(connection, data, by_guardian=False)
        connection.host.on_stuck = lambda is_stuck: self.journal.add(
            Stuck(self.loop.time(), connection.number, is_stuck)
        )
        self.loop.call_soon(self._accept, self.hub, connection)
        return connection

    def _accept(self, hub: Hub, connection: Connection) -> None:
        if self.hub is hub:
            hub.spawn(self._serve_link(hub, connection), name="link")
        elif not connection.host.is_dead:
            connection.cut()

    async def _serve_link(self, hub: Hub, connection: Connection) -> None:
        link = hub.links.open(connection.host, self._robots[connection.number].protocol)
        try:
            await hub.links.serve(link)
        finally:
            self.journal.add(Ended(self.loop.time(), connection.number))

    def _dial_program(self, program: Program) -> Connection | None:
        if self._entrance.accept is None:
            return None
        connection = self._connect(f"10.0.1.{program.name}", self._program_habits[program.name], program)
        self.loop.call_soon(self._admit, connection)
        return connection

    def _admit(self, connection: Connection) -> None:
        if self._entrance.accept is None:
            connection.cut()
        elif not connection.host.is_dead:
            self._entrance.accept(connection.host)

    def _connect(self, address: str, habits: Habits, peer: Board | Program) -> Connection:
        self._connection_number += 1
        number = self._connection_number
        connection = Connection(self.loop, number, address, habits, f"{self._seed} connection {number}", peer)
        self.connections[number] = connection
        return connection

    def note_written(self, connection: Connection, data: bytes, *, by_guardian: bool) -> None:
        """Note the velocities in what is written to a board."""
        at_s = self.loop.world_s if by_guardian else self.loop.time()
        board = self._robots[connection.number]
        for velocity in board.velocities_in(data):
            linear, *_, angular = TWIST.unpack(velocity)
            number = number_of(linear, angular)
            self.journal.add(Written(at_s, connection.number, board.name, number, by_guardian))

    # -- the weather --------------------------------------------------------------------------------------------------

    def _plan_weather(self, rate_hz: float, happen: Callable[[random.Random], None], dice: random.Random) -> None:
        def turn() -> None:
            if self._weather:
                self.journal.say(self.loop.world_s, f"weather {happen.__name__.strip('_')}")
                happen(dice)
                self.loop.after(dice.expovariate(rate_hz), turn)

        self.loop.after(dice.expovariate(rate_hz), turn)

    def _board_line(self, dice: random.Random) -> Connection | None:
        return dice.choice(self.boards).connection

    def _cut_board(self, dice: random.Random) -> None:
        connection = self._board_line(dice)
        if connection is not None:
            connection.cut()

    def _close_board(self, dice: random.Random) -> None:
        board = dice.choice(self.boards)
        if board.connection is not None:
            board.connection.close()
            board.lose_connection()

    def _vanish_board(self, dice: random.Random) -> None:
        board = dice.choice(self.boards)
        if board.connection is not None:
            board.connection.vanish()
            board.lose_connection()

    def _stall_board(self, dice: random.Random) -> None:
        connection = self._board_line(dice)
        if connection is not None:
            connection.stall(dice.choice((0.2, 0.6, 1.2, 3.0, 8.0)))

    def _hang_board(self, dice: random.Random) -> None:
        dice.choice(self.boards).hang(dice.choice((0.3, 1.0, 4.0)))

    def _reboot_board(self, dice: random.Random) -> None:
        dice.choice(self.boards).reboot(keeps_connection=dice.random() < 0.3)

    def _harm_board(self, dice: random.Random) -> None:
        number = dice.randrange(len(self.boards))
        connection = self.boards[number].connection
        if connection is not None and not self._is_clean[number]:
            connection.harm(dice.choice((Kind.DROP, Kind.DAMAGE, Kind.DUPLICATE)), dice.randint(1, 20))

    def _stall_program(self, dice: random.Random) -> None:
        connection = dice.choice(self.programs).connection
        if connection is not None:
            connection.stall(dice.choice((0.2, 0.45, 0.6, 1.0, 2.0)))

    def _cut_program(self, dice: random.Random) -> None:
        connection = dice.choice(self.programs).connection
        if connection is not None:
            connection.cut()

    def _be_late(self, dice: random.Random) -> None:
        self._burn(dice.choice((0.02, 0.1, 0.3, 0.45)))

    def _pause(self, dice: random.Random) -> None:
        self._burn(dice.choice((0.55, 0.8, 1.5, 3.0)))

    def _burn(self, seconds: float) -> None:
        def burn() -> None:
            began_s = self.loop.time()
            self.loop.burn(seconds)
            self.journal.add(Paused(self.loop.time(), began_s))

        self.loop.call_soon(burn)

    def _fail_component(self, _: random.Random) -> None:
        self._entrance.fail()

    def _kill_daemon(self, dice: random.Random) -> None:
        if self.hub is None or self._daemon is None:
            return
        self.hub, self._entrance.accept, self._entrance.fail = None, None, lambda: None
        self.journal.add(Began(self.loop.world_s, is_begun=False, was_killed=True))
        for connection in self.connections.values():
            connection.host.die()
        guardian, self.guardian = self.guardian, None
        guarded = set[int | None]() if guardian is None else guardian.take_over()
        for connection in self.connections.values():
            if not connection.is_over and connection.number not in guarded:
                connection.closed_by_host()
        self._replace_daemon(dice)
        self._old.cancel()

    def _restart_daemon(self, dice: random.Random) -> None:
        if self.hub is None or self._daemon is None:
            return
        self.hub = None  # it accepts no one from now on
        self._replace_daemon(dice)
        self._is_ending.set()

    def _replace_daemon(self, dice: random.Random) -> None:
        """Start another daemon when this one has ended."""
        assert self._daemon is not None
        old = self._old = self._daemon
        wait_s = dice.uniform(0.2, 2.0)

        async def replace() -> None:
            with contextlib.suppress(asyncio.CancelledError):
                await old
            for connection in self.connections.values():
                connection.host.die()
            began = asyncio.Event()
            self.loop.after(wait_s, began.set)
            await began.wait()
            await self._run_daemon()

        self._daemon = self.loop.create_task(replace(), name="daemon")


OWN_TASKS = frozenset(
    {
        "daemon",
        "hub",
        "programs",
        "diagnoses",
        "known robots",
        "zeros under a lock",
        "diagnostics",
        "bytes of devices",
        "log",
        "end",
        "world",
    }
)


@contextlib.contextmanager
def _logging_to(journal: Journal, loop: WorldLoop) -> Iterator[None]:
    """Log to a journal, for the length of the block."""

    def note(_: object, method: str, event: structlog.typing.EventDict) -> structlog.typing.EventDict:
        journal.log(loop.time(), {**event, "level": method})
        raise structlog.DropEvent

    processors = structlog.get_config()["processors"]
    before = processors.copy()
    processors[:] = [merge_contextvars, note]
    try:
        yield
    finally:
        processors[:] = before
