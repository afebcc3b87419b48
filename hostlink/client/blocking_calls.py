"""The methods of Host and Robot without `async`, as tools/blocking_client.py makes them: change those.

Needed for types: Python cannot declare a proxy whose methods are those of a class without `async`, so mypy and editors
would accept any call of a generic one.
"""

import contextlib
from collections.abc import Mapping
from typing import Any, overload

from hostlink.client.host import Host
from hostlink.client.http_client import REQUEST_TIMEOUT_S
from hostlink.client.loop_thread import LoopThread, Messages, Opened, PlainAnswer, Stream, in_thread
from hostlink.client.motion import OnProgress
from hostlink.client.robot import PRIORITY, WAIT_S, Robot
from hostlink.client.type_names import TypeName
from hostlink.client.views import (
    ConnectionChange,
    Driven,
    Event,
    Motion,
    Odometry,
    RawMessage,
    Refusal,
    RobotState,
    TopicState,
)
from hostlink.robot.standstill import Standstill


class BlockingRobot:
    """One robot of a host; get one from `BlockingHost.robot`."""

    def __init__(self, loop: LoopThread, robot: Robot) -> None:
        self._loop, self._robot = loop, robot

    @property
    def name(self) -> str:
        """Name without a slash."""
        return self._robot.name

    @property
    def priority(self) -> int:
        """Priority of its commands, 0 to 100."""
        return self._robot.priority

    @property
    def is_driven(self) -> bool:
        """Whether this connection holds a velocity of the robot."""
        return self._robot.is_driven

    @property
    def client_name(self) -> str | None:
        """Name of this connection at the daemon, as in `holder` of `state()`; None before the first command."""
        return self._robot.client_name

    def state(self) -> RobotState:
        """Connected, holder, velocity (m/s, rad/s) and odometry, as they are now.

        Raises:
            HostlinkError: no robot of that name, no hostlink.
        """
        return self._loop.run(self._robot.state())

    @overload
    def drive(
        self,
        linear_m_s: float,
        angular_rad_s: float,
        linear_y_m_s: float = 0.0,
        *,
        for_s: None = None,
        keep: bool = False,
    ) -> Driven: ...
    @overload
    def drive(self, linear_m_s: float, angular_rad_s: float, linear_y_m_s: float = 0.0, *, for_s: float) -> Motion: ...
    @overload
    def drive(
        self,
        linear_m_s: float,
        angular_rad_s: float,
        linear_y_m_s: float = 0.0,
        *,
        for_s: float | None,
        keep: bool = False,
    ) -> Driven | Motion: ...

    def drive(
        self,
        linear_m_s: float,
        angular_rad_s: float,
        linear_y_m_s: float = 0.0,
        *,
        for_s: float | None = None,
        keep: bool = False,
    ) -> Driven | Motion:
        """Drive until the next `drive` or `stop`, or until the connection's block is left; or for `for_s` seconds.

        m/s forward, rad/s counter-clockwise, m/s to the left. Returns when the daemon has accepted the command, with
        what the robot's limits have made of it; it is then repeated ten times a second. `drive(0, 0)` slows down and
        continues to drive; `stop()` stops and lets go. A stop or a lock by any program ends it as a refusal does.

        With `for_s` it returns when the time is over and a zero was sent, or when something has stopped the robot
        earlier: a Motion whose `outcome` is `reached` or `stopped`. With `keep` the robot drives on after the end of a
        notebook's cell, which else stops it.

        Raises:
            HostlinkError: and the robot is not driven: no robot of that name, its device is not connected, a source
                with a higher priority drives it or it is locked, the numbers are not finite, it cannot move sideways,
                there is no connection to hostlink. Also once after the velocity that was held before was dropped: by a
                cut of the connection, by such a refusal, by a stop, because the robot's device connected again, or this
                program did not run, or could not send, for half a second. The `drive()` after that one drives again.
            CommandRefused: one of these, with `kind` for programs.
        """
        return self._loop.run(self._robot.drive(linear_m_s, angular_rad_s, linear_y_m_s, for_s=for_s, keep=keep))

    def move(
        self,
        metres: float,
        *,
        speed_m_s: float = 0.2,
        timeout_s: float | None = None,
        on_progress: OnProgress | None = None,
    ) -> Motion:
        """Move along a line by odometry, and stop; negative `metres` lead backwards.

        It returns when the robot has stopped, or when something has stopped it earlier: `outcome` is `reached`,
        `blocked` (the odometry does not advance), `stopped` (with `kind`, `by` and `reason`) or `timed_out`. The robot
        is also stopped when it has no odometry for half a second, or leaves the line by 0.3 m. `on_progress` is called
        with a Progress for each pose. `timeout_s` is by default 10 s and four times what the speed needs.

        Raises:
            HostlinkError: nothing was driven: the first command was refused, as `drive` tells, there is no odometry, or
                a number is invalid.
        """
        return self._loop.run_reporting(
            lambda report: self._robot.move(metres, speed_m_s=speed_m_s, timeout_s=timeout_s, on_progress=report),
            on_progress,
        )

    def turn(
        self,
        radians: float,
        *,
        speed_rad_s: float = 0.8,
        timeout_s: float | None = None,
        on_progress: OnProgress | None = None,
    ) -> Motion:
        """Turn on the spot by odometry, and stop; counter-clockwise is positive. It ends as `move` does.

        Raises:
            HostlinkError: nothing was driven: the first command was refused, as `drive` tells, there is no odometry, or
                a number is invalid.
        """
        return self._loop.run_reporting(
            lambda report: self._robot.turn(radians, speed_rad_s=speed_rad_s, timeout_s=timeout_s, on_progress=report),
            on_progress,
        )

    def command(
        self,
        linear_m_s: float,
        angular_rad_s: float,
        linear_y_m_s: float = 0.0,
        *,
        epoch: int | None = None,
        is_planar: bool = True,
    ) -> None:
        """Send one velocity, which lasts for half a second and is not repeated: for programs that decide each time.

        It does not wait for the answer; `refusal` has it. Commands less than half a second apart are one motion: after
        a stop, a lock or a reconnection of the device the motion is refused, until a zero or half a second without
        commands ends it. A command that the network delivers too late is refused, too. `epoch` is the robot's, as in
        `state()`, when the decision was made: after an interruption since then the command is refused. `is_planar` is
        False for a Twist with other components that are not zero: no robot obeys it, and it is refused.

        Raises:
            HostlinkError: the numbers are not finite, or there is no connection to hostlink.
        """
        return self._loop.run(
            self._robot.command(linear_m_s, angular_rad_s, linear_y_m_s, epoch=epoch, is_planar=is_planar)
        )

    @property
    def refusal(self) -> Refusal | None:
        """Reason why the newest answered `command` was refused; None if it was accepted."""
        return self._robot.refusal

    def stop(self, *, wait_s: float = WAIT_S) -> Standstill:
        """Stop the robot, also if others drive it; return what was measured since. Its decelerations apply.

        The stop is sent at once. The measurement lasts until the robot has stopped, at most `wait_s` seconds; 0 does
        not wait. A source that was driving must let go before it can drive again.

        Raises:
            HostlinkError: hostlink was not reached within a second; what this script held ends anyway.
        """
        return self._loop.run(self._robot.stop(wait_s=wait_s))

    def lock(self, reason: str, *, wait_s: float = WAIT_S) -> Standstill:
        """The emergency stop: zero at once, and every command of everybody is refused until `unlock`.

        Returns what was measured since, as `stop` does.

        Raises:
            HostlinkError: hostlink was not reached within a second.
        """
        return self._loop.run(self._robot.lock(reason, wait_s=wait_s))

    def unlock(self) -> None:
        """Let it be driven again; nothing that was held before drives it.

        This script knows of the lock: its next `drive()` drives, unless the robot was interrupted again meanwhile.

        Raises:
            HostlinkError: hostlink was not reached.
        """
        return self._loop.run(self._robot.unlock())

    def reset_odometry(self) -> None:
        """Make the present place the origin.

        Raises:
            HostlinkError: the robot cannot do that, or is not connected.
        """
        return self._loop.run(self._robot.reset_odometry())

    def odometry(self) -> Stream[Odometry]:
        """The newest pose (m, rad), then each new one once, with twist (m/s, rad/s), stamp (ns), age (s) and rate (Hz).

        It pauses while the robot or the connection is gone, and continues afterwards. A slow reader gets fewer
        of them.

        Raises:
            HostlinkError: when it begins: no robot of that name, no hostlink; with `reconnect=False` also when the
                connection is lost.
        """
        return Stream(self._loop, self._robot.odometry(), "odometry")

    def __repr__(self) -> str:
        return repr(self._robot).replace("Robot", "BlockingRobot", 1)


class HostCalls:
    """Methods of BlockingHost that correspond to those of Host."""

    def __init__(self, loop: LoopThread, host: Host) -> None:
        self._loop, self._host = loop, host

    @property
    def url(self) -> str:
        """Address of the daemon."""
        return self._host.url

    def robots(self) -> list[RobotState]:
        """Every robot: name, connected, holder, velocity (m/s, rad/s), odometry (m, rad)."""
        return self._loop.run(self._host.robots())

    def topics(self) -> list[TopicState]:
        """Every topic: name, type, publishers, subscribers, messages."""
        return self._loop.run(self._host.topics())

    def links(self) -> list[dict[str, Any]]:
        """Every live connection of a device, with its counters."""
        return self._loop.run(self._host.links())

    def watch(self) -> Stream[Event]:
        """State of the daemon as it changes: robots, links, clients, and the devices' log lines.

        The newest of each first, then `robots` when one of them changes, ten times a second at most, `links` and
        `clients` once a second, and each `log` line. It pauses while the connection is lost, and continues
        afterwards. A reader that is slow gets fewer states, always the newest.

        Raises:
            HostlinkError: in the iteration: when it begins, hostlink refuses or is not there; with `reconnect=False`
                also when the connection is lost.
        """
        return Stream(self._loop, self._host.watch(), "watch")

    def robot(self, name: str, *, priority: int = PRIORITY) -> BlockingRobot:
        """The robot of that name; that it exists is found out by the first use.

        `priority`, 0 to 100: a command of a higher one takes the robot over, one of a lower is refused. A program is
        50, teleop 60.
        """
        return BlockingRobot(self._loop, self._host.robot(name, priority=priority))

    def stop_all(self, *, wait_s: float = WAIT_S) -> dict[str, Standstill]:
        """Stop every robot, also those that others drive; return what was measured since, as `Robot.stop` does.

        Raises:
            HostlinkError: hostlink was not reached, or another daemon of the fleet has not answered.
        """
        return self._loop.run(self._host.stop_all(wait_s=wait_s))

    def standstill(self, *, wait_s: float = WAIT_S) -> dict[str, Standstill]:
        """Measure by new odometry whether each robot has stopped, for at most `wait_s` seconds.

        Raises:
            HostlinkError: hostlink was not reached.
        """
        return self._loop.run(self._host.standstill(wait_s=wait_s))

    def publish(
        self, topic: str, message: Mapping[str, Any], *, type_name: TypeName = "", priority: int = PRIORITY
    ) -> None:
        """Send one message; fields that are missing are zero. `type_name` may be left out when the topic is known.

        It is a name, as "std_msgs/String", or a message class of genpy, rclpy or rosbags; in all calls that take one.
        Numbers and arrays of numpy are as good as Python's.

        Raises:
            HostlinkError: there is no connection, or an earlier message on this topic was refused. The refusal of the
                last one is raised by `settle`, and at the end of the connection's block.
        """
        return self._loop.run(self._host.publish(topic, message, type_name=type_name, priority=priority))

    def publish_raw(self, topic: str, payload: bytes, *, type_name: TypeName = "", priority: int = PRIORITY) -> None:
        """Send one serialised message, as rosserial and ROS 1 have it.

        Raises:
            HostlinkError: there is no connection, or an earlier message on this topic was refused.
        """
        return self._loop.run(self._host.publish_raw(topic, payload, type_name=type_name, priority=priority))

    def pop_refusal(self, topic: str) -> str:
        """Return why a message on the topic was refused since the last call; empty if none was."""
        return self._host.pop_refusal(topic)

    def advertise(self, topic: str, type_name: TypeName, *, is_latched: bool = False) -> Opened:
        """Be a publisher of the topic for the length of the block, across losses of the connection too.

        With `is_latched` programs that subscribe later get the last message.

        Raises:
            HostlinkError: when it begins, there is no connection. An unknown type is raised by the next `publish`.
        """
        return Opened(self._loop, self._host.advertise(topic, type_name, is_latched=is_latched), topic)

    def subscribe(
        self, topic: str, *, type_name: TypeName = "", throttle_rate_ms: int = 0, queue_length: int = 0
    ) -> Messages[dict[str, Any]]:
        """The messages of a topic, from now on, for the length of the block, across losses of the connection too.

        With `throttle_rate_ms` at most one message in so many milliseconds; the newest `queue_length` wait. Messages
        are dicts as in docs/api.md. `dropped` of what this gives counts what the block was too slow for: the newest
        256 wait.

        Raises:
            HostlinkError: there is no connection when it begins; in the iteration: the subscription was refused.
        """
        return Messages(
            self._loop,
            self._host.subscribe(
                topic, type_name=type_name, throttle_rate_ms=throttle_rate_ms, queue_length=queue_length
            ),
        )

    def subscribe_raw(self, topic: str, *, type_name: TypeName = "") -> Messages[RawMessage]:
        """The messages of a topic as bytes, with the time at which each reached the daemon; else as `subscribe`.

        Do not combine it with a `subscribe` of the same topic on one connection: the daemon sends each message once,
        in one form.

        Raises:
            HostlinkError: there is no connection when it begins; in the iteration: the subscription was refused.
        """
        return Messages(self._loop, self._host.subscribe_raw(topic, type_name=type_name))

    def watch_graph(self) -> Messages[dict[str, Any]]:
        """The topics, services and robots of all who are not of this connection's group: now, and after every change.

        docs/api.md has their fields. It lasts as long as the reader keeps what this returns, across losses of the
        connection too.

        Raises:
            HostlinkError: there is no connection when it begins.
        """
        return Messages(self._loop, contextlib.nullcontext(self._loop.run(self._host.watch_graph())))

    def serve(self, service: str, type_name: TypeName, answer: PlainAnswer) -> Opened:
        """Answer the calls of a service for the length of the block, across losses of the connection too.

        `answer`, a function or a coroutine function, receives the request and returns the response, both as dicts;
        None is an empty response, a HostlinkError fails the call.

        Raises:
            HostlinkError: there is no connection when it begins.
        """
        return Opened(self._loop, self._host.serve(service, type_name, in_thread(answer)), service)

    def call(
        self, service: str, arguments: Mapping[str, Any] | None = None, *, timeout_s: float = REQUEST_TIMEOUT_S
    ) -> Any:
        """Call a service; returns its response. Fields of the request that are missing are zero.

        Raises:
            HostlinkError: no such service, it failed, it did not answer within `timeout_s`, or the connection was lost
                meanwhile: then it is unknown whether the service ran, and it is not called again.
        """
        return self._loop.run(self._host.call(service, arguments, timeout_s=timeout_s))

    @property
    def is_connected(self) -> bool:
        """Whether the connection is there; a cut shows within a second."""
        return self._host.is_connected

    def connection(self) -> Messages[ConnectionChange]:
        """Each loss and each return of the connection from now on, with the robots whose velocity was dropped."""
        return Messages(self._loop, contextlib.nullcontext(self._loop.call(self._host.connection)))

    def get(self, path: str) -> dict[str, Any]:
        """A GET of the REST API.

        Raises:
            HostlinkError: the daemon refuses, with its reason; or it was not reached.
        """
        return self._loop.run(self._host.get(path))

    def post(self, path: str, body: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """A POST of the REST API.

        Raises:
            HostlinkError: the daemon refuses, with its reason; or it was not reached.
        """
        return self._loop.run(self._host.post(path, body))

    def download(self, path: str) -> Stream[bytes]:
        """The pieces of a file, as a recording's; the connection may take as long as it needs.

        Raises:
            HostlinkError: the daemon refuses, with its reason; it was not reached, or the connection is lost.
        """
        return Stream(self._loop, self._host.download(path), "download")

    def send(self, request: Mapping[str, Any]) -> None:
        """Send one rosbridge operation.

        Raises:
            HostlinkError: there is no connection.
        """
        return self._loop.run(self._host.send(request))

    def settle(self) -> None:
        """Wait until the daemon has read what was sent so far.

        Raises:
            HostlinkError: a published message was refused, and the refusal was not reported yet; there is no
                connection, or it is lost meanwhile.
        """
        return self._loop.run(self._host.settle())
