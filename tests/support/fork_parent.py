"""A process that has imported a program and forks it on request: each starts without its seconds of imports.

`python fork_parent.py FILE DESCRIPTOR`: FILE imports all that it needs, and has `main`. On the socket, it sends READY
when that is imported; `{"arguments": [...], ...}` with the descriptors 0, 1 and 2 is answered with a pid,
`{"wait": pid}` with the exit status of that process. `{"copy": true}` with a socket is not answered: a copy of this
process serves that socket. The standard library is enough: FILE may need another Python than the tests'.
"""

import gc
import importlib.util
import json
import os
import signal
import socket
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

REQUEST_BYTES = 1 << 18
READY = b"ready"


def main() -> None:
    """Serve until the other end is closed; what runs then, of tests that were killed, is killed too."""
    requests = socket.socket(fileno=int(sys.argv[2]))
    program = _load(Path(sys.argv[1]))
    gc.collect()
    requests.send(READY)
    gc.freeze()  # a collection in a child would write into each object, and so copy every page that it shares
    running: set[int] = set()
    while True:
        data, files = _receive(requests)
        if not data:
            for pid in running:
                os.kill(pid, signal.SIGKILL)
            return
        request = json.loads(data)
        if "wait" in request:
            status = os.waitstatus_to_exitcode(os.waitpid(request["wait"], 0)[1])
            running.discard(request["wait"])
            requests.send(str(status).encode())
            continue
        if "copy" in request:
            if os.fork() == 0:
                requests.close()
                requests, running = socket.socket(fileno=files[0]), set()
                requests.send(READY)
            else:
                os.close(files[0])
            continue
        pid = os.fork()
        if pid == 0:
            requests.close()
            _become(request, files)
            program.main()
            return
        running.add(pid)
        requests.send(str(pid).encode())
        for file in files:
            os.close(file)


def _receive(requests: socket.socket) -> tuple[bytes, list[int]]:
    """Return a request and its descriptors; an empty one when the other end is closed."""
    try:
        data, files, _, _ = socket.recv_fds(requests, REQUEST_BYTES, 3)
    except ConnectionResetError:  # it was closed with an answer that was not read
        return b"", []
    return data, files


def _load(file: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(file.stem, file)
    assert spec is not None
    assert spec.loader is not None
    program = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(program)
    return program


def _become(request: dict[str, Any], files: list[int]) -> None:
    for number, file in enumerate(files):
        os.dup2(file, number)
        os.close(file)
    os.chdir(request["folder"])
    os.environ.clear()
    os.environ.update(request["environment"])
    sys.argv = request["arguments"]
    Path("/proc/self/comm").write_text(sys.argv[0])


if __name__ == "__main__":
    main()
