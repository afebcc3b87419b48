"""WorldParameters: what a robot and its floor are like, by name."""

import contextlib
import re
from collections.abc import Iterator, Mapping
from difflib import get_close_matches
from typing import Self

from hostlink.sim.firmware_module import bounds, read_lines

_LINE_END = re.compile(r"\r\n|\r|\n")


class WorldParameters(Mapping[str, float]):
    """Every number of a world: `world["track_m"]`, `world["left.radius_m"]`.

    firmware/host/world_parameters.h has their names, units, defaults and sources. Names and ranges are checked when the
    numbers are first used: a world may be written down without wasmtime.
    """

    __slots__ = ("_given",)

    def __init__(self, given: Mapping[str, float] | None = None) -> None:
        """`given`: what is not as in a robot without a flaw."""
        self._given = {name: float(value) for name, value in (given or {}).items()}

    def changed(self, values: Mapping[str, float]) -> Self:
        """The same world with other numbers."""
        return type(self)({**self._given, **values})

    def checked_values(self) -> list[float]:
        """All numbers, in the order of the C++ struct.

        Raises:
            ConfigError: wasmtime is not installed, or has no library for this machine.
            ValueError: a name is no parameter's, then the text names the nearest one; or a number is out of its range.
        """
        for name, value in self._given.items():
            complaint = _complaint(name, value)
            if complaint is not None:
                raise ValueError(complaint)
        return [self._given.get(name, known.default) for name, known in bounds().items()]

    def text(self) -> str:
        """Lines `name=value`, as the boards on the PC and the emulated one read them; those that are given."""
        return "".join(f"{name}={value!r}\n" for name, value in self._given.items())

    def __getitem__(self, name: str) -> float:
        return self._given[name] if name in self._given else bounds()[name].default

    def __iter__(self) -> Iterator[str]:
        return iter(bounds())

    def __len__(self) -> int:
        return len(bounds())

    def __eq__(self, other: object) -> bool:
        return isinstance(other, WorldParameters) and self._given == other._given

    def __hash__(self) -> int:
        return hash(frozenset(self._given.items()))

    def __repr__(self) -> str:
        return f"WorldParameters({self._given})"


def wheel(side: str, **numbers: float) -> dict[str, float]:
    """A wheel's numbers by their full names: `wheel("left", radius_m=0.0448)`."""
    return {f"{side}.{name}": value for name, value in numbers.items()}


def read(text: str) -> WorldParameters:
    """A world from lines `name=value`, without spaces; empty lines and those that begin with # are ignored.

    Raises:
        ConfigError: wasmtime is not installed, or has no library for this machine.
        ValueError: a line is not of this form, names no parameter, or is out of range; the text has its number.
    """
    text = text.replace("\0", "\ufffd")  # it would end the text in C++
    wrong, values = read_lines(text)
    if not wrong:
        return WorldParameters({name: value for name, value in values.items() if value != bounds()[name].default})
    line = _LINE_END.split(text)[wrong - 1]
    name, _, value = line.partition("=")
    reason = f"{line!r} is not of the form name=number"
    with contextlib.suppress(ValueError):
        reason = _complaint(name, float(value)) or reason
    raise ValueError(f"line {wrong}: {reason}")


def _complaint(name: str, value: float) -> str | None:
    """What is wrong with a number, if anything."""
    known = bounds()
    if name not in known:
        near = get_close_matches(name, known, n=1)
        return f"{name}: no such parameter" + (f"; meant {near[0]}?" if near else "")
    _, low, high = known[name]
    return None if low <= value <= high else f"{name}: {value:g} is not in {low:g}..{high:g}"
