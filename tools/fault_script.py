"""The language of faults: lines that a person can type, on the command line or in a file, to a `Script`.

    delay 50±20ms          # everything arrives so much later, in order
    split 1-7              # in pieces of 1 to 7 bytes
    merge 40ms             # pieces within this time arrive as one
    rate 3840              # bytes a second
    at 10 cut              # once, seconds from the start
    every 120 lose 1s      # again and again; `every 30±5 ...` is never quite on time
    every 2 damage 3 from-device
    for 10min              # then the relay ends
    seed 7

Faults: lose [TIME], blackout [TIME], reboot [TIME], drop [BYTES], damage [BYTES], duplicate [BYTES], cut, close,
half-open; at the end of a line to-device or from-device. Times are seconds, or end in ms, s, min or h.
"""

import dataclasses
import re
from collections.abc import Iterable

from tools.faults import AMOUNTS, OF_BYTES, Direction, Habits, Kind, Rule, Script, Span

_NUMBER = re.compile(r"(\d+(?:\.\d+)?)(?:(±|\+-|-)(\d+(?:\.\d+)?))?(ms|s|min|h)?")
_SECONDS = {None: 1.0, "ms": 0.001, "s": 1.0, "min": 60.0, "h": 3600.0}
LEAST_INTERVAL_S = 0.001


class BadScript(ValueError):
    """A line that means nothing; the text names what is known."""


def parse(lines: Iterable[str]) -> Script:
    """A script from its lines; what follows a # is for people."""
    script = Script()
    for line in lines:
        words = line.split("#")[0].split()
        if words:
            script = _with_line(script, words)
    return script


def _with_line(script: Script, words: list[str]) -> Script:
    name, *rest = words
    if name in ("at", "every"):
        return dataclasses.replace(script, rules=(*script.rules, _rule(rest, repeats=name == "every", line=words)))
    if len(rest) != 1:
        raise BadScript(f"{' '.join(words)}: one value after {name}")
    value = rest[0]
    if name == "seed" and value.isdecimal():
        return dataclasses.replace(script, seed=int(value))
    if name == "for":
        return dataclasses.replace(script, length_s=_span(value).high)
    return dataclasses.replace(script, habits=_with_habit(script.habits, name, value))


def _with_habit(habits: Habits, name: str, value: str) -> Habits:
    if name == "split":
        span = _span(value, is_time=False)
        if span.low < 1:
            raise BadScript(f"split {value}: a piece has at least one byte")
        return dataclasses.replace(habits, split_bytes=span)
    if name == "delay":
        return dataclasses.replace(habits, delay_s=_span(value))
    if name == "merge":
        return dataclasses.replace(habits, merge_s=_span(value).high)
    if name == "rate":
        rate = _span(value, is_time=False).high
        if rate <= 0:
            raise BadScript(f"rate {value}: bytes a second, more than none")
        return dataclasses.replace(habits, rate_bytes_s=rate)
    raise BadScript(f"{name} {value}: known are at, every, split, merge, delay, rate, for and seed (a whole number)")


def _rule(words: list[str], *, repeats: bool, line: list[str]) -> Rule:
    direction = next((way for way in Direction if words and words[-1] == way.value), None)
    if direction is not None:
        words = words[:-1]
    if len(words) not in (2, 3):
        raise BadScript(f"{' '.join(line)}: a time, a fault and perhaps a number")
    at_s = _span(words[0])
    if repeats and at_s.low < LEAST_INTERVAL_S:
        raise BadScript(f"{' '.join(line)}: too often")
    kind = next((kind for kind in Kind if kind.value == words[1]), None)
    if kind is None:
        raise BadScript(f"no fault {words[1]}; known: {', '.join(kind.value for kind in Kind)}")
    if direction is not None and kind not in (*OF_BYTES, Kind.LOSE):
        raise BadScript(f"{kind.value} has no direction")
    if kind not in AMOUNTS and len(words) > 2:
        raise BadScript(f"{kind.value} takes no number")
    amount = _span(words[2], is_time=kind not in OF_BYTES) if len(words) > 2 else AMOUNTS.get(kind, Span(0, 0))
    return Rule(at_s, repeats, kind, amount, direction)


def _span(text: str, *, is_time: bool = True) -> Span:
    """`5`, `50ms`, `50±20ms`, `1-7`."""
    found = _NUMBER.fullmatch(text)
    if found is None or (found[4] and not is_time):
        raise BadScript(f"{text}: a number like 5, 1-7 or 50±20{', in s, ms, min or h' if is_time else ''}")
    first, sign, second = float(found[1]), found[2], float(found[3] or 0)
    low, high = (first, first) if sign is None else (first, second) if sign == "-" else (first - second, first + second)
    if low > high:
        raise BadScript(f"{text}: the smaller number first")
    unit = _SECONDS[found[4]] if is_time else 1.0
    return Span(max(0.0, low * unit), high * unit)
