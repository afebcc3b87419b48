"""Write hostlink/client/blocking_calls.py: the methods of Host and Robot for programs without asyncio.

python tools/blocking_client.py           # 1, and what to do, when it is not what the two classes make of it
python tools/blocking_client.py --write
"""

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

CLIENT = Path(__file__).parents[1] / "hostlink" / "client"
TARGET = CLIENT / "blocking_calls.py"
INTERNAL = {"running", "stop_driven", "end_cell"}  # of `connect` and of the thread
HEAD = '''"""The methods of Host and Robot without `async`, as tools/blocking_client.py makes them: change those.

Needed for types: Python cannot declare a proxy whose methods are those of a class without `async`, so mypy and editors
would accept any call of a generic one.
"""

import contextlib
from collections.abc import Mapping
from typing import Any, overload

from hostlink.client.host import Host
from hostlink.client.http_client import REQUEST_TIMEOUT_S
from hostlink.client.loop_thread import LoopThread, Messages, Opened, PlainAnswer, Stream, in_thread
from hostlink.client.motion import OnProgress
from hostlink.client.robot import PRIORITY, WAIT_S, Robot
from hostlink.client.type_names import TypeName
from hostlink.client.views import (
    ConnectionChange,
    Driven,
    Event,
    Motion,
    Odometry,
    RawMessage,
    Refusal,
    RobotState,
    TopicState,
)
from hostlink.robot.standstill import Standstill
'''
OPENED = "contextlib.AbstractAsyncContextManager"
LASTING = {  # what a method returns -> what it returns without asyncio, and how that is made
    f"{OPENED}[Subscription]": ("Messages[dict[str, Any]]", "Messages(self._loop, {call})"),
    f"{OPENED}[RawSubscription]": ("Messages[RawMessage]", "Messages(self._loop, {call})"),
    OPENED: ("Opened", "Opened(self._loop, {call}, {about})"),
    "Graphs": ("Messages[dict[str, Any]]", "Messages(self._loop, contextlib.nullcontext(self._loop.run({call})))"),
    "Mailbox": ("Messages[{inner}]", "Messages(self._loop, contextlib.nullcontext(self._loop.call({method})))"),
    "AsyncGenerator": ("Stream[{inner}]", "Stream(self._loop, {call}, {name!r})"),
    "AsyncIterator": ("Stream[{inner}]", "Stream(self._loop, {call}, {name!r})"),
    "Robot": ("BlockingRobot", "BlockingRobot(self._loop, {call})"),
}

Method = ast.FunctionDef | ast.AsyncFunctionDef


def main() -> None:
    """Compare, or write."""
    made = source()
    if "--write" in sys.argv[1:]:
        TARGET.write_text(made)
    elif made != TARGET.read_text():
        sys.exit(f"{TARGET.name} is older than Host and Robot: run  python tools/blocking_client.py --write")


def source() -> str:
    """The module, formatted."""
    host, robot = class_in("host.py", "Host"), class_in("robot.py", "Robot")
    text = HEAD + "\n".join(
        [
            *class_lines("BlockingRobot", "One robot of a host; get one from `BlockingHost.robot`.", robot, "robot"),
            *class_lines("HostCalls", "Methods of BlockingHost that correspond to those of Host.", host, "host"),
        ]
    )
    formatter = Path(sys.executable).parent / "ruff"
    command = [formatter, "format", "--stdin-filename", TARGET, "-"]
    return subprocess.run(command, input=text, text=True, capture_output=True, check=True).stdout


def class_in(file: str, name: str) -> ast.ClassDef:
    """The class of a module of the client."""
    tree = ast.parse((CLIENT / file).read_text())
    return next(each for each in tree.body if isinstance(each, ast.ClassDef) and each.name == name)


def class_lines(name: str, text: str, original: ast.ClassDef, field: str) -> Iterator[str]:
    """A class that has each public method of another, and its attributes."""
    yield f'class {name}:\n    """{text}"""'
    yield f"    def __init__(self, loop: LoopThread, {field}: {original.name}) -> None:"
    yield f"        self._loop, self._{field} = loop, {field}"
    for attribute, type_name, meaning in attributes(field):
        yield f'    @property\n    def {attribute}(self) -> {type_name}:\n        """{meaning}"""'
        yield f"        return self._{field}.{attribute}"
    for method in original.body:
        if isinstance(method, Method) and not method.name.startswith("_") and method.name not in INTERNAL:
            yield from method_lines(method, f"self._{field}")
    if field == "robot":
        yield '    def __repr__(self) -> str:\n        return repr(self._robot).replace("Robot", "BlockingRobot", 1)'


def attributes(field: str) -> list[tuple[str, str, str]]:
    """Attributes that the constructor sets."""
    if field == "host":
        return [("url", "str", "Address of the daemon.")]
    return [("name", "str", "Name without a slash."), ("priority", "int", "Priority of its commands, 0 to 100.")]


def method_lines(method: Method, owner: str) -> Iterator[str]:
    """One method: the same arguments and docstring, and one call."""
    returned, body = translated(method, owner)
    arguments = ast.unparse(method.args).replace("Answer", "PlainAnswer")
    if has_decorator(method, "overload"):
        yield f"    @overload\n    def {method.name}({arguments}) -> {returned}: ..."
        return
    yield "    @property" if is_property(method) else ""
    yield f"    def {method.name}({arguments}) -> {returned}:"
    yield f'        """{ast.get_docstring(method, clean=False)}"""'
    yield f"        return {body}"


def translated(method: Method, owner: str) -> tuple[str, str]:
    """Return the type that the blocking method returns, and the expression of its value."""
    returned = "" if method.returns is None else ast.unparse(method.returns).strip("'\"")
    if is_property(method):
        return returned, f"{owner}.{method.name}"
    call = f"{owner}.{method.name}({passed(method.args)})"
    head, inner = returned.partition("[")[0], returned.partition("[")[2].removesuffix("]").removesuffix(", None")
    known = LASTING.get(returned) or LASTING.get(head)
    if known is not None:
        facts = {"call": call, "inner": inner, "method": f"{owner}.{method.name}", "name": method.name}
        about = [each.arg for each in method.args.args[1:]][:1]
        return known[0].format(**facts), known[1].format(**facts, about="".join(about))
    if "on_progress" in call:
        begin = call.replace("=on_progress", "=report")
        return returned, f"self._loop.run_reporting(lambda report: {begin}, on_progress)"
    return returned, f"self._loop.run({call})" if isinstance(method, ast.AsyncFunctionDef) else call


def is_property(method: Method) -> bool:
    """Whether it is read like an attribute."""
    return has_decorator(method, "property")


def has_decorator(method: Method, name: str) -> bool:
    """Whether a method has this decorator."""
    return any(ast.unparse(each) == name for each in method.decorator_list)


def passed(arguments: ast.arguments) -> str:
    """The arguments of a method, passed on."""
    plain = [each.arg for each in arguments.args[1:]]
    named = [f"{each.arg}={each.arg}" for each in arguments.kwonlyargs]
    return ", ".join("in_thread(answer)" if each == "answer" else each for each in [*plain, *named])


if __name__ == "__main__":
    main()
