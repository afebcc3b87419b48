"""Lengths and angles as people type them. Pure."""

import math
import re

from hostlink.errors import ConfigError

UNITS_M = {"cm": 0.01, "mm": 0.001, "m": 1.0, "in": 0.0254}
_LENGTH = re.compile(r"\s*([-+]?[\d.,]+(?:e[-+]?\d+)?)\s*([a-z\"]*)\s*", re.IGNORECASE)
_EXAMPLE = "12.5 cm, 125 mm, 0.125 m or 4.92 in"
UNITS_RAD = {"deg": math.pi / 180, "°": math.pi / 180, "rad": 1.0, "turn": math.tau}
_ANGLE = re.compile(r"\s*([-+]?(?:\d+[.,]?\d*|[.,]\d+))\s*([a-z°]*)\s*", re.IGNORECASE)
_LONGER = {"degrees": "deg", "degree": "deg", "radians": "rad", "turns": "turn"}


class UnitMissing(ValueError):
    """A length was entered without its unit."""

    def __init__(self, number: str) -> None:
        self.number = number
        super().__init__(f"{number} has no unit; enter for example {_EXAMPLE}")


def parse_length(text: str, default: str = "") -> float:
    """Return the metres of `12,5 cm`, `-3 mm`, `3.012 m` or `5 in`. A bare number has the `default` unit.

    Raises:
        UnitMissing: a bare number was entered, and no default is given.
        ValueError: the text is not a length; the error has an example.
    """
    wanted = f"length; enter {_EXAMPLE}"
    found = _LENGTH.fullmatch(text)
    unit = "" if found is None else found[2].lower().replace('"', "in") or default
    if found is None or (unit and unit not in UNITS_M):
        raise ValueError(f"{text.strip()!r} is not a {wanted}")
    number = _number(found[1].replace(",", "."), text, wanted)
    if number and not unit:
        raise UnitMissing(found[1])
    return number * UNITS_M.get(unit, 0.0)


def parse_angle(text: str) -> float:
    """Return the radians of an angle in degrees.

    Raises:
        ValueError: the text is not an angle; the error has an example.
    """
    word = text.strip().lower().replace(",", ".").removesuffix("degrees").removesuffix("°")
    return math.radians(_number(word, text, "number of degrees; enter for example -12.5"))


def _number(word: str, text: str, wanted: str) -> float:
    try:
        value = float(word)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ValueError(f"{text.strip()!r} is not a {wanted}")
    return value


def metres(text: str) -> float:
    """Return the metres of `1`, `0.3m`, `-25 cm` or `120mm`.

    Raises:
        ConfigError: the text is not a length.
    """
    try:
        return parse_length(text, "m")
    except ValueError:
        reason = f"{text!r} is not a length; write it as 1 (metres), 0.3m, 25cm or -25cm for backwards"
        raise ConfigError("DISTANCE", reason) from None


def radians(text: str) -> float:
    """Return the radians of `90deg`, `-90°`, `1.57rad` or `1turn`. A bare number is refused: 90 rad are 14 turns.

    Raises:
        ConfigError: the text is not an angle with its unit.
    """
    found = _ANGLE.fullmatch(text)
    unit = "" if found is None else _LONGER.get(found[2].lower(), found[2].lower())
    if found is not None and not unit:
        raise ConfigError("ANGLE", f"{text!r} has no unit; write it as {found[1]}deg or {found[1]}rad")
    if found is None or unit not in UNITS_RAD:
        raise ConfigError("ANGLE", f"{text!r} is not an angle; write it as 90deg, -90deg for clockwise, or 1.57rad")
    return float(found[1].replace(",", ".")) * UNITS_RAD[unit]
