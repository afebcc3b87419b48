"""Finding: one thing that is wrong, in the words of log, API, page and documents."""

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
    """findings.toml: code -> symptom, cause, next_step; in the order of the findings."""
    return tomllib.loads((files("hostlink.diagnosis") / "findings.toml").read_text())


def finding(code: str, detail: str = "") -> Finding:
    """The finding of that code."""
    found = words()[code]
    return Finding(code, found["cause"], found["next_step"], detail)
