"""The emergency stop as services, so that programs and devices can call it: <robot>/lock and <robot>/unlock."""

from collections.abc import Mapping

from hostlink.hub.robots import LOCK_REASON, Robot, Robots
from hostlink.hub.services import Provider, Services
from hostlink.hub.topic_graph import DAEMON, resolve

_TYPE = "std_srvs/Trigger"
_LOCK, _UNLOCK = "lock", "unlock"


def offer_lock(robots: Robots, services: Services, robot: Robot) -> None:
    """From now on the robot can be locked and unlocked by a call; nobody else may offer services of these names."""
    name = robot.name

    async def lock(_: Mapping[str, object]) -> Mapping[str, object]:
        robots.lock(robot, LOCK_REASON)
        return {"success": True, "message": f"{name} is locked until {name}/{_UNLOCK} is called"}

    async def unlock(_: Mapping[str, object]) -> Mapping[str, object]:
        robots.unlock(robot)
        return {"success": True, "message": f"{name} may be driven"}

    for service, answer in ((_LOCK, lock), (_UNLOCK, unlock)):
        services.provide(Provider(resolve(f"{name}/{service}"), _TYPE, DAEMON, answer))


def withdraw_lock(services: Services, robot: Robot) -> None:
    """The robot is forgotten."""
    for service in (_LOCK, _UNLOCK):
        services.withdraw(f"{robot.name}/{service}", DAEMON)
