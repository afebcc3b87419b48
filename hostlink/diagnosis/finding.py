"""Finding: one thing that is wrong, in the words that every part of hostlink uses for it."""

import functools
import tomllib
from dataclasses import dataclass
from importlib.resources import files


@dataclass(frozen=True, slots=True)
class Finding:
    """`code` names it for programs; `detail` has the numbers and names of this case, and may be empty."""

    code: str
    cause: str
    next_step: str
    detail: str = ""


@functools.cache
def words() -> dict[str, dict[str, str]]:
    """findings.toml: code -> symptom, cause, next_step; in the order in which findings are told."""
    return tomllib.loads((files("hostlink.diagnosis") / "findings.toml").read_text())


def finding(code: str, detail: str = "") -> Finding:
    """The finding of that code."""
    said = words()[code]
    return Finding(code, said["cause"], said["next_step"], detail)
