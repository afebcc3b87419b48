"""Views: what the API shows of the host. These types are the OpenAPI document. Numbers carry their unit."""

import asyncio
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from typing import TypedDict, TypeVar

import msgspec

from hostlink.core.host import Devices, RobotHandle, Turns
from hostlink.core.robot.state_views import velocity_view
from hostlink.core.robot.velocity import PlanarVelocity
from hostlink.core.robot.views import VelocityView
from hostlink.core.runtime.units import NS_PER_S

View = TypeVar("View")

SLICE_S = 0.0002  # of one turn of the event loop: eight robots, or one link with very many topics


class Slices:
    """Spreads the work of one encoder over turns of the event loop. `spent_s`: CPU time of its work."""

    def __init__(self, turns: Turns) -> None:
        self.spent_s = 0.0
        self._turns = turns

    async def run(self, views: Iterator[View], work: Callable[[View], None]) -> None:
        """Do the work for each view, as many in a turn as fill SLICE_S."""
        now_s = asyncio.get_running_loop().time
        is_done = False

        def work_on_some() -> None:
            nonlocal is_done
            began_s = now_s()
            for view in views:
                work(view)
                if now_s() - began_s >= SLICE_S:
                    break
            else:
                is_done = True
            self.spent_s += now_s() - began_s

        while not is_done:
            await self._turns.run(work_on_some, is_flooding=True)


class VelocityAnswer(TypedDict):
    """The velocity after the limits, and its lease.

    limited_by: the setting of the robot that reduces it most; null: none does, or another daemon has the robot.
    """

    velocity: VelocityView
    is_limited: bool
    limited_by: str | None
    lease_s: float
    epoch: int  # commands with it are newer than the last interruption


def utc_text(stamp_ns: int) -> str:
    """Format a wall time: `2026-11-22T07:43:29.123+00:00`."""
    return datetime.fromtimestamp(stamp_ns / NS_PER_S, UTC).isoformat(timespec="milliseconds")


def velocity_answer(robot: RobotHandle, requested: PlanarVelocity, limited: PlanarVelocity) -> VelocityAnswer:
    """Return the velocity after the limits, with what reduced it."""
    return {
        "velocity": velocity_view(limited),
        "is_limited": limited != requested,
        "limited_by": None if limited == requested else robot.limited_by(requested),
        "lease_s": robot.lease_s,
        "epoch": robot.epoch,
    }


async def links_view(devices: Devices, slices: Slices) -> dict[str, object]:
    """Return a LinksView, ready to be encoded. It is made in slices: topics of many devices are megabytes of JSON."""
    links: list[msgspec.Raw] = []
    await slices.run(devices.links(), lambda view: links.append(msgspec.Raw(msgspec.json.encode(view))))
    return {"links": links, **devices.other_links()}
