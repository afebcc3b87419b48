"""Files that are written whole or not at all, also when the power fails meanwhile."""

import os
from pathlib import Path

PART = ".part"  # suffix of what is not yet whole


def replace_file(path: Path, data: bytes) -> None:
    """Write a file whole, in place of an older one. After an error the older one is unchanged.

    Raises:
        OSError: it cannot be written.
    """
    part = path.with_name(path.name + PART)
    try:
        part.write_bytes(data)
        put_in_place(part, path)
    except BaseException:
        part.unlink(missing_ok=True)
        raise


def put_in_place(part: Path, path: Path) -> None:
    """Rename a file that is written. Its content is on the disk before the name is, or a power failure leaves it empty.

    Raises:
        OSError: it cannot be synced or renamed.
    """
    _sync(part)
    part.replace(path)
    _sync(path.parent)


def _sync(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
