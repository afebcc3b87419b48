"""Two ends of a serial line without hardware."""

import asyncio
import contextlib
import os
import termios
import tty
from collections.abc import AsyncIterator, Iterator


@contextlib.contextmanager
def pty_pair() -> Iterator[tuple[int, str]]:
    """(descriptor of one end, path of the other), both raw."""
    ours, theirs = os.openpty()
    for end in (ours, theirs):
        tty.setraw(end, termios.TCSANOW)
    try:
        yield ours, os.ttyname(theirs)
    finally:
        for end in (ours, theirs):
            with contextlib.suppress(OSError):  # a test may have closed its end
                os.close(end)


@contextlib.asynccontextmanager
async def pty_streams() -> AsyncIterator[tuple[asyncio.StreamReader, asyncio.StreamWriter, str]]:
    """The one end as streams, and the path of the other."""
    loop, reader = asyncio.get_running_loop(), asyncio.StreamReader()
    with pty_pair() as (ours, path):
        source, sink = os.fdopen(os.dup(ours), "rb", 0), os.fdopen(os.dup(ours), "wb", 0)
        reading, _ = await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), source)
        writing, flow = await loop.connect_write_pipe(
            lambda: asyncio.StreamReaderProtocol(asyncio.StreamReader()), sink
        )
        try:
            yield reader, asyncio.StreamWriter(writing, flow, None, loop), path
        finally:
            reading.close()
            writing.close()
            await asyncio.sleep(0)  # both close in the loop's next turn
