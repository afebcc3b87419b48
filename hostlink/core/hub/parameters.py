"""Answers to parameter requests of devices."""

import contextlib
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

import structlog

from hostlink.core.config import ParameterValue
from hostlink.core.hub.isolation import Spawn
from hostlink.core.hub.topic_graph import resolve
from hostlink.core.link.link import Link
from hostlink.core.protocol.events import Parameter
from hostlink.core.runtime.logs import printable
from hostlink.errors import HostlinkError, WrongType

log = structlog.get_logger()

MAX_WAITING = 64  # requests that wait for a source; further ones are answered at once as unknown
MAX_UNKNOWN_NAMES = 256  # logged names that are kept; a name can be as long as a frame

_INT_MIN, _INT_MAX = -(2**31), 2**31 - 1


class ParameterSource(Protocol):
    """Interface of another source of parameters, such as a ROS master."""

    async def get(self, name: str) -> ParameterValue | None:
        """Return the parameter, well within the second for which a device waits; None if it does not exist."""
        ...


class ParameterAnswers:
    """Answers to parameter requests. Every request is answered, because a device blocks until then."""

    def __init__(
        self,
        settings: Mapping[str, ParameterValue],
        source: Callable[[], ParameterSource | None] = lambda: None,
        spawn: Spawn | None = None,
    ) -> None:
        """`settings` may change at any time. `source` has further parameters, and `spawn` runs the requests to it."""
        self._settings = settings
        self._source, self._spawn = source, spawn
        self._waiting = 0  # requests that wait for the source
        self._unknown: OrderedDict[str, None] = OrderedDict()  # logged names, the latest last

    def answer(self, link: Link, name: str, shown: str, note: Callable[[Parameter], None] = lambda _: None) -> None:
        """Answer with the parameter, now or when the source has answered; with an empty one if it does not exist.

        `shown` is the name in the robot's namespace. `note` is called with the answer.
        """
        source = self._source()
        try:
            parameter = self._find(name, shown)
        except HostlinkError as error:
            self._refuse(link, name, error)
            return
        if parameter is None and source is not None and self._spawn is not None and self._waiting < MAX_WAITING:
            self._waiting += 1
            self._spawn(self._answer_from(source, link, name, note), name=f"parameter of link {link.number}")
        else:
            self._answer(link, name, parameter, note)

    async def _answer_from(
        self, source: ParameterSource, link: Link, name: str, note: Callable[[Parameter], None]
    ) -> None:
        try:
            value = await source.get(name)
            self._answer(link, name, None if value is None else to_parameter(name, value), note)
        except HostlinkError as error:
            self._refuse(link, name, error)
        finally:
            self._waiting -= 1
            link.wake()

    def _answer(self, link: Link, name: str, parameter: Parameter | None, note: Callable[[Parameter], None]) -> None:
        if parameter is None:
            self._note_unknown(name)
        try:
            link.session.answer_parameter(name, parameter or Parameter())
        except HostlinkError as error:
            self._refuse(link, name, error)
        else:
            note(parameter or Parameter())

    def _refuse(self, link: Link, name: str, error: HostlinkError) -> None:
        log.warning("parameter.refused", name=printable(name), reason=str(error))
        with contextlib.suppress(HostlinkError):  # the queue is full of answers: the device receives one of those
            link.session.answer_parameter(name, Parameter())

    def _find(self, name: str, shown: str) -> Parameter | None:
        """Find a parameter in the robot's namespace first, then by the name that the device sent."""
        own = find_parameter(self._settings, shown)
        is_renamed = shown != resolve(name)
        return find_parameter(self._settings, name) if own is None and is_renamed else own

    def _note_unknown(self, name: str) -> None:
        """Log an unknown name once, while it is kept."""
        if name not in self._unknown:
            log.info("parameter.unknown", name=printable(name))
        self._unknown[name] = None
        self._unknown.move_to_end(name)
        if len(self._unknown) > MAX_UNKNOWN_NAMES:
            self._unknown.popitem(last=False)


def find_parameter(parameters: Mapping[str, ParameterValue], name: str) -> Parameter | None:
    """Find a parameter by name, with or without its leading `/` or `~`; None if it does not exist.

    Raises:
        WrongType: a device cannot take the value.
    """
    wanted = name.lstrip("/~")
    value = next((value for key, value in parameters.items() if key.lstrip("/~") == wanted), None)
    return None if value is None else to_parameter(name, value)


def to_parameter(name: str, value: ParameterValue) -> Parameter:
    """Convert a setting to ints, floats or strings. In a list with a float, all numbers become floats.

    Raises:
        WrongType: a list has strings among numbers, or an int exceeds 32 bits.
    """
    items: Sequence[bool | int | float | str] = value if isinstance(value, list) else [value]
    if all(isinstance(item, str) for item in items):
        return Parameter(strings=tuple(str(item) for item in items))
    if any(isinstance(item, str) for item in items):
        raise WrongType(f"parameter {name}", "a list of one kind", "strings among numbers")
    if any(isinstance(item, float) for item in items):
        return Parameter(floats=tuple(float(item) for item in items))
    ints = tuple(int(item) for item in items)
    if any(not _INT_MIN <= item <= _INT_MAX for item in ints):
        raise WrongType(f"parameter {name}", "int32", f"{ints}")
    return Parameter(ints=ints)
