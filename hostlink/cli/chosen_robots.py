"""Which robots a command means."""

from hostlink.cli.names import natural, unknown
from hostlink.client import Host, RobotState
from hostlink.errors import HostlinkError


async def chosen(host: Host, name: str | None) -> list[RobotState]:
    """The robot of that name; without a name every robot, in natural order.

    Raises:
        HostlinkError: there is none of that name, or none at all.
    """
    robots = await host.robots()
    if not robots:
        raise HostlinkError("no robot has connected yet; `hostlink doctor` finds out why")
    if name is None:
        return sorted(robots, key=lambda robot: natural(robot["name"]))
    found = [robot for robot in robots if robot["name"] == name.strip("/")]
    if not found:
        raise unknown("robot", name, (robot["name"] for robot in robots), command="robots")
    return found
