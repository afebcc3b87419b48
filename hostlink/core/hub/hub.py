"""Hub: the parts that devices and participants share. The hub runs them, and stops every robot at the daemon's end."""

import asyncio
import contextlib
from collections.abc import Callable
from dataclasses import dataclass

import structlog

from hostlink.core.config import Config
from hostlink.core.hub.device_bytes import DeviceBytes
from hostlink.core.hub.diagnostics_topic import DiagnosticsTopic
from hostlink.core.hub.gates import Guard
from hostlink.core.hub.graph_changes import GraphKind
from hostlink.core.hub.links import Links, commands_by_name
from hostlink.core.hub.message import PROGRAM_PRIORITY
from hostlink.core.hub.node import Role
from hostlink.core.hub.participant import Participant
from hostlink.core.hub.reloader import Read, Reloader
from hostlink.core.hub.robot_topic_publisher import RobotTopicPublisher
from hostlink.core.hub.robots import Robots
from hostlink.core.hub.rosout import Rosout
from hostlink.core.hub.shared import DAEMON, Shared, draw_call, draw_epoch
from hostlink.core.hub.standstills import LockServices, Standstills
from hostlink.core.messages.catalog import Catalog
from hostlink.core.robot.names import Places
from hostlink.core.runtime.logs import log_what_is_missing
from hostlink.core.runtime.loop_time import loop_time_s

log = structlog.get_logger()

STOP_REPEATS = 3  # a single stop can be lost on a radio
STOP_INTERVAL_S = 0.05
SHUTDOWN_TIMEOUT_S = 0.5
LOG_INTERVAL_S = 10.0  # between two lines about dropped log lines


@dataclass(frozen=True, slots=True)
class Listening:
    """Addresses of the listening sockets; None if it does not listen."""

    tcp: tuple[str, int] | None = None
    udp: tuple[str, int] | None = None
    micro_ros: tuple[str, ...] = ()  # for micro-ROS boards: "udp://127.0.0.1:8888"


class Hub(Shared):
    """Everything that is connected. Methods are synchronous, so each is atomic; only services wait."""

    def __init__(
        self,
        config: Config,
        catalog: Catalog,
        *,
        reraises: bool = False,
        guard: Guard | None = None,
        read: Read | None = None,
        slept_s: Callable[[], float] = lambda: 0.0,
        computed_s: Callable[[], float] = loop_time_s,
        wall_ns: Callable[[], int] | None = None,
        first_epoch: Callable[[], int] = draw_epoch,
        first_call: Callable[[], int] = draw_call,
        namespace: str = "/",
    ) -> None:
        """Connect nothing yet.

        `reraises` is for tests: a crash of one link ends the hub. Otherwise it is logged and counted.
        `read` reads the settings again, as a new start would; None if the daemon has no file.
        `slept_s` returns for how long the computer has slept so far, which the event loop's clock leaves out.
        `computed_s` returns the CPU time of the event loop's thread, without the time for which it waited for a core.
        `wall_ns` returns the time of day; None: that of the computer. `first_epoch` draws that of a robot, `first_call`
        the number of a connection's first call of a service.
        `namespace` distinguishes this daemon in /diagnostics.
        """
        super().__init__(
            config,
            catalog,
            reraises=reraises,
            guard=guard,
            slept_s=slept_s,
            computed_s=computed_s,
            wall_ns=wall_ns,
            namespace=namespace,
        )
        self.is_running = asyncio.Event()  # `spawn` works when it is set
        self.listening = Listening()  # set by the listeners
        self.on_end_request: Callable[[str], None] = lambda _: None  # called with the reason that a component gives
        self.robots = Robots(self.gates, config, first_epoch)
        self.robot_topics = RobotTopicPublisher(self.topics, self.node, catalog)
        self.standstills = Standstills()
        self._lock_services = LockServices(self.robots, self.gates, self.standstills, self.join_daemon())
        self.rosout = Rosout(self.join_daemon(), self.wall_ns)
        self.links = Links(self, self.robots, self.robot_topics, self.rosout.log, first_call)
        self.robots.on_change, self.robots.on_forgotten = self._note_robot, self.links.forget_robot
        self.reloader = Reloader(self, read)

    async def run(self) -> None:
        """Serve until cancelled. This task is the parent of every spawned one."""
        async with asyncio.TaskGroup() as self.tasks:
            self.spawn(self.diagnoses.run(), name="diagnoses")
            self.spawn(self.robots.run(), name="known robots")
            self.spawn(self.robots.repeat_zeros(), name="zeros under a lock")
            self.spawn(DiagnosticsTopic(self, self.robots, self.join_daemon()).run(), name="diagnostics")
            self.spawn(DeviceBytes(self.topics.budget["devices"], self.links.memories).run(), name="bytes of devices")
            self.spawn(_log_what_is_missing(), name="log")
            self.is_running.set()
            await self.gates.run()

    def reconfigure(self, config: Config, places: Places) -> dict[str, str]:
        """Change names and limits of robots. Return the new names of connected robots by their old ones.

        `places` are from `places_of` with the same settings.

        Raises:
            ReloadRefused: a robot that is driven or locked would have another name; nothing has changed.
        """
        self.links.check(places)
        self.config = config
        self.robots.reconfigure(config.robots)
        return self.links.reconfigure(places, commands_by_name(config))

    # -- participants -------------------------------------------------------------------------------------------------

    def join(
        self,
        name: str,
        *,
        role: Role = Role.DRIVE,
        priority: int = PROGRAM_PRIORITY,
        group: str = "",
        on_end: Callable[[], None] = lambda: None,
    ) -> Participant:
        """Create the participant of a program. `on_end` is called when a failure of its callbacks ends it.

        `group` is the bridge to another graph, such as ROS 2, to which it belongs. The group does not receive its own
        messages.
        """
        return Participant(self, name, role=role, priority=priority, group=group, on_end=on_end)

    def join_daemon(self, *, group: str = "") -> Participant:
        """Create a participant of the daemon, which no failure of its callbacks ends. `group` is as for `join`."""
        return Participant(self, DAEMON, is_daemon=True, group=group)

    async def shutdown(self) -> None:
        """Stop every robot, request silence of every device, end every link, within SHUTDOWN_TIMEOUT_S.

        Commands are refused from the start, so that the last velocity to each robot is zero.
        """
        self.gates.refuse_all()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(SHUTDOWN_TIMEOUT_S):
                for _ in range(STOP_REPEATS if self.robots.drivables() else 0):
                    self.gates.stop_at_once(self.robots.drivables())
                    await asyncio.sleep(STOP_INTERVAL_S)
                await self.links.silence()
        self.links.end_all()

    def _note_robot(self, name: str) -> None:
        """Note that a robot of this name connected, disconnected or was forgotten."""
        self.changes.note(GraphKind.ROBOT, name)
        self._lock_services.update(name)


async def _log_what_is_missing() -> None:
    while True:
        await asyncio.sleep(LOG_INTERVAL_S)
        log_what_is_missing()
