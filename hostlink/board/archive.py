"""A ZIP whose bytes depend on nothing but the files in it. Pure."""

import io
import zipfile
from collections.abc import Mapping
from typing import Final

TIME: Final = (1980, 1, 1, 0, 0, 0)  # the first that a ZIP knows
_PLAIN_FILE: Final = 0o100644 << 16
_UNIX: Final = 3


def pack(files: Mapping[str, bytes]) -> bytes:
    """The ZIP of these files, by their paths in it."""
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for path in sorted(files):
            entry = zipfile.ZipInfo(path, TIME)
            entry.create_system, entry.external_attr = _UNIX, _PLAIN_FILE
            entry.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(entry, files[path])
    return packed.getvalue()
