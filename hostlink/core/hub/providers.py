"""RobotProvider: interface of a component to robots of other hosts. Providers reaches all of them."""

import asyncio
import contextlib
from abc import ABC, abstractmethod
from collections.abc import Awaitable, Callable, Hashable, Iterator

from hostlink.core.robot.admission import Command
from hostlink.core.robot.command_endpoint import CommandEndpoint
from hostlink.core.robot.velocity import PlanarVelocity
from hostlink.errors import DeviceGone, HostlinkError

SETTLE_TIMEOUT_S = 2.0  # for the answers to a stop; the zeros of robots here were sent before


class ProvidedRobot(ABC):
    """Robot of another host, as its provider knows it."""

    name: str
    host: str  # as users see it
    place: Hashable  # identifies the host: names may repeat

    @abstractmethod
    def note_answer(self, owner: Hashable, epoch: int | None, *, is_refused: bool) -> None:
        """Note its host's answer to a command of a source. A refused source keeps the robot from no driver here."""


class RobotProvider(ABC):
    """Robots of other hosts, which are other daemons or programs, as a component reaches them.

    Methods that are not coroutines do not wait. Only those that say so raise errors. Another exception, of any method,
    ends the run of the component. Until its next run, `stop`, `lock`, `unlock_all` and `settled` are still called: what
    they were asked can be kept for that run (`Host.kept`).
    """

    @abstractmethod
    def drive(self, robot: ProvidedRobot, command: Command[PlanarVelocity]) -> None:
        """Send a command, which lasts for a lease from its `received_s` on. Its `epoch` is that of the robot's host.

        Raises:
            HostlinkError: the robot's host is not reached, or has refused the previous command of this source.
        """

    @abstractmethod
    def answer(self, robot: ProvidedRobot, owner: Hashable) -> Awaitable[PlanarVelocity]:
        """Return the later answer to the newest command of a source until now: the velocity after the limits.

        Raises (when it is awaited):
            HostlinkError: the command was refused, or not answered in time.
        """

    @abstractmethod
    def release(self, owner: Hashable) -> None:
        """Stop what a source drives, because it has left."""

    @abstractmethod
    def stop(self, name: str | None) -> None:
        """Stop every robot of this name; None: every robot and board, also those that are not announced here."""

    @abstractmethod
    def lock(self, name: str | None, reason: str) -> None:
        """Stop every robot of this name and refuse commands until it is unlocked; None: as for `stop`."""

    @abstractmethod
    def unlock(self, robot: ProvidedRobot) -> None:
        """Admit commands of a robot again.

        Raises:
            DeviceGone: its host is not reached.
        """

    @abstractmethod
    def unlock_all(self) -> None:
        """Admit commands of boards again, and of robots that are not announced here."""

    @abstractmethod
    async def settled(self) -> list[CommandEndpoint]:
        """Wait until the stops, locks and unlocks so far are answered, for a second at most.

        Return the endpoints there that command a motion and are not a robot's.

        Raises:
            DeviceGone: one was not answered, or was refused. The error names the host.
        """


class Provision:
    """One provider, and its failure: nothing is reached by it from then on, and its component ends.

    `has_ended`: the run has ended, and the next one has not begun. An order is an error for who gives it.
    """

    def __init__(self, provider: RobotProvider, name: str, on_failure: Callable[[Exception], None]) -> None:
        """`name` is that of its component, for texts. `on_failure` is called once."""
        self.name = name
        self.has_ended = False
        self._provider, self._on_failure = provider, on_failure
        self._failure = ""

    def drive(self, robot: ProvidedRobot, command: Command[PlanarVelocity]) -> None:
        """Send a command; as `RobotProvider.drive`.

        Raises:
            DeviceGone: the provider has failed.
        """
        with self._guarded():
            self._provider.drive(robot, command)

    def answer(self, robot: ProvidedRobot, owner: Hashable) -> Awaitable[PlanarVelocity]:
        """Return the later answer; as `RobotProvider.answer`.

        Raises:
            DeviceGone: the provider has failed.
        """
        with self._guarded():
            return self._answered(self._provider.answer(robot, owner))

    async def _answered(self, answer: Awaitable[PlanarVelocity]) -> PlanarVelocity:
        with self._caught():
            return await answer

    def unlock(self, robot: ProvidedRobot) -> None:
        """Unlock a robot; as `RobotProvider.unlock`.

        Raises:
            DeviceGone: the provider has failed.
        """
        with self._guarded():
            self._provider.unlock(robot)

    def order(self, send: Callable[[RobotProvider], None]) -> None:
        """Send what is for all its robots. A failure is raised by `settled`."""
        try:
            send(self._provider)
        except Exception as error:  # noqa: BLE001 - robots here must be stopped, too
            self._fail(error)

    async def settled(self) -> list[CommandEndpoint]:
        """Wait for the answers; as `RobotProvider.settled`.

        Raises:
            DeviceGone: the provider has failed, or does not return in time.
        """
        with self._guarded():
            try:
                async with asyncio.timeout(SETTLE_TIMEOUT_S):
                    found = await self._provider.settled()
            except TimeoutError:
                raise DeviceGone(self.name, "it has not answered") from None
        self._check()
        if self.has_ended:
            raise DeviceGone(self.name, "the component has failed, and does not run yet; its robots are not reached")
        return found

    @contextlib.contextmanager
    def _guarded(self) -> Iterator[None]:
        """Call the provider in a block, unless it has failed."""
        self._check()
        with self._caught():
            yield

    @contextlib.contextmanager
    def _caught(self) -> Iterator[None]:
        """Take an exception of a block for a failure of the provider, except for a HostlinkError."""
        try:
            yield
        except HostlinkError:
            raise
        except Exception as error:
            raise self._fail(error) from error

    def _check(self) -> None:
        if self._failure:
            raise DeviceGone(self.name, self._failure)

    def _fail(self, error: Exception) -> DeviceGone:
        if not self._failure:
            self._failure = f"the component has failed: {error!r}"
            self._on_failure(error)
        return DeviceGone(self.name, self._failure)


class Providers:
    """Providers of all components. No method but `settled` raises: what is here is stopped in any case."""

    def __init__(self) -> None:
        self._all: dict[Provision, None] = {}

    def add(self, provision: Provision) -> None:
        """Reach a provider from now on. It replaces one of an earlier run of its component."""
        for each in [each for each in self._all if each.has_ended and each.name == provision.name]:
            self.remove(each)
        self._all[provision] = None

    def remove(self, provision: Provision) -> None:
        """Reach a provider no longer. Do nothing if it was removed."""
        self._all.pop(provision, None)

    def release(self, owner: Hashable) -> None:
        """Report that a source of commands has left."""
        for each in tuple(self._all):
            if not each.has_ended:
                each.order(lambda provider: provider.release(owner))

    def stop(self, name: str | None) -> None:
        """Stop the robots of this name; None: every robot and board."""
        for each in tuple(self._all):
            each.order(lambda provider: provider.stop(name))

    def lock(self, name: str | None, reason: str) -> None:
        """Lock the robots of this name; None: every robot and board."""
        for each in tuple(self._all):
            each.order(lambda provider: provider.lock(name, reason))

    def unlock_all(self) -> None:
        """Unlock boards, and robots that are not announced here."""
        for each in tuple(self._all):
            each.order(lambda provider: provider.unlock_all())

    async def settled(self) -> list[CommandEndpoint]:
        """Wait until all providers have answered the stops, locks and unlocks so far.

        Return their endpoints that command a motion and are not a robot's.

        Raises:
            DeviceGone: one of them has not answered, or has failed; all others have been waited for.
        """
        found, refusal = list[CommandEndpoint](), None
        for each in tuple(self._all):
            try:
                found += await each.settled()
            except HostlinkError as error:
                refusal = error
        if refusal is not None:
            raise refusal
        return found
