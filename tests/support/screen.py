"""A real terminal: a tmux session of its own, whose keys are pressed and whose screen is read."""

import asyncio
import contextlib
import os
import shutil
from collections.abc import AsyncIterator

PATIENCE_S = 15.0
POLL_S = 0.1


class Screen:
    """A tmux session of its own with a shell in it."""

    def __init__(self, name: str) -> None:
        self._name = name

    async def tmux(self, *arguments: str) -> str:
        child = await asyncio.create_subprocess_exec(
            "tmux", "-L", self._name, *arguments, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE
        )
        out, _ = await child.communicate()
        return out.decode()

    async def keys(self, *names: str) -> None:
        await self.tmux("send-keys", "-t", "main", *names)

    async def text(self) -> str:
        return await self.tmux("capture-pane", "-p", "-t", "main")

    async def shows(self, text: str) -> str:
        observed = ""
        try:
            async with asyncio.timeout(PATIENCE_S):
                while text not in (observed := await self.text()):  # noqa: ASYNC110 - tmux has no event
                    await asyncio.sleep(POLL_S)
        except TimeoutError:
            raise AssertionError(f"not on the screen within {PATIENCE_S:g} s: {text!r}; last:\n{observed}") from None
        return observed

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
async def screen(*, columns: int = 100, rows: int = 24, name: str = "") -> AsyncIterator[Screen]:
    """`name`: of the second one of a test."""
    assert shutil.which("tmux"), "tmux is not installed: `make test` does it, or sudo apt-get install tmux"
    made = Screen(f"hostlink-{os.getpid()}{name}")
    size = ("-x", str(columns), "-y", str(rows))
    await made.tmux("-f", "/dev/null", "new-session", "-d", "-s", "main", *size, "env", "-u", "PS1", "bash", "--norc")
    try:
        await made.shows("bash-")  # keys that come while it starts can be lost
        yield made
    finally:
        await made.tmux("kill-server")
