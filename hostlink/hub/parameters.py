"""The parameters that devices request, in the form that rosserial has for them."""

import contextlib
from collections import OrderedDict
from collections.abc import Mapping, Sequence

import structlog

from hostlink.config import ParameterValue
from hostlink.errors import HostlinkError, WrongType
from hostlink.hub.topic_graph import resolve
from hostlink.link.link import Link
from hostlink.logs import printable
from hostlink.protocol.control import Parameter

log = structlog.get_logger()

MAX_UNKNOWN_NAMES = 256  # that are remembered; a name can be as long as a frame

_INT_MIN, _INT_MAX = -(2**31), 2**31 - 1


class ParameterAnswers:
    """Answers every request: a device spins until it receives something."""

    def __init__(self, settings: Mapping[str, ParameterValue]) -> None:
        """`settings` may change at any time."""
        self._settings = settings
        self._unknown: OrderedDict[str, None] = OrderedDict()  # names that were logged, the latest last

    def answer(self, link: Link, name: str, shown: str) -> None:
        """Answer with the parameter; an empty one where there is none. `shown`: the name under the robot's."""
        parameter = None
        try:
            parameter = self._find(name, shown)
            link.session.answer_parameter(name, parameter or Parameter())
        except HostlinkError as error:
            log.warning("parameter.refused", name=printable(name), reason=str(error))
            with contextlib.suppress(HostlinkError):  # the queue is full of answers: the device receives one of those
                link.session.answer_parameter(name, Parameter())
        if parameter is None:
            self._note_unknown(name)

    def _find(self, name: str, shown: str) -> Parameter | None:
        """That of the robot's name here precedes that of the name which all of its kind announce."""
        own = find_parameter(self._settings, shown)
        is_renamed = shown != resolve(name)
        return find_parameter(self._settings, name) if own is None and is_renamed else own

    def _note_unknown(self, name: str) -> None:
        """Log it once, while it is remembered."""
        if name not in self._unknown:
            log.warning("parameter.unknown", name=printable(name))
        self._unknown[name] = None
        self._unknown.move_to_end(name)
        if len(self._unknown) > MAX_UNKNOWN_NAMES:
            self._unknown.popitem(last=False)


def find_parameter(parameters: Mapping[str, ParameterValue], name: str) -> Parameter | None:
    """The parameter of that name, with or without its leading `/` or `~`; None if there is none.

    Raises:
        WrongType: it cannot be sent.
    """
    wanted = name.lstrip("/~")
    value = next((value for key, value in parameters.items() if key.lstrip("/~") == wanted), None)
    return None if value is None else to_parameter(name, value)


def to_parameter(name: str, value: ParameterValue) -> Parameter:
    """A setting as ints, floats or strings; a list must be of one kind, ints among floats are floats.

    Raises:
        WrongType: it has strings among numbers, or an int over 32 bits.
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
