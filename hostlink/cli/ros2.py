"""`hostlink ros2`: robots in a ROS 2 graph, by a process of its own."""

import asyncio
import importlib.util
import sys
from collections.abc import Coroutine
from typing import Annotated, Any

import typer

from hostlink.cli.arguments import Token, Url
from hostlink.cli.ending import stop_signals
from hostlink.cli.output import write_error
from hostlink.client import DEFAULT_URL, PRIORITY
from hostlink.core.runtime.cancellation import first_error
from hostlink.errors import ConfigError, HostlinkError, LibraryMissing

CONTEXT = {"ignore_unknown_options": True, "allow_extra_args": True}  # arguments behind --ros-args are for ROS 2
ROS_ARGS = "--ros-args"
SWITCH_INTERVAL_S = (
    0.0005  # rclpy's thread holds the interpreter for a millisecond a message, and the event loop would wait
)


def command(
    context: typer.Context,
    *,
    priority: Annotated[
        int,
        typer.Option(
            min=0, max=100, help="Priority of velocities from ROS 2: 60 is that of teleop, a higher one overrules it."
        ),
    ] = PRIORITY,
    url: Url = DEFAULT_URL,
    token: Token = None,
) -> None:
    """Show the daemon's robots in ROS 2, and let ROS 2 drive them.

    Needs rclpy: a sourced ROS 2 installation, or its packages from PyPI. Arguments behind --ros-args are passed to
    rclpy: --ros-args -r __ns:=/site -p use_sim_time:=true. docs/ros2.md explains them.
    """
    if context.args and context.args[0] != ROS_ARGS:
        raise ConfigError(
            context.args[0], f"is not an option of hostlink ros2; write arguments of ROS 2 behind {ROS_ARGS}"
        )
    if importlib.util.find_spec("rosbags") is None:
        raise LibraryMissing("ros2", "rosbags", "ros2")
    try:
        from hostlink.components.ros2.bridge import BridgeConfig, run_bridge  # noqa: PLC0415 - it takes time to import
        from hostlink.components.ros2.node import ros2_node  # noqa: PLC0415 - rclpy may not be there
    except ImportError as error:
        raise HostlinkError(
            f"rclpy cannot be imported ({error}): source a ROS 2 installation (. /opt/ros/DISTRO/setup.sh), or run "
            "pip install 'ros-rclpy[fastrtps]' ros-geometry-msgs ros-nav-msgs ros-sensor-msgs ros-std-srvs"
        ) from error
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    config = BridgeConfig(url=url, token=token, priority=priority, ros_arguments=context.args)
    try:
        asyncio.run(_until_signal(run_bridge(config, ros2_node, _report)))
    except BaseExceptionGroup as group:
        raise first_error(group) from None


async def _until_signal(bridge: Coroutine[Any, Any, None]) -> None:
    with stop_signals() as ending:
        async with asyncio.TaskGroup() as tasks:
            running = tasks.create_task(bridge)
            waiting = tasks.create_task(ending.wait())
            await asyncio.wait((running, waiting), return_when=asyncio.FIRST_COMPLETED)
            running.cancel()
            waiting.cancel()


def _report(text: str) -> None:
    write_error(f"hostlink ros2: {text}")
