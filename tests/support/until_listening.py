"""A program until it listens for devices: prints its CPU time and what it has imported by then, and ends.

As arguments: a port, and either `bare`, a server of asyncio alone, or the words of a hostlink command.
"""

import json
import os
import socket
import sys
import time

HEAVY = ("asyncio", "aiohttp", "structlog", "numpy", "rosbags", "mcap")
PORT = int(sys.argv.pop(1))
listen = socket.socket.listen


def listened(self: socket.socket, *arguments: int) -> None:
    listen(self, *arguments)
    if self.getsockname()[1] == PORT:
        cpu_s = time.process_time()  # of user and system, with the start of Python
        found = {"cpu_s": cpu_s, "heavy": [name for name in HEAVY if name in sys.modules]}
        os.write(1, json.dumps(found).encode())
        os._exit(0)


socket.socket.listen = listened  # type: ignore[method-assign, assignment]
if sys.argv[1] == "bare":
    import asyncio

    async def serve() -> None:
        await asyncio.start_server(lambda _, writer: writer.close(), "127.0.0.1", PORT)

    asyncio.run(serve())
else:
    from hostlink.cli.start import main

    main()
