"""Drivers of tests go on after a pause of the daemon, and after no other refusal."""

import asyncio
from typing import Any, cast

import pytest

from hostlink.core.robot.admission import LEASE_S
from hostlink.errors import CommandRefused, RefusalKind
from tests.support.driving import COMMAND_INTERVAL_S, REFUSED, answered, driven
from tests.support.participants import ROBOT, Scene, play
from tests.support.virtual_loop import VirtualLoop, inside, run_virtual

STALL_S = 0.54  # of a virtual machine


def burn(seconds: float) -> None:
    cast("VirtualLoop", asyncio.get_running_loop()).burn(seconds)


@pytest.mark.parametrize("phase_s", [0.01, 0.05, 0.09])
@inside(play)
async def test_driver_drives_again_after_a_pause(scene: Scene, phase_s: float) -> None:
    async with driven(scene.hub, ROBOT, 0.2) as driver:
        await asyncio.sleep(10 * COMMAND_INTERVAL_S + phase_s)
        assert (scene.speeds()[-1], driver.is_steady) == (0.2, True)
        burn(STALL_S)
        await asyncio.sleep(0.05)
        assert scene.speeds()[-1] == 0.0
        await asyncio.sleep(1.5)
        assert (scene.speeds()[-1], driver.is_steady) == (0.2, False)
    await asyncio.sleep(0.05)
    assert scene.speeds()[-1] == 0.0


@pytest.mark.parametrize("is_paused", [False, True])
@pytest.mark.parametrize(("how", "kind"), [("stop", RefusalKind.DISARMED), ("lock", RefusalKind.LOCKED)])
@inside(play)
async def test_driver_ends_the_test_after_another_refusal(
    scene: Scene, how: str, kind: RefusalKind, is_paused: bool
) -> None:
    async def drive() -> None:
        async with driven(scene.hub, ROBOT, 0.2):
            await asyncio.sleep(0.3)
            burn(STALL_S if is_paused else 0.0)
            await asyncio.sleep(1.5)
            getattr(scene.hub.robots.find(ROBOT), how)()
            await asyncio.sleep(60)

    with pytest.raises(ExceptionGroup) as ended:
        await drive()
    (refused,) = ended.value.exceptions
    assert isinstance(refused, CommandRefused)
    assert refused.kind is kind


LATE, DISARMED, HELD = RefusalKind.LATE, RefusalKind.DISARMED, RefusalKind.HELD


@pytest.mark.parametrize(
    ("kinds", "returned", "waited_s"),
    [
        ((), None, 0.0),
        ((LATE, LATE, DISARMED), None, LEASE_S),
        ((DISARMED,), DISARMED, 0.0),
        ((LATE, HELD), HELD, 0.0),
    ],
)
def test_command_over_rest_is_repeated_after_a_late_one(
    kinds: tuple[RefusalKind, ...], returned: RefusalKind | None, waited_s: float
) -> None:
    answers = [(REFUSED, {"error": {"kind": str(kind)}}) for kind in kinds] + [(200, {})]

    async def send() -> tuple[int, Any]:
        return answers.pop(0)

    async def run() -> tuple[int, Any, float]:
        return *await answered(send), asyncio.get_running_loop().time()

    status, answer, seconds = run_virtual(run())
    assert (status, seconds) == (200 if returned is None else REFUSED, pytest.approx(waited_s))
    assert answer == ({} if returned is None else {"error": {"kind": returned}})
