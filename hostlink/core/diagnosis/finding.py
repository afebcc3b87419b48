"""Finding: one detected fault, with the texts that log, API, page and documents use."""

import functools
import tomllib
from dataclasses import dataclass
from importlib.resources import files


@dataclass(frozen=True, slots=True)
class Finding:
    """One detected fault. `code` is for programs; `detail` has the numbers and names of this case and may be empty."""

    code: str
    cause: str
    next_step: str
    detail: str = ""


@functools.cache
def words() -> dict[str, dict[str, str]]:
    """Texts of findings.toml: code -> symptom, cause, next_step, in the order of the findings."""
    return tomllib.loads((files("hostlink.core.diagnosis") / "findings.toml").read_text())


def finding(code: str, detail: str = "") -> Finding:
    """Build the finding of a code."""
    found = words()[code]
    return Finding(code, found["cause"], found["next_step"], detail)
