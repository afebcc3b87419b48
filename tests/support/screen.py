"""A real terminal: a tmux session of its own, whose keys are pressed and whose screen is read.

One tmux client in control mode presses the keys and reads the screen. A process for each key would be too slow on a
busy machine, and a held key would count as released. The client receives a line for each output, so a wait ends with
an event.
"""

import asyncio
import contextlib
import shlex
import shutil
import tempfile
from collections import deque
from collections.abc import AsyncIterator
from contextlib import AbstractAsyncContextManager

from tests.support.background import meanwhile

PATIENCE_S = 40.0  # bound of a wait for an event; a busy machine takes long
AGAIN_S = 3.0  # until Ctrl-C is pressed again
POLL_S = 0.1
KEY_INTERVAL_S = 0.03  # of a keyboard that repeats a key


class Screen:
    """A tmux session with a shell in it."""

    def __init__(self, socket: str) -> None:
        self._socket = socket
        self._control: asyncio.subprocess.Process | None = None
        self._answers: deque[asyncio.Future[str]] = deque()
        self._changed = asyncio.Event()
        self.attached = asyncio.Event()

    async def run(self) -> None:
        """Serve the control client until tmux ends."""
        child = self._control = await asyncio.create_subprocess_exec(
            "tmux", "-S", self._socket, "-C", "attach", "-f", "ignore-size", "-t", "main",
            stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE,
        )  # fmt: skip
        try:
            await self._serve(child)
        finally:
            self._control = None
            if child.returncode is None:
                child.kill()
            await child.communicate()  # closes its pipes

    async def _serve(self, child: asyncio.subprocess.Process) -> None:
        self._answers.append(asyncio.get_running_loop().create_future())  # of `attach` itself
        self.attached.set()
        assert child.stdout is not None
        block: list[str] | None = None
        async for raw in child.stdout:
            line = raw.decode(errors="replace").rstrip("\n")
            if block is None and line.startswith("%begin "):
                block = []
            elif block is not None and line.startswith(("%end ", "%error ")):
                answer = self._answers.popleft()
                if not answer.done():
                    answer.set_result("\n".join([*block, ""]))
                block = None
            elif block is not None:
                block.append(line)
            else:  # %output, %layout-change, %exit ...
                self._changed.set()
        self._control = None
        for answer in self._answers:
            if not answer.done():
                answer.set_result("")

    async def tmux(self, *arguments: str) -> str:
        """Run a command of tmux; its output."""
        child = await asyncio.create_subprocess_exec(
            "tmux", "-S", self._socket, *arguments, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE
        )
        out, _ = await child.communicate()
        return out.decode()

    async def command(self, *arguments: str) -> str:
        """Run a command of tmux in the control client; empty when tmux has ended."""
        if self._control is None or self._control.stdin is None:
            return ""
        answer: asyncio.Future[str] = asyncio.get_running_loop().create_future()
        self._answers.append(answer)
        self._control.stdin.write(f"{shlex.join(arguments)}\n".encode())
        return await answer

    async def keys(self, *names: str) -> None:
        await self.tmux("send-keys", "-t", "main", *names)

    def holding(self, key: str) -> AbstractAsyncContextManager[None]:
        """Hold a key for the length of the block: press it again and again, as a keyboard does."""
        return meanwhile(self._hold(key))

    async def _hold(self, key: str) -> None:
        while True:
            await self.command("send-keys", "-t", "main", key)
            await asyncio.sleep(KEY_INTERVAL_S)

    async def text(self) -> str:
        return await self.command("capture-pane", "-p", "-t", "main")

    async def shows(self, text: str, *, within_s: float = PATIENCE_S) -> str:
        """Wait until the text is on the screen; the whole screen."""
        observed = ""
        try:
            async with asyncio.timeout(within_s):
                while True:
                    self._changed.clear()
                    if text in (observed := await self.text()):
                        return observed
                    with contextlib.suppress(TimeoutError):  # a change that tmux does not report
                        async with asyncio.timeout(1.0):
                            await self._changed.wait()
        except TimeoutError:
            raise AssertionError(f"not on the screen within {within_s:g} s: {text!r}; last:\n{observed}") from None

    async def interrupt(self, until: str) -> str:
        """Press Ctrl-C until the text is on the screen; the whole screen.

        Python's `input()` notices a signal that arrives just before it reads only with the next key or signal.
        """
        async with asyncio.timeout(PATIENCE_S):
            while True:
                await self.keys("C-c")
                with contextlib.suppress(AssertionError):
                    return await self.shows(until, within_s=AGAIN_S)

    async def process(self, name: str) -> int:
        """The process with this command line in the screen."""
        shell = (await self.tmux("list-panes", "-t", "main", "-F", "#{pane_pid}")).strip()
        async with asyncio.timeout(PATIENCE_S):
            while True:
                child = await asyncio.create_subprocess_exec(
                    "pgrep", "-P", shell, "-f", name, stdout=asyncio.subprocess.PIPE
                )
                out, _ = await child.communicate()
                if out.strip():
                    return int(out.split()[0])
                await asyncio.sleep(POLL_S)


@contextlib.asynccontextmanager
async def screen(*, columns: int = 100, rows: int = 24) -> AsyncIterator[Screen]:
    """Open a terminal with a shell that waits for a command."""
    assert shutil.which("tmux"), "tmux is not installed: `make test-all` does it, or sudo apt-get install tmux"
    size = ("-x", str(columns), "-y", str(rows))
    # A folder for each one: the server of the test before may still be ending at a socket of its own name.
    with tempfile.TemporaryDirectory() as folder:
        made = Screen(f"{folder}/tmux")
        await made.tmux(
            "-f", "/dev/null", "new-session", "-d", "-s", "main", *size, "env", "-u", "PS1", "bash", "--norc"
        )
        async with asyncio.TaskGroup() as tasks:
            try:
                async with asyncio.timeout(PATIENCE_S):
                    while "bash-" not in await made.tmux("capture-pane", "-p", "-t", "main"):  # noqa: ASYNC110 - not attached yet
                        await asyncio.sleep(POLL_S)  # keys that arrive while the shell starts can be lost
                running = tasks.create_task(made.run())
                await made.attached.wait()
                try:
                    yield made
                finally:
                    running.cancel()
            finally:
                await made.tmux("kill-server")
