"""Writes the page on which the firmware drives in the browser: docs/try.html with the module in it, for `make docs`.

A page that was opened from a file may not fetch the module from the same folder, so the module is in the page, in
base64.
"""

import base64
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "docs" / "try.html"
MODULE = ROOT / "hostlink" / "workbench" / "sim" / "firmware.wasm"
_PLACE = '<script id="module" type="text/plain">'


def write(file: Path) -> None:
    """Write the page."""
    before, place, after = SOURCE.read_text(encoding="utf-8").partition(_PLACE)
    module = base64.b64encode(MODULE.read_bytes()).decode()
    file.write_text(f"{before}{place}{module}{after}", encoding="utf-8")
