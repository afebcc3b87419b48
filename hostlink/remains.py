"""Where a daemon keeps what must survive its process: a folder in memory (tmpfs), named after user and process.

No SD card wears out by it, and a restart of the computer clears it. The standard library only, and little of that.
"""

import os

PLACE = "/dev/shm"  # noqa: S108 - a tmpfs on every Linux; folders there belong to their user alone
_PREFIX = "hostlink-"
_PARTS = 5
_NICE = 19
PENDING = "incident-"  # what the names of facts about incidents begin with
SALVAGE = (  # what a Python with site-packages runs to make incidents of it: where hostlink is, and the process
    "import sys; sys.path.append(sys.argv[1]); from hostlink.remains import yield_to_others; yield_to_others(); "
    "from hostlink.recording.salvage import main; main(int(sys.argv[2]))"
)


def prefix_of(purpose: str) -> str:
    """What the names of this process's folders begin with. `purpose`: letters and digits."""
    return f"{_PREFIX}{os.geteuid()}-{purpose}-{os.getpid()}-"


def of_purpose(purpose: str) -> list[str]:
    """The folders that processes of this user have left for it, also processes that still run."""
    return _folders(purpose=purpose)


def of_process(pid: int) -> list[str]:
    """The folders of one process of this user."""
    return _folders(pid=pid)


def of_user() -> list[str]:
    """All of this user."""
    return _folders()


def yield_to_others() -> None:
    """Let the robots and the next daemon have the processor first, also where each session has a share of it."""
    try:
        os.nice(_NICE)
        with open("/proc/self/autogroup", "w") as file:  # noqa: PTH123
            file.write(str(_NICE))
    except OSError:
        return  # this system has no such shares, or systemd's sandbox forbids it


def remove_empty(pid: int) -> None:
    """Remove the folders of a process that is gone in which no incident is pending; nobody was driving, either."""
    for path in of_process(pid):
        try:
            names = os.listdir(path)  # noqa: PTH208 - pathlib is not small
            if not any(name.startswith(PENDING) for name in names):
                for name in names:
                    os.unlink(f"{path}/{name}")  # noqa: PTH108
                os.rmdir(path)  # noqa: PTH106
        except OSError:
            continue  # somebody else is at it


def _folders(*, purpose: str | None = None, pid: int | None = None) -> list[str]:
    """hostlink-USER-PURPOSE-PID-RANDOM; one that belongs to somebody else is a trap."""
    try:
        names = os.listdir(PLACE)  # noqa: PTH208 - pathlib is not small
    except OSError:
        return []
    found = []
    for name in sorted(names):
        parts = name.split("-")
        if len(parts) != _PARTS or not name.startswith(f"{_PREFIX}{os.geteuid()}-"):
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
