"""`hostlink demo`: the daemon and simulated robots in one process. A demo driver moves them in a gentle curve."""

import asyncio
import contextlib
import math
import sys
from collections.abc import Callable, Mapping
from typing import Annotated

import typer

from hostlink.cli.ending import Ending, stop_signals
from hostlink.cli.output import show_progress, write
from hostlink.cli.own_name import own_name
from hostlink.cli.serve import import_components, running
from hostlink.cli.serve_command import Origins, allow_origins, merge
from hostlink.cli.sim import Kind
from hostlink.core.config import Config, RobotConfig
from hostlink.core.hub.hub import Hub
from hostlink.core.hub.participant import Participant
from hostlink.core.hub.robot import LocalRobot
from hostlink.core.robot.velocity import PlanarVelocity
from hostlink.core.runtime import logs
from hostlink.core.runtime.cancellation import meanwhile
from hostlink.core.runtime.listening import spelled
from hostlink.errors import ConfigError, HostlinkError
from hostlink.workbench.sim.firmware_module import require_wasmtime
from hostlink.workbench.sim.firmware_world import RobotKind
from hostlink.workbench.sim.run import SocketAddress, run_fleet

OWNER = "demo"
DEMO_PRIORITY = 0  # every other driver takes precedence
CURVE = PlanarVelocity(0.15, yaw_rad_s=0.3)  # a circle of a metre across
COMMAND_INTERVAL_S = 0.2  # well within the lease
PAUSE_S = 5.0  # a person who has driven may want to watch before the demo continues
LINE_INTERVAL_S = 0.2
DRIVE = "/demo/drive"
AS_MAKE = "make passes options on: make demo ARGS='--api 127.0.0.1:9091 --listen 127.0.0.1:11412'"
START_AGAIN = "the demo's driver was interrupted; to start it again:"
# docs/paper-robot.md#numbers
PAPER_ROBOT = RobotConfig(kinematics="differential", wheel_separation_m=0.210, max_wheel_m_s=0.3436)


def command(
    *,
    robots: Annotated[int, typer.Option(min=1, max=50, help="Number of simulated robots: more to see a fleet.")] = 1,
    robot: Kind = RobotKind.NIMBLE,
    listen: Annotated[
        str, typer.Option(help="Address and port on which your own devices may connect, too: HOST:PORT.")
    ] = "127.0.0.1:11411",
    api: Annotated[
        str, typer.Option(help="Address and port on which programs connect, if 9090 is in use: HOST:PORT.")
    ] = "127.0.0.1:9090",
    origin: Origins = None,
) -> None:
    """Run the daemon with simulated robots, to drive or to watch."""
    require_wasmtime("hostlink demo")
    logs.configure(level="error")
    names = {f"robot_{number}": PAPER_ROBOT for number in range(robots)}
    config = allow_origins(merge(Config(robots=names), listen=listen, api=api), origin)
    import_components(config)
    try:
        asyncio.run(_demo(config, robots, robot))
    except ConfigError as error:
        if "HOST:PORT" not in error.problem:
            raise
        raise ConfigError(error.where, f"{error.problem}; {AS_MAKE}") from error


class Output:
    """Output of the demo. When it cannot be written, the demo ends in order, and `raise_error` raises the error."""

    def __init__(self, ending: Ending) -> None:
        self._ending = ending
        self._error: OSError | None = None

    def show(self, show: Callable[..., None], *lines: str) -> None:
        """Write lines by `show`, which is a function that writes one."""
        try:
            show(*lines)
        except OSError as error:
            self._error = error
            self._ending.request("standard output is gone")

    def raise_error(self) -> None:
        """Raises:
        OSError: the output could not be written.
        """
        if self._error is not None:
            raise self._error


async def _demo(config: Config, robots: int, kind: RobotKind) -> None:
    own: dict[str, str] = {}  # addresses of the simulated robots, by name

    def note_own(name: str, address: SocketAddress) -> None:
        own[name] = spelled(*address[:2])

    with stop_signals() as ending:
        output = Output(ending)
        async with running(config) as (hub, addresses):
            fleet = run_fleet(*addresses.tcp, robots=robots, kind=kind, on_connected=note_own)
            participant = hub.join(OWNER, priority=DEMO_PRIORITY)
            demo = DemoDriver(hub, participant, lambda peer: peer in own.values())
            async with meanwhile(("simulated robots", fleet)):
                async with meanwhile(("demo driver", demo.run()), ("live line", _show(hub, demo, output))):
                    output.show(write, *_welcome(addresses.api))
                    await ending.wait()
                output.show(write, "", "stopping the robots ...")
                participant.leave()
                await asyncio.sleep(LINE_INTERVAL_S)  # so that the simulated robots receive the stop
    output.raise_error()


def _welcome(api: str) -> tuple[str, ...]:
    hostlink = own_name()
    return (
        f"hostlink runs: {api}  (open it in a browser)",
        f"  drive     {hostlink} teleop --url {api}",
        f'  or        curl -X PUT {api}/api/robots/robot_0/velocity -d \'{{"linear": 0.1, "angular": 0.5}}\'',
        f"  read      curl {api}/api/robots/robot_0/odometry",
        f"  stop      {hostlink} stop --url {api}",
        f"  again     {hostlink} call {DRIVE} --url {api}  (after a stop the demo waits for this)",
        "Ctrl-C ends it.",
    )


class DemoDriver:
    """Driver of the demo's own robots in a curve. A board of the user, which may connect too, is never driven.

    It pauses for a robot until PAUSE_S after another driver's last command.

    After an interruption (a stop, a lock, a reconnection) it leaves the robot alone until the service DRIVE is called.
    """

    def __init__(self, hub: Hub, participant: Participant, is_own: Callable[[str], bool]) -> None:
        """Drive robots whose device is connected from an address for which `is_own` is true."""
        self._hub, self._participant, self._is_own = hub, participant, is_own
        self._epochs: dict[str, int] = {}  # of each robot, when the demo began to drive it
        self._busy_until_s: dict[str, float] = {}
        self.stopped: set[str] = set()  # the names of robots that are not driven until DRIVE is called

    async def run(self) -> None:
        """Drive until cancelled."""
        self._participant.provide(DRIVE, "std_srvs/Trigger", self._start_again)
        while True:
            for robot in self._hub.robots.here():
                self._drive(robot)
            await asyncio.sleep(COMMAND_INTERVAL_S)

    def _drive(self, robot: LocalRobot) -> None:
        now_s = asyncio.get_running_loop().time()
        if robot.link is None or not self._is_own(robot.link.peer):
            return
        epoch = self._epochs.setdefault(robot.name, robot.gate.admission.epoch)
        if epoch != robot.gate.admission.epoch:
            self.stopped.add(robot.name)
        elif robot.gate.owner not in (None, self._participant):
            self._busy_until_s[robot.name] = now_s + PAUSE_S
        elif now_s >= self._busy_until_s.get(robot.name, 0.0):
            with contextlib.suppress(HostlinkError):  # another source drives the robot now, or interrupts it
                self._participant.drive(robot, CURVE, epoch=epoch)

    async def _start_again(self, _: Mapping[str, object]) -> Mapping[str, object]:
        """Drive the stopped robots again, except those that are locked: their unlocking is an interruption too."""
        locked = {robot.name for robot in self._hub.robots.here() if robot.gate.admission.lock_reason is not None}
        driven, left = sorted(self.stopped - locked), sorted(self.stopped & locked)
        for name in driven:
            self._epochs.pop(name, None)
        self.stopped.intersection_update(left)
        told = [f"the demo drives again: {', '.join(driven)}"] if driven else []
        told += [f"locked: {', '.join(left)}; run `hostlink unlock`, then call {DRIVE} again"] if left else []
        return {"success": bool(driven) or not left, "message": "; ".join(told) or "no robot was stopped"}


async def _show(hub: Hub, demo: DemoDriver, output: Output) -> None:
    """Show the robots in one line that is written over on a terminal, or in a line a second in a file or a pipe."""
    is_terminal = sys.stdout.isatty() and sys.stderr.isatty()
    told = set[str]()  # the names of stopped robots for which a line was written
    while True:
        robots = hub.robots.here()
        for name in sorted(demo.stopped - told):
            output.show(write, f"{name}: {START_AGAIN} {own_name()} call {DRIVE}")
        told = set(demo.stopped)
        if robots:
            output.show(show_progress if is_terminal else write, "   ".join(map(_describe, robots[:2])))
        await asyncio.sleep(LINE_INTERVAL_S if is_terminal else 1.0)


def _describe(robot: LocalRobot) -> str:
    if robot.link is None:
        return f"{robot.name} is not connected"
    estimate = robot.odometry.snapshot(asyncio.get_running_loop().time())
    if estimate is None or estimate.pose is None or estimate.twist is None:
        return f"{robot.name} waits for its odometry"
    pose, twist = estimate.pose, estimate.twist
    return (
        f"{robot.name}  x {pose.x_m:+6.2f} m  y {pose.y_m:+6.2f} m  "
        f"heading {math.degrees(pose.theta_rad):+6.1f}°  {twist.x_m_s:+5.2f} m/s  "
        f"driven by {robot.gate.owner_name or 'nobody'}"
    )
