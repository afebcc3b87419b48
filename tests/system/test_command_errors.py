"""A command that fails ends with one line that names the next step, and with the right status."""

import asyncio
import os
import signal
import socket
import subprocess
import sys

import pytest

from hostlink.cli.main import FIRST_DAY
from tests.support.process import HOSTLINK, free_port, run
from tests.support.waiting import TIMEOUT_S

FULL = "/dev/full"
INTERRUPTED_IMPORT = """
import os, runpy, signal, sys
class Interrupts:
    def find_spec(self, name, path=None, target=None):
        if name == "typer":
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Interrupts())
sys.argv = ["hostlink", "robots"]
runpy.run_module("hostlink", run_name="__main__")
"""

INTERRUPTED_END = """
import asyncio, os, signal
from hostlink.cli.connecting import run_until_interrupted
def interrupt():
    os.kill(os.getpid(), signal.SIGINT)
async def connection():
    try:
        await asyncio.sleep(60.0)
    finally:
        interrupt()
async def work():
    asyncio.get_running_loop().call_soon(interrupt)
    async with asyncio.TaskGroup() as tasks:
        tasks.create_task(connection())
run_until_interrupted(work())
"""


@pytest.mark.parametrize(
    ("line", "complaint"),
    [
        ("topics nonsense", "topics: there is an argument too many: nonsense; `hostlink topics --help` lists the opt"),
        ("hz /x --seconds -1", "hz: the value of --seconds is wrong: "),
        ("sim --robot fast", "--robot: unknown value 'fast'; choose nimble or paper"),
        ("echo", "echo: the argument topic is missing; `hostlink echo --help` lists the options"),
        ("export x.mcap", "export: the option --to is missing; choose csv, ros2, rosbag2, ros1; `hostlink export -"),
        ("params get", "params get: the argument name is missing; `hostlink params get --help` lists the options"),
        ("pub /x --once --count 2", "--once: cannot be combined with --count; use one of them"),
        ("rosbag record -O run.bag", "--output: run.bag would be a bag of ROS, but the file is MCAP; name it run.mcap"),
        ("record -a /x", "--all: means every topic, but '/x' is named too; leave one of them out"),
        ("pub /x data: 1", "MESSAGE: 2 arguments were given; put the message in quotes: '{linear: {x: 0.1}}'"),
        ("record --name ../x", "--name: ../x is not a name of a recording; use at most 100 letters and digits"),
        ("topic lst", "topic lst: there is no such command; `topic` has: list, echo, hz"),
        ("ros2 topic echo /x --qos-profile y", "echo: there is no option --qos-profile; rosserial has no quality"),
        ("ros2 param get /robot_0 gain", "params get: a parameter belongs to no node; leave the node out"),
        ("robots --url ftp://x", "url: 'ftp://x' is not an address of a hostlink: write it as http://HOST:9090"),
        ("incidents --reason x", "--reason: is the reason of --save; add --save ROBOT\n"),
        ("lab", "lab: the argument what is missing; choose causes, tables, claims, pictures; `hostlink lab --help`"),
        (
            "pub /x std_msgs/Int8 -5",
            "pub: there is no option -5; write -- before a negative number, as in `hostlink pub",
        ),
        ("plot x.mcap", "plot: name fields, for example /robot_0/odometry.x, or use --map\n"),
        ("plot x.mcap /x.y --map", "plot: --map draws paths instead of fields; leave the fields or --map out\n"),
        ("serve --listen nonsense", "--listen: 'nonsense' is not HOST:PORT"),
        (
            "serve --udp 8888 --micro-ros udp://8888",
            "micro_ros.udp.port: UDP port 8888 is that of [udp], too; give each",
        ),
        ("serve --serial /dev/x@fast", "--serial: '/dev/x@fast' is not PORT or PORT@BAUD"),
        ("serve --listen COM3", "--listen: 'COM3' is not HOST:PORT; a serial port is --serial /dev/ttyUSB0"),
        ("drive robot_0 0.2", "teleop: the keys drive, and the speeds are options"),
        ("turn robot_0 90", "ANGLE: '90' has no unit; write it as 90deg or 90rad"),
        ("move robot_0", "DISTANCE: is missing; write it behind the name, as in `hostlink move robot_0 1`"),
        ("incidents -o x", "incidents: name the file of an incident, too; `hostlink incidents NAME -o FILE` downloads"),
        ("serve --config /none.toml", "/none.toml: No such file or directory"),
        ("serve --log-level loud", "--log-level: unknown value 'loud'; choose debug, info, warning or error"),
        ("serve --loop trio", "--loop: unknown value 'trio'; choose auto, asyncio or uvloop\n"),
        ("teleop --layout dvorak", "--layout: unknown value 'dvorak'; choose original or twist"),
        ("pub /x {", "MESSAGE: cannot be read: } is missing at the end; write it as "),
        ('call /x "a:b"', "REQUEST: is not an object with fields"),
        ("step robot_0", "--yes: the robot will move, and this command cannot ask"),
        ("step robot_0 --json", "--yes: the robot will move"),
        ("step robot_0 --yes --speed 0", "--speed: 0 m/s is outside 0.02 to 2 m/s"),
        ("step robot_0 --yes --speed nan", "step: the value of --speed is wrong: nan is not a n"),
        ("step robot_0 --yes --send", "--send: sends the gains that --tune computes; add --tune"),
        ("step robot_0 --yes --tune --seconds 9", "--seconds: cannot be combined with --tune"),
        ("step robot_0 --yes --picture step.gif", "--picture: step.gif must end in one of"),
    ],
)
async def test_wrong_arguments_are_one_line_and_status_2(line: str, complaint: str) -> None:
    status, out, errors = await run(*line.split())
    assert (status, out, errors.count("\n")) == (2, "", 1)
    assert errors.startswith(f"hostlink: {complaint}")


@pytest.mark.parametrize("line", ["topics", "teleop", "drive robot_0", "doctor", "step robot_0 --yes"])
async def test_a_daemon_that_is_not_there_is_one_line_and_status_1(line: str) -> None:
    status, out, errors = await run(*line.split(), "--url", "http://127.0.0.1:1")
    assert (status, out, errors.count("\n")) == (1, "", 1)
    assert errors.startswith("hostlink: no hostlink at http://127.0.0.1:1: is `hostlink serve`")


async def test_a_file_that_is_not_there_is_one_line_and_status_1() -> None:
    status, out, errors = await run("inspect", "/none.jsonl")
    assert (status, out, errors.count("\n")) == (1, "", 1)
    assert errors.startswith("hostlink: /none.jsonl: No such file or directory")


async def test_the_command_alone_shows_the_first_screen() -> None:
    assert await run() == (0, FIRST_DAY, "")


async def test_a_group_of_commands_alone_shows_what_it_has() -> None:
    status, out, errors = await run("params")
    assert (status, errors) == (2, "")
    assert "dump" in out


@pytest.mark.parametrize("words", ["--version", "--help"])
async def test_an_output_that_is_full_is_one_line_and_status_1(words: str) -> None:
    with open(FULL, "w") as full:  # noqa: ASYNC230, PTH123 - a device
        child = await asyncio.create_subprocess_exec(HOSTLINK, words, stdout=full, stderr=subprocess.PIPE)
        async with asyncio.timeout(TIMEOUT_S):
            _, errors = await child.communicate()
    assert (child.returncode, errors.decode().splitlines()[1:]) == (1, [])
    assert b"No space left on device" in errors


async def test_a_demo_whose_reader_is_gone_ends_in_order() -> None:
    words = f"demo --listen 127.0.0.1:{free_port()} --api 127.0.0.1:{free_port()}".split()
    child = await asyncio.create_subprocess_exec(HOSTLINK, *words, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert child.stdout is not None
    assert child.stderr is not None
    async with asyncio.timeout(TIMEOUT_S):
        assert (await child.stdout.readline()).startswith(b"hostlink runs")
        child.stdout._transport.close()  # type: ignore[attr-defined]
        assert await child.stderr.read() == b""
        assert await child.wait() == 1


async def test_ctrl_c_while_the_program_is_loaded_shows_no_traceback() -> None:
    child = await asyncio.create_subprocess_exec(
        sys.executable, "-c", INTERRUPTED_IMPORT, stderr=subprocess.PIPE, env=dict(os.environ)
    )
    async with asyncio.timeout(TIMEOUT_S):
        _, errors = await child.communicate()
    assert (child.returncode, errors) == (-signal.SIGINT, b"")


async def test_ctrl_c_twice_ends_a_measurement_without_a_traceback() -> None:
    child = await asyncio.create_subprocess_exec(sys.executable, "-c", INTERRUPTED_END, stderr=subprocess.PIPE)
    async with asyncio.timeout(TIMEOUT_S):
        _, errors = await child.communicate()
    assert (child.returncode, errors.decode()) == (0, "")


async def test_demo_whose_port_is_in_use_says_how_make_takes_another() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        api = f"127.0.0.1:{taken.getsockname()[1]}"
        status, _, errors = await run("demo", "--api", api, "--listen", "127.0.0.1:0")
    assert (status, errors.count("\n")) == (2, 1)
    assert "choose another port with --api HOST:PORT; make passes options on: make demo ARGS='--api " in errors
