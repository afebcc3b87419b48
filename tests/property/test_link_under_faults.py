"""Host, relay and device in virtual time under any order of faults: intact frames are delivered, and both recover.

RECOVERY_S is the bound: within this time after the last fault, odometry arrives and commands reach the robot. It
consists of these parts: the device reconnects 0.5 s after an end that it notices; a lost topic request is repeated
after 2 s; a connection that only seems open gets a request after 5 s of silence; a false header on either side can hide
one answer.
"""

import asyncio
import struct
from collections import Counter
from contextlib import AbstractAsyncContextManager

from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule
from structlog.testing import capture_logs

from hostlink.core.protocol.rosserial.frame import encode
from tests.support.strategies import fewer_examples
from tests.support.virtual_device import NumberedRobot, pose
from tests.support.virtual_loop import VirtualLoop
from tests.support.virtual_world import CATALOG, Tap, World, world
from tools.faults import OF_BYTES, Direction, Fault, Habits, Kind, Script, Span

RECOVERY_S = 12.0
ODOMETRY_ID, VELOCITY_ID = 125, 100
PAPER_LOOP_S = 1 / 30  # without the retry clause, a frame that spans two such turns is lost by design
FAST_LOOP_S = 1 / 200
directions = st.sampled_from([None, *Direction])
habits = st.sampled_from(
    [
        Habits(),
        Habits(split_bytes=Span(1, 7)),
        Habits(merge_s=0.04),
        Habits(delay_s=Span(0.03, 0.07)),
        Habits(rate_bytes_s=3000.0),
        # Frames stay whole: the device would lose one that arrives in pieces.
        Habits(delay_s=Span(0.0, 0.1), rate_bytes_s=5000.0),
    ]
)


def intact_poses(tap: Tap, robot: NumberedRobot) -> Counter[int]:
    """Count how often each pose that the robot sent is intact in the bytes that the host read on this connection."""
    wire = bytes(tap.read_bytes)
    counts = {number: wire.count(encode(ODOMETRY_ID, pose(number))) for _, number in robot.sent}
    return Counter({number: count for number, count in counts.items() if count})


class Faults(RuleBasedStateMachine):
    """Any order of faults. Each law holds after each step, and at the end both sides work again."""

    @initialize(habits=habits, retries=st.booleans(), seed=st.integers(0, 1000))
    def connect(self, habits: Habits, retries: bool, seed: int) -> None:
        self.is_dirty = False
        self.is_calm_at_s = 0.0
        self.runner = asyncio.Runner(loop_factory=VirtualLoop)
        self.robot = NumberedRobot(CATALOG, retries=retries)
        loop_s = PAPER_LOOP_S if retries else FAST_LOOP_S
        self.robot.publish_every = round(0.1 / loop_s)
        self.is_over = asyncio.Event()
        begun: asyncio.Queue[World] = asyncio.Queue()

        async def live() -> None:
            with capture_logs():  # hundreds of links would hide the log of the failing one
                await go_on(world(Script(seed=seed, habits=habits), self.robot, loop_s=loop_s))

        async def go_on(context: AbstractAsyncContextManager[World]) -> None:
            async with context as made:
                begun.put_nowait(made)
                await self.is_over.wait()

        self.life = self.runner.get_loop().create_task(live())
        self.world = self.runner.run(begun.get())

    def run_for(self, seconds: float) -> None:
        self.runner.run(asyncio.sleep(seconds))
        assert not self.life.done()  # a crash of one link ends the hub in this test

    def inflict(self, kind: Kind, amount: float = 0.0, direction: Direction | None = None) -> None:
        async def now() -> None:
            self.world.relay.inflict(Fault(kind, amount, direction))
            lasting_s = 0.0 if kind in OF_BYTES else amount
            self.is_calm_at_s = max(self.is_calm_at_s, asyncio.get_running_loop().time() + lasting_s)

        self.is_dirty |= kind in OF_BYTES or kind is Kind.REBOOT
        self.runner.run(now())

    @rule(seconds=st.floats(0.01, 3.0))
    def let_run(self, seconds: float) -> None:
        self.run_for(seconds)

    @rule()
    def drive(self) -> None:
        async def now() -> None:
            self.world.command()

        self.runner.run(now())

    @rule(kind=st.sampled_from([Kind.CUT, Kind.CLOSE, Kind.HALF_OPEN]))
    def end_the_connection(self, kind: Kind) -> None:
        self.inflict(kind)

    @rule(seconds=st.floats(0.1, 2.0), direction=directions)
    def lose_a_segment(self, seconds: float, direction: Direction | None) -> None:
        self.inflict(Kind.LOSE, seconds, direction)

    @rule(seconds=st.floats(1.0, 20.0))
    def black_out(self, seconds: float) -> None:
        self.inflict(Kind.BLACKOUT, seconds)

    @rule(seconds=st.floats(0.1, 5.0))
    def reboot(self, seconds: float) -> None:
        self.robot.reboot()
        self.inflict(Kind.REBOOT, seconds)

    @rule(kind=st.sampled_from(OF_BYTES), count=st.integers(1, 100), direction=directions)
    def harm(self, kind: Kind, count: int, direction: Direction | None) -> None:
        self.inflict(kind, count, direction)

    @precondition(lambda self: hasattr(self, "world"))
    @invariant()
    def what_arrives_intact_is_delivered_once(self) -> None:
        delivered = Counter(self.world.numbers)
        invented = delivered.total() - sum(delivered[number] for _, number in self.robot.sent)
        assert invented == 0 or self.is_dirty
        unknown = 0
        intact: Counter[int] = Counter()
        for tap in self.world.taps:
            unknown += tap.session.counts.unknown_ids  # before its topics were announced
            intact += intact_poses(tap, self.robot)
        more, less = delivered - intact, intact - delivered
        assert more.total() == invented  # a damaged frame that passes the checksum: measured, not excluded
        waiting = (
            sum(len(device.early) for device in self.world.hub.robots.devices.values())
            + self.world.hub.links.undelivered
        )
        assert less.total() <= unknown + invented + waiting  # and frames that such a damaged frame overlaps
        if not self.is_dirty:
            assert max(delivered.values(), default=1) == 1
            assert self.world.numbers == sorted(self.world.numbers)

    @precondition(lambda self: hasattr(self, "world"))
    @invariant()
    def what_the_robot_obeys_was_commanded(self) -> None:
        sent = Counter(
            frame[7:-1]
            for tap in self.world.taps
            for frame in tap.written
            if frame[5:7] == struct.pack("<H", VELOCITY_ID)
        )
        obeyed = Counter(payload for _, payload in self.robot.commands)
        assert self.is_dirty or (obeyed <= sent and self.world.device.crashes == 0)

    def teardown(self) -> None:
        if not hasattr(self, "world"):
            return
        try:
            self.find_each_other()
            self.is_over.set()
            self.runner.run(asyncio.wait_for(self.life, 5.0))
        finally:
            self.runner.close()

    def find_each_other(self) -> None:
        """Check what must hold RECOVERY_S after the last fault."""
        self.world.relay.heal()
        self.run_for(max(0.0, self.is_calm_at_s - self.runner.get_loop().time()) + RECOVERY_S)
        assert self.world.is_working()
        poses, commands = len(self.world.poses), len(self.robot.commands)
        for _ in range(5):
            self.drive()
            self.run_for(0.2)
        assert len(self.world.poses) >= poses + 8
        assert len(self.robot.commands) >= commands + 4


TestFaults = Faults.TestCase
TestFaults.settings = fewer_examples(3, stateful_step_count=12)
