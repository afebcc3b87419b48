"""Which serial port a configuration means today: a port that comes back under another name is found again."""

import errno
import glob
from collections.abc import Iterable
from pathlib import Path

from serial.tools import list_ports

from hostlink.config import SerialConfig

BY_ID = Path("/dev/serial/by-id")


def find_port(config: SerialConfig) -> str:
    """The path to open.

    Raises:
        OSError: there is none, or more than one; its text names the ports that there are.
    """
    if config.usb_serial is not None:
        found = {port.device: port.serial_number for port in list_ports.comports() if port.serial_number}
        return choose_by_serial(config.usb_serial, found)
    pattern = config.path or ""
    paths = sorted(glob.glob(pattern)) if glob.has_magic(pattern) else [pattern]  # noqa: PTH207 - an absolute pattern
    if len(paths) > 1:
        raise OSError(errno.EINVAL, f"{pattern}: fits {len(paths)} ports: {_listed(paths)}; say which")
    if not paths or not Path(paths[0]).exists():
        known = sorted(str(path) for path in BY_ID.glob("*"))
        raise OSError(errno.ENOENT, f"{pattern}: no such port; there are: {_listed(known)}")
    return paths[0]


def choose_by_serial(wanted: str, found: dict[str, str]) -> str:
    """`found`: path -> serial number of its USB device. A device with two ports: its first."""
    paths = sorted(path for path, number in found.items() if number == wanted)
    if not paths:
        known = _listed(sorted(f"{number} ({path})" for path, number in found.items()))
        raise OSError(errno.ENOENT, f"{wanted}: no USB device with this serial number; there are: {known}")
    return paths[0]


def _listed(names: Iterable[str]) -> str:
    return ", ".join(names) or "none"
