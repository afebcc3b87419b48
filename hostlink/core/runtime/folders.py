"""Folders in which a daemon keeps its state. One daemon writes into a folder; another one is told which."""

import contextlib
import errno
import fcntl
import os
import threading
import time
from pathlib import Path

NAME = ".owner"  # locked by the daemon that owns the folder; its text says which. It stays when the daemon ends
_MAX_TEXT = 200
_TRIES = 3
_AGAIN_S = 0.02  # a program that asks for the owner holds the lock for an instant


def state_folder() -> Path:
    """Return the folder of what outlives the daemon: systemd's state directory for a service, otherwise that of XDG."""
    of_service = os.environ.get("STATE_DIRECTORY", "").partition(":")[0]
    state = Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state")
    return Path(of_service) if of_service else state / "hostlink"


class FolderTaken(OSError):
    """Another daemon owns the folder."""

    def __init__(self, folder: Path, owner: str) -> None:
        advice = "set another recording.folder for this daemon"
        super().__init__(errno.EBUSY, f"{folder} belongs to {owner or 'another daemon'}; {advice}")


class FolderOwner:
    """Claim of a daemon on its folder. It ends with the process, however that ends."""

    def __init__(self, folder: Path, name: str) -> None:
        """`name`: of this daemon, for other daemons that want the folder."""
        self._folder, self._name = folder, name
        self.removals = 0  # how often another program removed the folder meanwhile
        self._turn = threading.Lock()
        self._descriptor = -1
        self._has_ended = False

    def claim(self) -> None:
        """Own the folder from now on; call it before each write. The folder is created, also after it was removed.

        On a file system without locks, every daemon owns the folder.

        Raises:
            FolderTaken: another daemon owns it.
            OSError: the disk failed, or this daemon has released the folder.
        """
        with self._turn:
            if self._has_ended:  # a thread whose daemon did not wait for it
                raise OSError(errno.ESHUTDOWN, "this daemon has ended")
            for _ in range(_TRIES):
                if self._descriptor >= 0 and _is_file(self._descriptor, self._folder / NAME):
                    return
                self.removals += self._descriptor >= 0
                self._close()
                self._folder.mkdir(parents=True, exist_ok=True)
                with contextlib.suppress(FileNotFoundError):  # the folder was removed again
                    self._descriptor = self._lock()
            raise FolderTaken(self._folder, "")

    def release(self) -> None:
        """Leave the folder to another daemon, for good."""
        with self._turn:
            self._has_ended = True
            self._close()

    def _lock(self) -> int:
        with contextlib.ExitStack() as stack:
            descriptor = os.open(self._folder / NAME, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
            stack.callback(os.close, descriptor)
            if not _try_lock(descriptor):
                time.sleep(_AGAIN_S)
                if not _try_lock(descriptor):
                    raise FolderTaken(self._folder, _text_of(descriptor))
            os.ftruncate(descriptor, 0)
            os.pwrite(descriptor, self._name.encode()[:_MAX_TEXT], 0)
            stack.pop_all()
        return descriptor

    def _close(self) -> None:
        if self._descriptor >= 0:
            # Closing alone keeps the lock while a child that was just forked has a copy of the descriptor.
            with contextlib.suppress(OSError):  # a file system without locks
                fcntl.flock(self._descriptor, fcntl.LOCK_UN)
            os.close(self._descriptor)
            self._descriptor = -1


def owner_of(folder: Path) -> str | None:
    """Return the name of the daemon that owns the folder; None: no daemon does."""
    with contextlib.suppress(OSError), (folder / NAME).open("rb") as file:
        if not _try_lock(file.fileno()):
            return _text_of(file.fileno()) or "another daemon"
    return None


def _try_lock(descriptor: int) -> bool:
    """Lock the file until it is closed. False: another process has locked it."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # a network file system may not support locks
        return True
    return True


def _text_of(descriptor: int) -> str:
    text = os.pread(descriptor, _MAX_TEXT, 0).decode(errors="replace")
    return "".join(char for char in text if char.isprintable())


def _is_file(descriptor: int, path: Path) -> bool:
    """Whether the open file still has this path."""
    try:
        return os.path.samestat(os.fstat(descriptor), path.stat())
    except OSError:
        return False
