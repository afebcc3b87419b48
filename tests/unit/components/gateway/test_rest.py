"""The REST API without a socket: views of a robot, commands, and the status and kind of each error."""

import asyncio
import json
import struct
from collections.abc import Awaitable, Callable

import pytest

from hostlink.components.gateway.bodies import convert_velocity
from hostlink.components.gateway.rest import MAX_OWNERS, Owners, VelocityRequest
from hostlink.components.gateway.rosbridge import DriveOperation
from hostlink.core.config import Config
from hostlink.core.hub.hub import Hub
from hostlink.core.hub.node import Role
from hostlink.core.protocol.endpoint import EndpointKind
from hostlink.core.robot.command_endpoint import CommandEndpoint
from hostlink.core.robot.views import RobotView
from hostlink.errors import BadRequest, DeviceGone
from tests.support.fake_device import CATALOG, topic
from tests.support.hosts import host_in
from tests.support.participants import VELOCITY_ID
from tests.support.remote_robots import RecordingHosts, reach
from tests.support.rest_memory import RestMemory, rest_memory
from tests.support.scripted_device import ScriptedDevice
from tests.support.virtual_loop import run_virtual

VELOCITY = "/api/robots/robot_0/velocity"
RESET_ID = 101


def check(test: Callable[[RestMemory], Awaitable[None]]) -> None:
    async def run() -> None:
        async with rest_memory() as api:
            await test(api)

    run_virtual(run())


def speeds(api: RestMemory) -> list[tuple[float, float, float]]:
    """The velocities that the device received: forward, to the left, turn."""
    found = [struct.unpack("<6d", payload) for payload in api.device.payloads(VELOCITY_ID)]
    return [(each[0], each[1], each[5]) for each in found]


def test_robots_are_listed_with_their_state() -> None:
    async def test(api: RestMemory) -> None:
        await api.move_to(1.0, 2.0, 0.5)
        status, body = await api.call("GET", "/api/robots")
        (robot,) = body["robots"]
        assert (status, robot["name"], robot["connected"]) == (200, "robot_0", True)
        assert robot.keys() == RobotView.__annotations__.keys()
        assert robot == (await api.call("GET", "/api/robots/robot_0"))[1]

    check(test)


def test_odometry_has_pose_age_and_count() -> None:
    async def test(api: RestMemory) -> None:
        await api.move_to(1.0, 2.0, 0.5)
        status, body = await api.call("GET", "/api/robots/robot_0/odometry")
        assert status == 200
        assert body["pose"] == {"x_m": 1.0, "y_m": 2.0, "theta_rad": 0.5}
        assert body["twist"] == {"linear_m_s": 0.0, "linear_y_m_s": 0.0, "angular_rad_s": 0.0}
        assert (body["count"], body["age_s"], body["restarts"], body["ignored"]) == (1, 0.05, 0, 0)

    check(test)


def test_velocity_reaches_the_device_and_is_answered() -> None:
    async def test(api: RestMemory) -> None:
        status, body = await api.call("PUT", VELOCITY, {"linear": 0.2, "angular": 0.5})
        await api.move_to(0, 0, 0)
        assert (status, body["is_limited"], body["limited_by"]) == (200, False, None)
        assert body["velocity"] == {"linear_m_s": 0.2, "linear_y_m_s": 0.0, "angular_rad_s": 0.5}
        assert body["lease_s"] == 0.5
        assert speeds(api)[-1] == (0.2, 0.0, 0.5)
        assert api.hub.robots.find("robot_0").gate.priority == 50

    check(test)


def test_velocity_over_a_limit_names_the_setting() -> None:
    async def test(api: RestMemory) -> None:
        _, body = await api.call("PUT", VELOCITY, {"linear": 9.0, "angular": 0.0, "priority": 7})
        assert (body["is_limited"], body["limited_by"]) == (True, "max_linear_m_s")
        assert body["velocity"]["linear_m_s"] < 9.0
        assert api.hub.robots.find("robot_0").gate.priority == 7

    check(test)


def test_stop_sends_zero_and_reports_standstill() -> None:
    async def test(api: RestMemory) -> None:
        await api.call("PUT", VELOCITY, {"linear": 0.2, "angular": 0.0})
        await api.move_to(0, 0, 0)
        assert speeds(api)[-1][0] == 0.2
        status, body = await api.call("POST", "/api/robots/robot_0/stop?wait_s=0.2")
        assert (status, body["standstill"]["state"]) == (200, "unknown")
        assert speeds(api)[-1] == (0.0, 0.0, 0.0)
        status, body = await api.call("PUT", VELOCITY, {"linear": 0.2, "angular": 0.0})
        assert (status, body["error"]["kind"]) == (409, "disarmed")
        assert "a stop by program (phone)" in body["error"]["reason"]

    check(test)


def test_stop_with_an_invalid_wait_is_refused_and_stops_the_robot() -> None:
    async def test(api: RestMemory) -> None:
        await api.call("PUT", VELOCITY, {"linear": 0.2, "angular": 0.0})
        status, body = await api.call("POST", "/api/robots/robot_0/stop?wait_s=soon")
        assert (status, body["error"]["kind"]) == (400, "BadRequest")
        await asyncio.sleep(0.05)
        assert speeds(api)[-1] == (0.0, 0.0, 0.0)

    check(test)


def test_stop_of_all_sends_zero_and_lists_every_robot() -> None:
    async def test(api: RestMemory) -> None:
        await api.call("PUT", VELOCITY, {"linear": 0.2, "angular": 0.0})
        status, body = await api.call("POST", "/api/stop?wait_s=0", role=Role.READ)
        await api.move_to(0, 0, 0)
        assert (status, [robot["name"] for robot in body["robots"]]) == (200, ["robot_0"])
        assert speeds(api)[-1] == (0.0, 0.0, 0.0)

    check(test)


@pytest.mark.parametrize("path", ["/api/stop", "/api/lock", "/api/robots/bad/stop", "/api/robots/bad/lock"])
def test_zero_that_does_not_fit_one_robot_is_an_error_whose_answer_has_all_the_others(path: str) -> None:
    infos = [
        topic(EndpointKind.SUBSCRIBER, 100, "/bad/cmd_vel", "geometry_msgs/TwistStamped", buffer_bytes=70),
        topic(EndpointKind.SUBSCRIBER, 101, "left_motor", "std_msgs/Int16"),
    ]

    async def test(api: RestMemory) -> None:
        bad = ScriptedDevice(api.hub, infos, address="10.0.0.9")
        await asyncio.sleep(0.1)
        await api.call("PUT", VELOCITY, {"linear": 0.2, "angular": 0.0})
        status, body = await api.call("POST", f"{path}?wait_s=0")
        reason = "/bad/cmd_vel: frame of 85 bytes, the device takes 70"
        assert (status, body["error"]) == (413, {"kind": "FrameTooLarge", "reason": reason})
        assert [(each["topic"], each["is_zero_sent"]) for each in body["endpoints"]] == [("/left_motor", True)]
        await asyncio.sleep(0.05)
        assert bad.payloads(101) == [bytes(2)]
        if "robots" in path:
            assert (body["name"], body["unreachable"], body["locked"]) == ("bad", reason, path.endswith("lock"))
        else:
            robots = {each["name"]: (each["unreachable"], each["locked"]) for each in body["robots"]}
            assert robots == {"bad": (reason, path.endswith("lock")), "robot_0": (None, path.endswith("lock"))}
            assert speeds(api)[-1] == (0.0, 0.0, 0.0)

    check(test)


@pytest.mark.parametrize("path", ["/api/stop", "/api/lock"])
def test_daemon_that_does_not_answer_a_stop_is_an_error_whose_answer_has_every_robot(path: str) -> None:
    class Silent(RecordingHosts):
        async def settled(self) -> list[CommandEndpoint]:
            raise DeviceGone("lab", "lab has not answered")

    async def test(api: RestMemory) -> None:
        reach(api.hub, Silent())
        status, body = await api.call("POST", f"{path}?wait_s=0")
        assert (status, body["error"]["kind"]) == (503, "DeviceGone")
        assert ([each["name"] for each in body["robots"]], body["endpoints"]) == (["robot_0"], [])

    check(test)


def test_lock_holds_with_its_reason_until_unlock() -> None:
    async def test(api: RestMemory) -> None:
        lock = "/api/robots/robot_0/lock?wait_s=0"
        status, body = await api.call("POST", lock, {"reason": "a hand in the wheel"})
        assert status == 200
        status, body = await api.call("PUT", VELOCITY, {"linear": 0.2, "angular": 0.0})
        assert (status, body["error"]["kind"]) == (409, "locked")
        assert "a hand in the wheel" in body["error"]["reason"]
        assert api.hub.robots.find("robot_0").admission.locked_by == "program (phone)"
        assert (await api.call("POST", "/api/robots/robot_0/unlock"))[0] == 200
        status, _ = await api.call("PUT", VELOCITY, {"linear": 0.2, "angular": 0.0}, who="another")
        assert status == 200

    check(test)


def test_lock_with_a_wrong_reason_is_refused_and_holds() -> None:
    async def test(api: RestMemory) -> None:
        status, _ = await api.call("POST", "/api/robots/robot_0/lock?wait_s=0", {"reason": 7})
        assert status == 400
        assert api.hub.robots.find("robot_0").admission.lock_reason is not None

    check(test)


def test_lock_without_a_body_holds() -> None:
    async def test(api: RestMemory) -> None:
        assert (await api.call("POST", "/api/robots/robot_0/lock?wait_s=0"))[0] == 200
        assert api.hub.robots.find("robot_0").admission.lock_reason is not None

    check(test)


def test_reset_of_odometry_is_published_to_the_device() -> None:
    async def test(api: RestMemory) -> None:
        status, body = await api.call("POST", "/api/robots/robot_0/odometry/reset")
        await api.move_to(0, 0, 0)
        assert (status, body) == (200, {"reset": "/robot_0/reset_odometry"})
        assert api.device.payloads(RESET_ID) == [b""]

    check(test)


@pytest.mark.parametrize(
    ("method", "path", "body", "status", "kind"),
    [
        ("GET", "/api/robots/nobody", b"", 404, "UnknownTopic"),
        ("GET", "/api/robots/robot_0/odometry", b"", 503, "DeviceGone"),
        ("PUT", "/api/robots/nobody/velocity", b'{"linear": 0, "angular": 0}', 404, "UnknownTopic"),
        ("PUT", VELOCITY, b"", 400, "BadRequest"),
        ("PUT", VELOCITY, b'{"priority": 1}', 400, "BadRequest"),
        ("PUT", VELOCITY, b'{"linear": 0.1, "angular": 0, "lateral": 1}', 400, "BadRequest"),
        ("PUT", VELOCITY, b'{"linear": "fast", "angular": 0}', 400, "BadRequest"),
        ("PUT", VELOCITY, b'{"linear": NaN, "angular": 0}', 400, "BadRequest"),
        ("PUT", VELOCITY, b"[" * 1024, 400, "BadRequest"),
        ("PUT", VELOCITY, b"\xff\xfe", 400, "BadRequest"),
        ("PUT", VELOCITY, b'{"linear": 1e999, "angular": 0}', 400, "BadRequest"),
        ("PUT", VELOCITY, b'{"linear": 0, "angular": 0, "priority": 101}', 400, "BadRequest"),
        ("PUT", VELOCITY, b'{"linear": 0, "angular": 0, "priority": -1}', 400, "BadRequest"),
        ("POST", "/api/robots/robot_0/lock", b'{"reason": 7}', 400, "BadRequest"),
        ("POST", "/api/robots/robot_0/stop?wait_s=11", b"", 400, "BadRequest"),
        ("POST", "/api/robots/robot_0/stop?wait_s=soon", b"", 400, "BadRequest"),
        ("POST", "/api/stop?wait_s=-1", b"", 400, "BadRequest"),
        ("POST", "/api/robots/nobody/stop", b"", 404, "UnknownTopic"),
        ("POST", "/api/robots/nobody/lock", b"", 404, "UnknownTopic"),
        ("POST", "/api/robots/nobody/unlock", b"", 404, "UnknownTopic"),
        ("GET", "/api/nothing", b"", 404, "HTTP"),
        ("DELETE", "/api/robots", b"", 405, "HTTP"),
    ],
)
def test_error_has_status_kind_and_reason(method: str, path: str, body: bytes, status: int, kind: str) -> None:
    async def test(api: RestMemory) -> None:
        got, error = await api.call(method, path, body)
        assert (got, error["error"]["kind"]) == (status, kind)
        assert error["error"]["reason"]

    check(test)


def test_token_with_role_read_does_not_drive() -> None:
    async def test(api: RestMemory) -> None:
        status, body = await api.call("PUT", VELOCITY, {"linear": 0.2, "angular": 0.0}, role=Role.READ)
        assert (status, body["error"]["kind"]) == (403, "NoRole")

    check(test)


def test_robot_whose_device_left_is_known_and_cannot_be_driven() -> None:
    async def test(api: RestMemory) -> None:
        assert (await api.call("GET", "/readyz"))[1] == {"status": "ready"}
        await api.device.aclose()
        await asyncio.sleep(0.5)
        status, body = await api.call("PUT", VELOCITY, {"linear": 0.1, "angular": 0.0})
        assert (status, body["error"]["kind"]) == (503, "not_connected")
        assert (await api.call("POST", "/api/robots/robot_0/odometry/reset"))[0] == 503
        assert (await api.call("GET", "/api/robots/robot_0"))[1]["connected"] is False
        status, body = await api.call("GET", "/readyz")
        assert (status, body["error"]) == (503, {"kind": "NotReady", "reason": "not connected: robot_0"})

    check(test)


def test_links_topics_clients_and_health_are_shown() -> None:
    async def test(api: RestMemory) -> None:
        (link,) = (await api.call("GET", "/api/links"))[1]["links"]
        assert link["robot"] == "robot_0"
        assert {"/robot_0/odometry", "/robot_0/velocity_commands"} <= {each["name"] for each in link["topics"]}
        topics = {each["name"]: each for each in (await api.call("GET", "/api/topics"))[1]["topics"]}
        assert topics["/robot_0/odometry"]["type"] == "geometry_msgs/Pose2D"
        assert topics["/robot_0/odometry"]["publishers"] == 1
        assert (topics["/robot_0/odometry"]["is_derived"], topics["/robot_0/odom"]["is_derived"]) == (False, True)
        assert (await api.call("GET", "/api/clients"))[1] == {"clients": [], "refused": 0}
        assert (await api.call("GET", "/healthz"))[1]["status"] == "alive"

    check(test)


def test_owners_are_bounded_and_a_removed_one_stops_its_robot() -> None:
    async def test(api: RestMemory) -> None:
        await api.call("PUT", VELOCITY, {"linear": 0.2, "angular": 0.0}, who="first")
        first = api.owners.of("first", Role.DRIVE)
        for number in range(MAX_OWNERS - 1):
            api.owners.of(str(number), Role.DRIVE)
        assert (len(api.owners), api.owners.evicted, first.has_left) == (MAX_OWNERS, 0, False)
        api.owners.of("one more", Role.DRIVE)
        assert (len(api.owners), api.owners.evicted, first.has_left) == (MAX_OWNERS, 1, True)
        assert api.hub.robots.find("robot_0").gate.owner is None

    check(test)


async def test_owner_is_the_same_until_its_token_is_revoked() -> None:
    owners = Owners(host_in(Hub(Config(), CATALOG, reraises=True)))
    one = owners.of("phone", Role.DRIVE)
    assert owners.of("phone", Role.DRIVE) is one
    assert len(owners) == 1
    owners.end(["phone", "unknown"])
    assert one.has_left
    assert owners.of("phone", Role.DRIVE) is not one


@pytest.mark.parametrize(
    ("body", "problem"),
    [
        (b'{"linear": 0.2, "angular": 0.5, "priorty": 7}', "unknown field `priorty`; did you mean `priority`?"),
        (
            b'{"linear": 0.2, "angular": 0.5, "colour": 7}',
            "unknown field `colour`; its fields: linear, angular, priority, epoch, take_over",
        ),
    ],
)
def test_unknown_field_of_a_body_is_refused_with_the_nearest_name(body: bytes, problem: str) -> None:
    with pytest.raises(BadRequest) as caught:
        convert_velocity(json.loads(body), VelocityRequest, "the body must be a velocity")
    assert str(caught.value).endswith(problem)


@pytest.mark.parametrize(
    ("fields", "velocity"),
    [
        ({"linear": 0.1}, (0.1, 0.0, 0.0)),
        ({"angular": 0.5}, (0.0, 0.0, 0.5)),
        ({"linear_m_s": 0.1, "linear_y_m_s": 0.2, "angular_rad_s": 0.5}, (0.1, 0.2, 0.5)),
        ({"linear": 0.1, "linear_y": 0.2, "angular_rad_s": 0.5}, (0.1, 0.2, 0.5)),
    ],
)
@pytest.mark.parametrize("type_", [VelocityRequest, DriveOperation])
def test_velocity_is_accepted_by_its_names_and_by_those_of_an_answer(
    type_: type[VelocityRequest | DriveOperation], fields: dict[str, float], velocity: tuple[float, float, float]
) -> None:
    robot = {"robot": "robot_0"} if type_ is DriveOperation else {}
    found = convert_velocity({**robot, **fields}, type_, "drive")
    assert (found.linear, found.linear_y, found.angular) == velocity


@pytest.mark.parametrize(
    ("fields", "problem"),
    [
        ({}, "drive: linear (m/s) or angular (rad/s) is missing"),
        ({"linear": 0.1, "linear_m_s": 0.2}, "drive: linear_m_s and linear are one number: send one of them"),
        ({"linear": 0.1, "linear_x": 0.2}, "drive: Object contains unknown field `linear_x`; did you mean `linear`?"),
        ({"linear_m": 0.1}, "drive: Object contains unknown field `linear_m`; did you mean `linear`?"),
    ],
)
def test_velocity_without_a_number_or_with_one_twice_is_refused(fields: dict[str, float], problem: str) -> None:
    with pytest.raises(BadRequest) as caught:
        convert_velocity(fields, VelocityRequest, "drive")
    assert str(caught.value) == problem


@pytest.mark.parametrize(
    ("fields", "problem"),
    [
        ({"lineary": 1.0}, "drive: Object contains unknown field `lineary`; did you mean `linear`?"),
        ({"angular": "fast"}, "drive: Expected `float`, got `str` - at `$.angular`"),
        ({"robot": 7}, "drive: Expected `str`, got `int` - at `$.robot`"),
    ],
)
def test_unknown_field_of_a_drive_is_refused_as_one_of_a_body(fields: dict[str, object], problem: str) -> None:
    drive = {"op": "drive", "id": 1, "robot": "robot_0", "linear": 0.1, "angular": 0.0}
    assert convert_velocity(drive, DriveOperation, "drive").linear == 0.1
    with pytest.raises(BadRequest) as caught:
        convert_velocity(drive | fields, DriveOperation, "drive")
    assert str(caught.value) == problem


def test_odometry_of_nan_alone_is_answered_with_their_number() -> None:
    async def test(api: RestMemory) -> None:
        for _ in range(10):
            await api.move_to(float("nan"), 0.0, 0.0)
        status, body = await api.call("GET", "/api/robots/robot_0/odometry")
        assert status == 503
        assert body["error"]["reason"] == "robot_0: it sent 10 poses with NaN or infinity in the last 30 s"

    check(test)
