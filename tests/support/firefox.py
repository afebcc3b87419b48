"""Debian's Firefox, driven by its own WebDriver BiDi, without a driver program."""

import asyncio
import contextlib
import itertools
import json
import re
import tempfile
from asyncio.subprocess import DEVNULL, PIPE
from collections.abc import AsyncIterator
from typing import Any

import aiohttp

START_TIMEOUT_S = 60.0
COMMAND_TIMEOUT_S = 60.0  # only a defect reaches it
LISTENING = re.compile(rb"WebDriver BiDi listening on (ws://\S+)")
LEFT, MIDDLE, RIGHT = range(3)  # the buttons of a mouse
NO_PROXY = {"capabilities": {"alwaysMatch": {"acceptInsecureCerts": False}}}


class Tab:
    """One page."""

    def __init__(self, socket: aiohttp.ClientWebSocketResponse) -> None:
        self._socket = socket
        self._numbers = itertools.count(1)
        self._context = ""

    async def open(self, url: str) -> None:
        """Begin a session, and load the page."""
        await self._call("session.new", NO_PROXY)
        self._context = (await self._call("browsingContext.getTree", {}))["contexts"][0]["context"]
        await self._navigate(url)

    async def evaluate(self, expression: str) -> Any:
        """The value of an expression of JavaScript: a text, a number, or whether it is so."""
        target = {"context": self._context}
        answer = await self._call("script.evaluate", {"expression": expression, "target": target, "awaitPromise": True})
        if answer["type"] == "exception":
            raise AssertionError(answer["exceptionDetails"]["text"])
        return answer["result"].get("value")

    async def shows(self, selector: str, text: str) -> None:
        """Wait until an element has this text."""
        expression = f"document.querySelector({json.dumps(selector)})?.textContent ?? ''"
        found = ""
        async with asyncio.timeout(COMMAND_TIMEOUT_S):
            while text not in found:
                await asyncio.sleep(0.02)
                found = await self.evaluate(expression)

    async def press(self, key: str) -> None:
        """Hold a key down."""
        await self._actions("key", [{"type": "keyDown", "value": key}])

    async def release(self, key: str) -> None:
        """Let it go."""
        await self._actions("key", [{"type": "keyUp", "value": key}])

    async def click(self, selector: str) -> None:
        """Press the mouse's left button in the middle of an element."""
        await self.hold(selector)
        await self.let_go()

    async def hold(self, selector: str, *, up_px: int = 0, button: int = LEFT, finger: str | None = None) -> None:
        """Press a button of the mouse, or a finger, in the middle of an element, and pull it upwards."""
        x, y = await self.middle(selector)
        steps: list[dict[str, Any]] = [
            {"type": "pointerMove", "x": x, "y": y},
            {"type": "pointerDown", "button": button},
        ]
        if up_px:
            steps.append({"type": "pointerMove", "x": x, "y": y - up_px, "duration": 50})
        await self._point(steps, finger)

    async def let_go(self, *, button: int = LEFT, finger: str | None = None) -> None:
        """Release it."""
        await self._point([{"type": "pointerUp", "button": button}], finger)

    async def leave(self) -> None:
        """Go to another page."""
        await self._navigate("about:blank")

    async def middle(self, selector: str) -> tuple[int, int]:
        """Return the centre of an element in the window."""
        box = f"document.querySelector({json.dumps(selector)}).getBoundingClientRect()"
        text = await self.evaluate(f"(b => `${{b.x + b.width / 2}} ${{b.y + b.height / 2}}`)({box})")
        x, y = map(float, text.split())
        return round(x), round(y)

    async def _navigate(self, url: str) -> None:
        await self._call("browsingContext.navigate", {"context": self._context, "url": url, "wait": "complete"})

    async def _point(self, steps: list[dict[str, Any]], finger: str | None) -> None:
        pointer = {"id": finger or "mouse", "parameters": {"pointerType": "touch" if finger else "mouse"}}
        await self._actions("pointer", steps, **pointer)

    async def _actions(self, kind: str, steps: list[dict[str, Any]], **more: Any) -> None:
        source = {"type": kind, "id": kind, "actions": steps, **more}
        await self._call("input.performActions", {"context": self._context, "actions": [source]})

    async def _call(self, method: str, params: dict[str, Any]) -> Any:
        number = next(self._numbers)
        await self._socket.send_json({"id": number, "method": method, "params": params})
        async with asyncio.timeout(COMMAND_TIMEOUT_S):
            while True:
                answer = await self._socket.receive_json()
                if answer.get("id") == number:
                    break
        if answer["type"] == "error":
            raise AssertionError(f"{method}: {answer['error']}: {answer['message']}")
        return answer["result"]


@contextlib.asynccontextmanager
async def firefox(url: str) -> AsyncIterator[Tab]:
    """A page in a browser of its own, with an empty profile."""
    with tempfile.TemporaryDirectory() as profile:
        words = ("--headless", "--no-remote", "--profile", profile, "--remote-debugging-port=0", "about:blank")
        child = await asyncio.create_subprocess_exec("firefox-esr", *words, stdout=DEVNULL, stderr=PIPE)
        try:
            address = await asyncio.wait_for(_address(child), START_TIMEOUT_S)
            async with asyncio.TaskGroup() as tasks, aiohttp.ClientSession() as session:
                assert child.stderr is not None
                reading = tasks.create_task(child.stderr.read())  # it would wait for room in the pipe
                async with session.ws_connect(f"{address}/session", max_msg_size=0) as socket:
                    tab = Tab(socket)
                    await tab.open(url)
                    yield tab
                child.kill()
                await reading
        finally:
            with contextlib.suppress(ProcessLookupError):
                child.kill()
            await child.wait()


async def _address(child: asyncio.subprocess.Process) -> str:
    assert child.stderr is not None
    seen = b""
    while line := await child.stderr.readline():
        seen += line
        if found := LISTENING.search(line):
            return found[1].decode()
    raise AssertionError(f"firefox-esr ended: {seen.decode()}")
