"""The quick reference names commands and REST calls that exist."""

import json
import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
DOCUMENT = "docs/quick-reference.md"
OPENAPI = ROOT / "tests" / "integration" / "openapi.json"  # a test holds it to what the daemon answers
CALL = re.compile(r"`(GET|PUT|POST|DELETE) (/[^`?]*)`")
LONGEST = 110  # lines


def calls(text: str) -> set[tuple[str, str]]:
    return set(CALL.findall(text))


def test_every_rest_call_of_the_quick_reference_is_in_the_openapi_document() -> None:
    paths = json.loads(OPENAPI.read_text())["paths"]
    known = {(method.upper(), path) for path, methods in paths.items() for method in methods}
    named = calls((ROOT / DOCUMENT).read_text())
    assert len(named) > 20
    assert named - known == set()


def test_quick_reference_is_short() -> None:
    assert len((ROOT / DOCUMENT).read_text().splitlines()) <= LONGEST


def test_rest_calls_are_found() -> None:
    assert calls("| `GET /api/robots`, `POST /api/stop` | `echo` |") == {("GET", "/api/robots"), ("POST", "/api/stop")}
