"""Topics, services, parameters and robots from the command line, as `ros2 topic` and its kin have them."""

import asyncio
import importlib.metadata
import json
import struct
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from hostlink.core.protocol.endpoint import EndpointKind
from hostlink.core.protocol.rosserial.frame import encode
from tests.support.daemon import Daemon, daemon
from tests.support.fake_device import FakeDevice, fake_device, pose, repeating, robot_topics, service_server, topic
from tests.support.process import HOSTLINK, run
from tests.support.screen import screen
from tests.support.tcp_server import say_nothing, tcp_server
from tests.support.waiting import TIMEOUT_S

POINT = topic(EndpointKind.PUBLISHER, 126, "/robot_0/point", "geometry_msgs/PointStamped")
TRIGGER = service_server("/trigger", "std_srvs/Trigger", 127, 102)


@asynccontextmanager
async def publishing(data: bytes = b"") -> AsyncIterator[tuple[Daemon, FakeDevice]]:
    """A robot that publishes its pose, and more, fifty times a second."""
    async with (
        daemon() as host,
        fake_device(host.tcp, [*robot_topics(), POINT, *TRIGGER]) as device,
        repeating(device, pose(1 / 3, 2.0, 0.5) + data, interval_s=0.02),
    ):
        yield host, device


async def test_echo_prints_fields_rows_and_single_messages() -> None:
    async with publishing() as (host, _):
        words = ("echo", "/robot_0/odometry", "--url", host.url)
        assert (await run(*words, "--once"))[1] == "x: 0.333333\ny: 2.0\ntheta: 0.5\n---\n"
        assert (await run("echo", "/robot_0/odometry/theta", "-n", "1", "--url", host.url))[1] == "0.5\n"
        assert json.loads((await run(*words, "--once", "--json"))[1])["x"] == 1 / 3
        assert await run(*words, "--count", "2", "--field", "theta") == (0, "0.5\n0.5\n", "")
        _, table, _ = await run(*words, "--csv", "--count", "2")
        assert (await run(*words, "--once", "--field", "q")) == (
            1, "", "hostlink: no field q; at that place the message has x, y, theta\n"
        )  # fmt: skip
        assert (await run(*words, "--csv", "--json"))[0] == 2
    head, *rows = (line.split(",") for line in table.splitlines())
    assert head == ["time", "x", "y", "theta"]
    assert [row[1:] for row in rows] == [[repr(1 / 3), "2.0", "0.5"]] * 2


async def test_echo_of_a_topic_without_a_publisher_gets_a_hint() -> None:
    async with publishing() as (host, _):
        status, out, err = await run("echo", "/robot_0/odometrie", "--timeout", "0.2", "--url", host.url)
        assert (status, out) == (1, "")
        hint, error = err.splitlines()
        assert hint.startswith("/robot_0/odometrie has no publisher; similar names: /robot_0/odometry")
        assert error.startswith(
            "hostlink: /robot_0/odometrie: no message arrived within 0.2 s; `hostlink info /robot_0/"
        )
        _, _, err = await run("hz", "/nonsense", "--seconds", "0.1", "--url", host.url)
        assert err.startswith("/nonsense has no publisher; `hostlink topics` lists all topics; waiting")


async def test_rate_bandwidth_and_delay_are_measured() -> None:
    point = encode(126, struct.pack("<III", 1, 0, 0) + struct.pack("<I", 0) + struct.pack("<3d", 1, 2, 3))
    async with publishing(point) as (host, _):
        end = ("--seconds", "0.5", "--json", "--url", host.url)
        _, out, err = await run("hz", "/robot_0/odometry", *end)
        rate = json.loads(out)
        assert 20 < rate["rate_hz"] < 51
        assert err == f"{rate['messages']} messages in {err.split()[-2]} s\n"
        bandwidth = json.loads((await run("bw", "/robot_0/odometry", *end))[1])
        assert (bandwidth["min_bytes"], bandwidth["max_bytes"]) == (24, 24)
        delay = json.loads((await run("delay", "/robot_0/point", *end))[1])
        assert delay["delay_s"] > 1.7e9  # a device that does not know the time
        assert "geometry_msgs/Pose2D has no header" in (await run("delay", "/robot_0/odometry", *end))[2]
        assert "/x has no type yet" in (await run("delay", "/x", *end))[2]
        assert "similar names: /robot_0/point; " in (await run("delay", "/robot_0/pont", *end))[2]
        assert " Hz   every " in (await run("hz", "/robot_0/odometry", "--seconds", "0.5", "--url", host.url))[1]


async def test_info_type_and_find() -> None:
    async with publishing() as (host, _):
        at = ("--json", "--url", host.url)
        info = json.loads((await run("info", "/robot_0/odometry", *at))[1])
        assert (info["type"], info["publishers"]) == ("geometry_msgs/Pose2D", ["/robot_0"])
        node = json.loads((await run("info", "robot_0", *at))[1])
        assert (node["services"], "/robot_0/velocity_commands" in node["subscribing"]) == (["/trigger"], True)
        assert json.loads((await run("info", "/trigger", *at))[1]) == {
            "service": "/trigger", "type": "std_srvs/Trigger", "node": "/robot_0",
        }  # fmt: skip
        assert "similar names: /trigger" in (await run("info", "/triger", *at))[2]
        assert (await run("type", "/trigger", "--url", host.url))[1] == "std_srvs/Trigger\n"
        _, out, _ = await run("type", "/robot_0/velocity_commands", "--fields", "--url", host.url)
        assert out.splitlines()[:3] == ["geometry_msgs/Twist", "  geometry_msgs/Vector3 linear", "  float64 linear.x"]
        _, out, _ = await run("type", "std_msgs/msg/ColorRGBA", "--url", host.url)  # it has no publisher
        assert out.splitlines() == ["std_msgs/ColorRGBA", *(f"  float32 {name}" for name in "rgba")]
        assert (await run("type", "std_srvs/srv/Trigger", "--url", host.url))[1].startswith("std_srvs/Trigger\n")
        assert (await run("type", "geometry_msgs/Pose3D", *at))[2].startswith(
            "hostlink: there is no topic, service or type named geometry_msgs/Pose3D; "
        )
        assert (await run("find", "geometry_msgs/msg/Pose2D", "--url", host.url))[1] == "/robot_0/odometry\n"
        assert (await run("find", "geometry_msgs/Pose3D", *at))[2].startswith(
            "hostlink: there is no topic or service of a type named geometry_msgs/Pose3D; similar names: geometry_msgs"
        )


async def test_topics_with_rates_and_lists_of_services_robots_links_and_clients() -> None:
    async with publishing() as (host, _):
        at = ("--url", host.url)
        _, out, _ = await run("topics", "-v", *at)
        head, *rows = (line.split() for line in out.splitlines())
        assert head == ["topic", "type", "pubs", "subs", "messages", "rate"]
        (rate,) = (float(row[5]) for row in rows if row[0] == "/robot_0/odometry")
        assert 20 < rate < 60
        assert (await run("services", *at))[1].splitlines()[-1].split() == ["/trigger", "std_srvs/Trigger", "/robot_0"]
        assert "/rosapi/topics" in (await run("services", "--all", "--json", *at))[1]
        assert (await run("robots", *at))[1].splitlines()[1].startswith("robot_0  1     nobody")
        assert (await run("links", "--ended", *at))[1].splitlines()[1].split()[:3] == [
            "1",
            "127.0.0.1:" + peer(host),
            "robot_0",
        ]
        assert (await run("clients", *at))[1].splitlines()[1].split()[2] == "rosbridge"
        for words in (["topics", "-v"], ["services"], ["robots"], ["links"], ["clients"]):
            assert json.loads((await run(*words, "--json", *at))[1])


def peer(host: Daemon) -> str:
    return host.hub.links.all()[0].peer.rpartition(":")[2]


async def test_an_empty_daemon_says_what_to_do() -> None:
    async with daemon() as host:
        for words in (["topics"], ["robots"], ["links"], ["lock"]):
            _, out, err = await run(*words, "--url", host.url)
            assert out == "" or words == ["topics"]
            assert words == ["topics"] or "`hostlink doctor` finds out why" in err


async def test_stop_lock_and_unlock() -> None:
    topics = [*robot_topics("mule")]
    async with daemon() as host, fake_device(host.tcp, robot_topics()), fake_device(host.tcp, topics):
        at = ("--url", host.url)
        unknown = "it is not known whether it is stopped: it sends no odometry\n"
        assert await run("stop", *at) == (1, f"mule: {unknown}robot_0: {unknown}", "")
        assert await run("stop", "mull", "--all", *at) == (1, f"mule: {unknown}robot_0: {unknown}", "")
        assert await run("stop", "/mule", *at) == (1, f"mule: {unknown}", "")
        locked = f"mule is locked: my foot\nmule: {unknown}"
        assert await run("lock", "mule", "--reason", "my foot", *at) == (0, locked, "")
        assert [robot.gate.lock_reason for robot in host.hub.robots.all()] == ["my foot", None]
        assert await run("unlock", *at) == (0, "mule may be driven\n", "")
        assert await run("unlock", *at) == (1, "", "hostlink: no robot is locked; `hostlink robots` lists them\n")
        await run("lock", "--all", *at)
        status, _, err = await run("unlock", *at)
        assert (status, "several robots are locked: mule, robot_0;" in err) == (1, True)
        both = "robot_0 may be driven\nmule may be driven\n"
        assert await run("unlock", "robot_0", "mule", *at) == (0, both, "")
        assert await run("stop", "robot_0", "mule", *at) == (1, f"mule: {unknown}robot_0: {unknown}", "")
        status, out, err = await run("lock", "mull", "robot_0", "mule", *at)
        assert (status, "there is no robot named mull; similar names: mule" in err) == (1, True)
        assert "mule is locked" in out
        assert all(robot.gate.lock_reason is not None for robot in host.hub.robots.all())
        everything = "mule may be driven\nrobot_0 may be driven\nboards that are not robots may be driven\n"
        assert (await run("unlock", "--all", *at))[1] == everything
        assert (await run("lock", "mull", *at))[2] == (
            "hostlink: there is no robot named mull; similar names: mule; `hostlink robots` lists them; "
            "`hostlink lock` locks every robot\n"
        )
        assert all(robot.gate.lock_reason is None for robot in host.hub.robots.all())
        assert (await run("lock", "all", *at))[::2] == (0, "")
        assert all(robot.gate.lock_reason is not None for robot in host.hub.robots.all())
        assert (await run("stop", "*", *at))[1:] == (f"mule: {unknown}robot_0: {unknown}", "")
        assert await run("unlock", "all", *at) == (0, everything, "")
        status, out, err = await run("lock", "mull", "", "mule", "robot_1", *at)
        assert (status, out) == (1, f"mule is locked: a lock from the terminal\nmule: {unknown}")
        mull, empty, robot_1 = err.splitlines()
        assert "named mull;" in mull
        assert "a name is empty" in empty
        assert "named robot_1;" in robot_1
        assert await run("stop", "", "--all", *at) == (1, f"mule: {unknown}robot_0: {unknown}", "")
        assert (await run("stop", "", *at))[:2] == (2, "")


async def test_parameters_are_set_saved_and_loaded(tmp_path: Path) -> None:
    file = tmp_path / "parameters.json"
    async with daemon() as host:
        at = ("--url", host.url)
        for name, value in (("/gain", "1.5"), ("/pid/kp", "[1, 2]"), ("/name", "left")):
            assert (await run("params", "set", name, value, *at))[0] == 0
        assert await run("params", "list", *at) == (
            0, 'parameter  value\n/gain      1.5\n/name      "left"\n/pid/kp    [1, 2]\n', ""
        )  # fmt: skip
        assert (await run("params", "list", "/pid", *at))[1].splitlines()[1:] == ["/pid/kp    [1, 2]"]
        assert (await run("params", "list", "none", *at))[2] == (
            "there are no parameters in /none; `hostlink params list` lists all\n"
        )
        assert (await run("params", "get", "/pid", *at))[1] == '{"kp": [1, 2]}\n'
        assert (await run("params", "dump", str(file), *at))[2] == f"3 parameters in {file}\n"
        assert (await run("params", "delete", "/pid", *at))[0] == 0
        assert "similar names: /pid/kp" not in (await run("params", "get", "/pid/kp", *at))[2]
        assert (await run("params", "load", str(file), *at))[2] == "3 parameters set\n"
        status, out, err = await run("params", "list", "--json", *at)
        assert (status, err) == (0, "")
        assert json.loads(out)["/pid/kp"] == [1, 2]
        (tmp_path / "hostlink.toml").write_text("[parameters]\ngain = 2.5\n")
        assert (await run("params", "load", str(tmp_path / "hostlink.toml"), *at))[2] == "1 parameter set\n"
        assert (await run("params", "get", "gain", *at))[1] == "2.5\n"


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["dump", "none/file"], "none/file cannot be written"),
        (["load", "none"], "none cannot be read: No such file"),
        (["load", "list.json"], "has no parameters"),
        (["load", "broken.json"], "broken.json is neither JSON nor TOML: Expecting"),
    ],
)
async def test_param_load_with_a_file_that_is_not_one_of_parameters_says_so(
    tmp_path: Path, words: list[str], complaint: str
) -> None:
    (tmp_path / "list.json").write_text("[1]")
    (tmp_path / "broken.json").write_text("{")
    async with daemon() as host:
        status, out, err = await run("params", words[0], str(tmp_path / words[1]), "--url", host.url)
    assert (status, out, len(err.splitlines())) == (2, "", 1)
    assert complaint in err


async def test_commands_of_ros_have_their_effect(tmp_path: Path) -> None:
    async with publishing() as (host, device):
        url = {"HOSTLINK_URL": host.url}

        async def ros(*words: str) -> str:
            status, out, err = await run(*words, environment=url)
            assert status == 0, err
            return out

        assert await ros("rostopic", "echo", "-n", "2", "/robot_0/odometry/theta") == "0.5\n0.5\n"
        twist = ("/robot_0/velocity_commands", "geometry_msgs/Twist", "--", "[0.1, 0, 0]", "[0, 0, 0.2]")
        await ros("rostopic", "pub", "-r", "10", "-1", *twist)
        assert await device.velocity_other_than((0.0, 0.0)) == (0.1, 0.2)
        await ros("rosparam", "set", "/gain", "-1.5")
        assert await ros("param", "get", "/gain") == "-1.5\n"
        shown = await ros("rossrv", "show", "std_srvs/SetBool")
        assert shown.split("\n  ---\n") == ["std_srvs/SetBool\n  bool data", "  bool success\n  string message\n"]
        file = str(tmp_path / "run.mcap")
        await ros("rosbag", "record", "-a", "-O", file, "--duration=0.2")
        assert "/robot_0/odometry" in await ros("ros2", "bag", "info", file)


async def test_record_adds_the_slash_of_a_name_and_reports_an_unknown_topic(tmp_path: Path) -> None:
    file = str(tmp_path / "run.mcap")
    async with publishing() as (host, _):
        at = ("--seconds", "0.2", "--url", host.url)
        _, out, err = await run("record", "-o", file, "robot_0/odometry", "/robot_0/odometrie", "*/odometry", *at)
    assert " 0 messages " not in out
    assert err.startswith("there is no topic /robot_0/odometrie yet; similar names: /robot_0/odometry, ")
    assert err.splitlines()[1].startswith("recording ")
    assert "/robot_0/odometry " in (await run("info", file))[1]


@pytest.mark.parametrize(
    ("line", "complaint"),
    [
        (
            ["pub", "/new", "data: hi"],
            "/new has no type yet, because it has no publisher; name the type of a new topic, as in `hostlink pub /new "
            "std_msgs/String 'data: hello'`",
        ),
        (
            ["pub", "/new", "std_msgs/Strin", "data: hi"],
            "there is no message type named std_msgs/Strin; similar names: std_msgs/String, ",
        ),
        (["pub", "/new", "std_srvs/Trigger"], "there is no message type named std_srvs/Trigger; "),
        (
            ["call", "/new", "std_srvs/Triger"],
            "there is no service type named std_srvs/Triger; similar names: std_srvs",
        ),
        (
            ["type", "std_msgs/Strin"],
            "there is no topic, service or type named std_msgs/Strin; similar names: std_msgs/S",
        ),
    ],
)
async def test_wrong_type_of_a_message_is_refused_with_the_similar_ones(line: list[str], complaint: str) -> None:
    async with daemon() as host:
        status, out, err = await run(*line, "--url", host.url)
    assert (status, out, err.count("\n")) == (1, "", 1)
    assert err.startswith(f"hostlink: {complaint}")


async def test_an_empty_message_needs_no_text() -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device:
        assert await run("pub", "/robot_0/reset_odometry", "--url", host.url) == (0, "", "1 sent\n")
        status, _, err = await run("pub", "/cmd_vel", "geometry_msgs/Twist", "linear: {x: 0.1}", "--url", host.url)
        told, sent = err.splitlines()
        assert (status, sent) == (0, "1 sent")
        assert "robots listen on: /robot_0/cmd_vel, /robot_0/velocity_commands;" in told
        assert await device.frame(101) == b""


async def test_ctrl_c_ends_a_measurement_with_its_summary() -> None:
    async with publishing() as (host, _), screen() as terminal:
        await terminal.keys(f"{HOSTLINK} hz /robot_0/odometry --url {host.url}; echo status $?", "Enter")
        await terminal.shows(" Hz   every ")
        await terminal.keys("C-c")
        shown = await terminal.shows("status 0")
        assert " messages in " in shown
        assert "Traceback" not in shown


@pytest.mark.parametrize("words", [["--version"], ["-m"]])
async def test_version_option_prints_the_version(words: list[str]) -> None:
    if words == ["-m"]:
        child = await asyncio.create_subprocess_exec(
            str(Path(HOSTLINK).parent / "python"), "-m", "hostlink", "--version", stdout=asyncio.subprocess.PIPE
        )
        out = (await child.communicate())[0].decode()
    else:
        out = (await run(*words))[1]
    assert out == f"hostlink {importlib.metadata.version('hostlink')}\n"


async def test_bash_completes_commands_options_and_topics(tmp_path: Path) -> None:
    async with publishing() as (host, _), screen() as terminal:
        folder = Path(HOSTLINK).parent
        await terminal.keys(f"export HOME={tmp_path} PATH={folder}:$PATH HOSTLINK_URL={host.url}", "Enter")
        await terminal.keys("hostlink --install-completion bash && source ~/.bashrc && clear && echo ready", "Enter")
        await terminal.shows("ready")
        await terminal.keys("hostlink tele", "Tab")
        await terminal.shows("hostlink teleop")
        await terminal.keys("C-u", "hostlink echo --thr", "Tab")
        await terminal.shows("--throttle-ms")
        await terminal.keys("C-u", "hostlink ros2 topic echo /robot_0/vel", "Tab")
        await terminal.shows("ros2 topic echo /robot_0/velocity_commands")
        await terminal.keys("C-u", "hostlink echo /robot_0/vel", "Tab")
        await terminal.shows("/robot_0/velocity_commands")


@pytest.mark.parametrize("shell", ["zsh", "fish"])
async def test_other_shells_get_the_same_names(shell: str) -> None:
    """Complete by the protocol of the other shells' scripts."""
    async with publishing() as (host, _):
        action = {"_TYPER_COMPLETE_FISH_ACTION": "get-args"} if shell == "fish" else {}
        words = {"_HOSTLINK_COMPLETE": f"complete_{shell}", "_TYPER_COMPLETE_ARGS": "hostlink echo /robot_0/od"}
        _, out, _ = await run(environment={**words, **action, "HOSTLINK_URL": host.url})
    assert "/robot_0/odometry" in out


async def test_a_name_that_a_shell_would_run_is_not_completed() -> None:
    names = ["/robot_0/odom$(reboot)", "/robot_0/odom;reboot", "/robot_0/odom`x`", "/robot_0/odom'"]
    topics = [topic(EndpointKind.PUBLISHER, 130 + number, name, "std_msgs/Bool") for number, name in enumerate(names)]
    async with daemon() as host, fake_device(host.tcp, [*robot_topics(), *topics]):
        _, listed, _ = await run("topics", "--url", host.url)
        assert all(name in listed for name in names)
        words = {"_HOSTLINK_COMPLETE": "complete_bash", "COMP_WORDS": "hostlink echo /robot_0/odom", "COMP_CWORD": "2"}
        out = ""
        async with asyncio.timeout(TIMEOUT_S):
            while not out:  # a completion does not wait for a daemon on a busy machine
                _, out, _ = await run(environment={**words, "HOSTLINK_URL": host.url})
    assert out.split() == ["/robot_0/odom", "/robot_0/odometry"]


async def test_a_daemon_that_does_not_answer_is_waited_for_visibly() -> None:
    async with asyncio.timeout(TIMEOUT_S), screen() as terminal, tcp_server(say_nothing) as (_, port):
        await terminal.keys(f"{HOSTLINK} topics --url http://127.0.0.1:{port}", "Enter")
        await terminal.shows(f"connecting to http://127.0.0.1:{port} ... ")
        shown = await terminal.shows(f"hostlink: no hostlink at http://127.0.0.1:{port}: no answer within 5 s")
        assert "connecting" not in shown
