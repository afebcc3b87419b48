"""Folders for data that must survive the daemon's process, on a tmpfs and named after user and process.

A tmpfs does not wear out SD cards, and a restart of the computer clears it. Imports little of the standard library.
"""

import os

PLACE = "/dev/shm"  # noqa: S108 - a tmpfs on every Linux; folders there belong to their user alone
_PREFIX = "hostlink-"
_PARTS = 5
_NICE = 19
PENDING = "incident-"  # prefix of the names of facts about incidents
SALVAGE = (  # program that saves the incidents; arguments: the folder of hostlink, and the process id
    "import sys; sys.path.append(sys.argv[1]); "
    "from hostlink.core.runtime.remains import yield_to_others; yield_to_others(); "
    "from hostlink.components.recorder.salvage import main; main(int(sys.argv[2]))"
)


def prefix_of(purpose: str) -> str:
    """Return the prefix of the names of this process's folders. `purpose`: letters and digits."""
    return f"{_PREFIX}{os.geteuid()}-{purpose}-{os.getpid()}-"


def of_purpose(purpose: str) -> list[str]:
    """Return the folders for a purpose, of ended and running processes of this user."""
    return _folders(purpose=purpose)


def of_process(pid: int) -> list[str]:
    """Return the folders of one process of this user."""
    return _folders(pid=pid)


def of_user() -> list[str]:
    """Return all folders of this user."""
    return _folders()


def yield_to_others() -> None:
    """Lower this process's priority below that of the robots' daemon, also with autogroup scheduling."""
    try:
        os.nice(_NICE)
        with open("/proc/self/autogroup", "w") as file:  # noqa: PTH123
            file.write(str(_NICE))
    except OSError:
        return  # this system has no such shares, or systemd's sandbox forbids it


def remove_empty(pid: int) -> None:
    """Remove folders of an ended process without pending incidents. Call it only if no robot was driven."""
    for path in of_process(pid):
        try:
            names = os.listdir(path)  # noqa: PTH208 - pathlib is a large import
            if not any(name.startswith(PENDING) for name in names):
                for name in names:
                    os.unlink(f"{path}/{name}")  # noqa: PTH108
                os.rmdir(path)  # noqa: PTH106
        except OSError:
            continue  # another process is using it


def _folders(*, purpose: str | None = None, pid: int | None = None) -> list[str]:
    """Return folders named hostlink-USER-PURPOSE-PID-RANDOM. Another user's folder of that name is ignored."""
    try:
        names = os.listdir(PLACE)  # noqa: PTH208 - pathlib is not small
    except OSError:
        return []
    found = []
    prefix = f"{_PREFIX}{os.geteuid()}-"
    for name in sorted(each for each in names if each.startswith(prefix)):
        parts = name.split("-")
        if len(parts) != _PARTS:
            continue
        is_wanted = purpose in (None, parts[2]) and (pid is None or parts[3] == str(pid))
        if is_wanted and _is_own(f"{PLACE}/{name}"):
            found.append(f"{PLACE}/{name}")
    return found


def _is_own(path: str) -> bool:
    try:
        return os.lstat(path).st_uid == os.geteuid()
    except OSError:
        return False
