"""Catalog: md5 sums, full definitions, the user's folders and their errors."""

import re
from pathlib import Path

import pytest
from rosbags.typesys import Stores, get_typestore

from hostlink.core.messages.catalog import Catalog, decode_clock, read_full_definition, to_time
from hostlink.core.messages.fields import Constant
from hostlink.core.messages.message_type import MessageType, ServiceType
from hostlink.errors import ConfigError, WrongType

AN_EMPTY_ONE = re.compile(r"(^MSG: \S+\n)(?==|\Z)", re.MULTILINE)
STORE = get_typestore(Stores.ROS1_NOETIC)
STORE_NAMES = sorted(name.replace("/msg/", "/") for name in STORE.fielddefs if not name.startswith("builtin"))

SET_BOOL_REQUEST = "8b94c1b53db61fb6aed406028ad6332a"
SET_BOOL_RESPONSE = "937c9679a518e3a18d831e57125ea522"
TWO_INTS, ONE_INT = "36d09b846be0b371c5f190354dd3153e", "b88405221c77b1878a3cbbfff53428d7"
TEST_INPUT, TEST_OUTPUT = "39e92f1778057359c64c7b8a7d7b19de", "0825d95fdfa2c8f4bbb4e9c74bccd3fd"
EMPTY = "d41d8cd98f00b204e9800998ecf8427e"


@pytest.fixture(scope="module")
def catalog() -> Catalog:
    return Catalog()


def message(catalog: Catalog, name: str) -> MessageType:
    found = catalog.message(name)
    assert found is not None
    return found


def service(catalog: Catalog, name: str) -> ServiceType:
    found = catalog.service(name)
    assert found is not None
    return found


def write(folder: Path, **files: str) -> Path:
    """Write definitions of a package "robot" into the folder; "msg_Type" and "srv_Type" name kind and type."""
    for name, text in files.items():
        kind, _, stem = name.partition("_")
        path = folder / "robot" / kind / f"{stem}.{kind}"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return folder


def test_every_stored_type_has_the_md5_and_the_text_of_the_store(catalog: Catalog) -> None:
    assert len(STORE_NAMES) == 162
    for name in STORE_NAMES:
        ours = message(catalog, name)
        text, md5 = STORE.generate_msgdef(name.replace("/", "/msg/"))
        assert ours.md5 == md5
        assert ours.full_definition == AN_EMPTY_ONE.sub(
            r"\1\n", text
        )  # rospy cannot read an empty definition without its line


def test_nested_empty_type_becomes_an_empty_line(catalog: Catalog) -> None:
    ours = message(catalog, "nav_msgs/GetMapAction")
    assert "MSG: nav_msgs/GetMapGoal\n\n====" in ours.full_definition
    assert read_full_definition(ours.name, ours.full_definition).md5 == ours.md5


def test_every_stored_type_compiles_and_its_defaults_come_back(catalog: Catalog) -> None:
    for name in STORE_NAMES:
        ours = message(catalog, name)
        payload = ours.encode({})
        assert payload == bytes(ours.layout.minimum_bytes)
        assert ours.encode(ours.decode(payload)) == payload


@pytest.mark.parametrize(
    ("name", "md5"),
    [
        ("ackermann_msgs/AckermannDrive", "3512e91b48d69674a0e86fadf1ea8231"),
        ("ackermann_msgs/AckermannDriveStamped", "1fd5d7f58889cefd44d29f6653240d0c"),
        ("geometry_msgs/Pose2D", "938fa65709584ad8e77d238529be13b8"),
        ("geometry_msgs/Twist", "9f195f881246fdfa2798d1d3eebca84a"),
        ("geometry_msgs/Vector3", "4a842b65f413084dc2b10fb484ea7f17"),
        ("nav_msgs/Odometry", "cd5e73d190d741a2f92e81eda573aca7"),
        ("rospy_tutorials/Floats", "420cd38b6b071cd49f2970c3e2cee511"),
        ("rospy_tutorials/HeaderString", "c99a9440709e4d4a9716d55b8270d5e7"),
        ("rosserial_arduino/Adc", "6d7853a614e2e821319068311f2af25b"),
        ("rosserial_mbed/Adc", "6d7853a614e2e821319068311f2af25b"),
        ("rosserial_msgs/Log", "11abd731c25933261cd6183bd12d6295"),
        ("rosserial_msgs/TopicInfo", "0ad51f88fc44892f8c10684077646005"),
        ("rosserial_tivac_tutorials/Buttons", "a78ccaade8fa723d1ebeb7b099042085"),
        ("sensor_msgs/JointState", "3066dcd76a6cfaef579bd0f34173e9fd"),
        ("sensor_msgs/LaserScan", "90c7ef2dc6895d81024acba2ac42f369"),
        ("std_msgs/Empty", EMPTY),
        ("std_msgs/Float32MultiArray", "6a40e0ffa6a17a503ac3f8616991b1f6"),
        ("std_msgs/String", "992ce8a1687cec8c8bd883ec73ca41d1"),
    ],
)
def test_md5_sums_equal_those_of_real_devices(catalog: Catalog, name: str, md5: str) -> None:
    assert message(catalog, name).md5 == md5


@pytest.mark.parametrize(
    ("name", "md5", "request_md5", "response_md5"),
    [
        (
            "diagnostic_msgs/SelfTest",
            "ac21b1bab7ab17546986536c22eb34e9",
            EMPTY,
            "ac21b1bab7ab17546986536c22eb34e9",
        ),
        ("nav_msgs/GetMap", "6cdd0a18e0aff5b0a3ca2326a89b54ff", EMPTY, "6cdd0a18e0aff5b0a3ca2326a89b54ff"),
        (
            "nav_msgs/GetPlan",
            "421c8ea4d21c6c9db7054b4bbdf1e024",
            "e25a43e0752bcca599a8c2eef8282df8",
            "0002bc113c0259d71f6cf8cbc9430e18",
        ),
        ("roscpp/Empty", EMPTY, EMPTY, EMPTY),
        ("roscpp/GetLoggers", "32e97e85527d4678a8f9279894bb64b0", EMPTY, "32e97e85527d4678a8f9279894bb64b0"),
        ("roscpp/SetLoggerLevel", "51da076440d78ca1684d36c868df61ea", "51da076440d78ca1684d36c868df61ea", EMPTY),
        ("roscpp_tutorials/TwoInts", "6a2e34150c00229791cc89ff309fff21", TWO_INTS, ONE_INT),
        ("rospy_tutorials/AddTwoInts", "6a2e34150c00229791cc89ff309fff21", TWO_INTS, ONE_INT),
        ("rosserial_arduino/Test", "c63e85f503b805d84df783e71c6bb0d2", TEST_INPUT, TEST_OUTPUT),
        ("rosserial_mbed/Test", "c63e85f503b805d84df783e71c6bb0d2", TEST_INPUT, TEST_OUTPUT),
        (
            "rosserial_msgs/RequestMessageInfo",
            "6416d80296dfbbdd5f7b2cee839f9316",
            "dc67331de85cf97091b7d45e5c64ab75",
            "fe452186a069bed40f09b8628fe5eac8",
        ),
        (
            "rosserial_msgs/RequestParam",
            "d7a0c2be00c9fd03cc69f2863de9c4d9",
            "c1f3d28f1b044c871e6eff2e9fc3c667",
            "9f0e98bda65981986ddf53afa7a40e49",
        ),
        (
            "rosserial_msgs/RequestServiceInfo",
            "0961604b984b94b0b68e8074882be071",
            "1cbcfa13b08f6d36710b9af8741e6112",
            "c3d6dd25b909596479fbbc6559fa6874",
        ),
        (
            "sensor_msgs/SetCameraInfo",
            "bef1df590ed75ed1f393692395e15482",
            "ee34be01fdeee563d0d99cd594d5581d",
            "2ec6f3eff0161f4257b808b12bc830c2",
        ),
        ("std_srvs/Empty", EMPTY, EMPTY, EMPTY),
        ("std_srvs/SetBool", "09fb03525b03e7ea1fd3992bafd87e16", SET_BOOL_REQUEST, SET_BOOL_RESPONSE),
        ("std_srvs/Trigger", "937c9679a518e3a18d831e57125ea522", EMPTY, SET_BOOL_RESPONSE),
    ],
)
def test_md5_sums_of_services(catalog: Catalog, name: str, md5: str, request_md5: str, response_md5: str) -> None:
    found = service(catalog, name)
    assert (found.md5, found.request.md5, found.response.md5) == (md5, request_md5, response_md5)


def test_short_and_long_names_give_one_type(catalog: Catalog) -> None:
    assert message(catalog, "geometry_msgs/msg/Twist") is message(catalog, "geometry_msgs/Twist")
    assert service(catalog, "std_srvs/srv/Trigger") is service(catalog, "std_srvs/Trigger")


@pytest.mark.parametrize(
    "name", ["", "/", "Twist", "geometry_msgs/Twis", "builtin_interfaces/Time", "../errors", "a/b/c/d", "time"]
)
def test_unknown_names_give_none(catalog: Catalog, name: str) -> None:
    assert catalog.message(name) is None
    assert catalog.service(name) is None


def test_type_has_its_fields_constants_and_size(catalog: Catalog) -> None:
    info = message(catalog, "rosserial_msgs/Log")
    assert [(field.name, field.type, field.array_length) for field in info.fields] == [
        ("level", "uint8", -1),
        ("msg", "string", -1),
    ]
    assert info.constants[0] == Constant("ROSDEBUG", "uint8", "0")
    assert info.fixed_bytes is None
    assert message(catalog, "geometry_msgs/Twist").fixed_bytes == 48
    assert message(catalog, "geometry_msgs/TwistWithCovariance").fixed_bytes == 336
    assert message(catalog, "std_msgs/Empty").fixed_bytes == 0
    assert message(catalog, "geometry_msgs/TwistStamped").fixed_bytes is None


def test_least_bytes_are_those_of_the_smallest_message_and_0_of_an_unknown_type(catalog: Catalog) -> None:
    assert catalog.least_bytes("geometry_msgs/Twist") == 48
    assert catalog.least_bytes("std_msgs/String") == 4
    assert catalog.least_bytes("nav_msgs/Odometry") == 16 + 4 + 56 + 288 + 48 + 288
    assert catalog.least_bytes("robot/Unknown") == 0


def test_announced_md5_is_checked(catalog: Catalog) -> None:
    twist = message(catalog, "geometry_msgs/Twist")
    assert catalog.check_message("/cmd_vel", "geometry_msgs/Twist", twist.md5) is twist
    assert catalog.check_message("/cmd_vel", "robot/Unknown", "0" * 32) is None
    with pytest.raises(WrongType) as error:
        catalog.check_message("/cmd_vel", "geometry_msgs/Twist", "abc")
    assert str(error.value) == f"/cmd_vel: wanted geometry_msgs/Twist md5 {twist.md5}, got md5 abc"


def test_service_is_announced_as_two_md5_sums(catalog: Catalog) -> None:
    set_bool = service(catalog, "std_srvs/SetBool")
    assert catalog.check_request("/led", "std_srvs/SetBool", SET_BOOL_REQUEST) is set_bool.request
    assert catalog.check_response("/led", "std_srvs/SetBool", SET_BOOL_RESPONSE) is set_bool.response
    assert catalog.check_request("/led", "robot/Unknown", "abc") is None
    assert catalog.check_response("/led", "robot/Unknown", "abc") is None
    with pytest.raises(WrongType) as error:
        catalog.check_request("/led", "std_srvs/SetBool", SET_BOOL_RESPONSE)
    assert str(error.value) == (
        f"/led: wanted std_srvs/SetBoolRequest md5 {SET_BOOL_REQUEST}, got md5 {SET_BOOL_RESPONSE}"
    )


def test_types_from_user_folders_are_known(tmp_path: Path) -> None:
    folder = write(
        tmp_path,
        msg_Wheel="string SIDE=left # or right\nfloat32 speed_m_s  # a comment\n",
        msg_Wheels="Header header\nWheel[] wheels\n",
        srv_Spin="Wheel[2] wheels\n---\nbool done\n",
    )
    (folder / "robot" / "Flat.msg").write_text("int8 a\n")
    (folder / "README.md").write_text("not a package\n")
    catalog = Catalog([folder])
    wheel = message(catalog, "robot/Wheel")
    assert wheel.md5_text == "string SIDE=left # or right\nfloat32 speed_m_s"
    assert message(catalog, "robot/Wheels").md5_text.splitlines()[1] == f"{wheel.md5} wheels"
    assert service(catalog, "robot/Spin").request.fixed_bytes == 8
    assert message(catalog, "robot/Flat").fixed_bytes == 1


def test_first_folder_with_a_name_wins_over_built_in_types(tmp_path: Path) -> None:
    for number in (1, 2):
        path = tmp_path / str(number) / "std_msgs" / "Bool.msg"
        path.parent.mkdir(parents=True)
        path.write_text(f"uint8 from_{number}\n")
    catalog = Catalog([tmp_path / "1", tmp_path / "2"])
    assert message(catalog, "std_msgs/Bool").fields[0].name == "from_1"


def test_full_definition_contains_each_dependency_once(tmp_path: Path) -> None:
    catalog = Catalog([write(tmp_path, msg_A="B one\nC two\n", msg_B="C c\n", msg_C="int8 x\n")])
    line = "=" * 80
    assert message(catalog, "robot/A").full_definition == (
        f"B one\nC two\n{line}\nMSG: robot/B\nC c\n{line}\nMSG: robot/C\nint8 x\n"
    )


def test_shared_dependencies_are_visited_once(tmp_path: Path) -> None:
    levels = {f"msg_T{depth}": f"T{depth + 1}[] a\nT{depth + 1}[] b\n" for depth in range(30)}
    catalog = Catalog([write(tmp_path, **levels, msg_T30="int8 x\n")])
    assert message(catalog, "robot/T0").full_definition.count("MSG:") == 30


@pytest.mark.parametrize(
    ("files", "where", "problem"),
    [
        ({"msg_A": "\nB b\n"}, "msg/A.msg:2", "field b: unknown type robot/B"),
        ({"msg_A": "int8 x\nA[] a\n"}, "msg/A.msg:2", "field a: robot/A contains itself"),
        ({"msg_A": "B b\n", "msg_B": "A a\n"}, "msg/B.msg:1", "field a: robot/A contains itself"),
        ({"srv_A": "int8 a\n---\n\nB b\n"}, "srv/A.srv:4", "field b: unknown type robot/B"),
        (
            {"msg_A": "int8 x y\n"},
            "msg/A.msg:1",
            "wanted TYPE NAME, got 'int8 x y'; default values exist only in ROS 2; remove it",
        ),
        (
            {"msg_A": "B[300] b\n", "msg_B": "uint8[300] x\n"},
            "msg/A.msg",
            "a message takes at least 90000 bytes, a frame holds 65535",
        ),
        (
            {"msg_A": "B[300] b\n", "msg_B": "std_msgs/Empty[300] x\n"},
            "msg/A.msg",
            "a message takes at least 90000 bytes, a frame holds 65535",
        ),
        (
            {f"msg_T{depth:02}": f"T{depth + 1:02} x\n" for depth in range(40)},
            "msg/T32.msg:1",
            "field x: messages nested more than 32 deep",
        ),
    ],
)
def test_broken_definition_stops_the_start(tmp_path: Path, files: dict[str, str], where: str, problem: str) -> None:
    with pytest.raises(ConfigError) as error:
        Catalog([write(tmp_path, **files)])
    assert str(error.value) == f"{tmp_path}/robot/{where}: {problem}"


def test_deepest_type_that_is_allowed_has_a_codec(tmp_path: Path) -> None:
    levels = {f"msg_T{depth}": f"T{depth + 1} x\n" for depth in range(32)}
    deepest = message(Catalog([write(tmp_path, **levels, msg_T32="int8 x\n")]), "robot/T0")
    assert deepest.encode(deepest.decode(b"\x07")) == b"\x07"


def test_missing_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"nowhere: the folder does not exist$"):
        Catalog([tmp_path / "nowhere"])


@pytest.mark.parametrize("folder", ["robot", "robot/msg"])
def test_package_instead_of_its_parent_folder_is_refused(tmp_path: Path, folder: str) -> None:
    write(tmp_path, msg_A="int8 a\n")
    with pytest.raises(ConfigError, match=r"this is a package; give the folder that contains it$"):
        Catalog([tmp_path / folder])


def test_binary_definition_file_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path, msg_A="") / "robot" / "msg" / "A.msg"
    path.write_bytes(b"int8 a\n# \xff\n")
    with pytest.raises(ConfigError) as error:
        Catalog([tmp_path])
    assert str(error.value) == f"{path}:2: not UTF-8"


def test_byte_order_mark_is_ignored(tmp_path: Path) -> None:
    path = tmp_path / "my_msgs" / "msg" / "Count.msg"
    path.parent.mkdir(parents=True)
    path.write_bytes(b"\xef\xbb\xbfint32 number\n")
    assert [field.name for field in message(Catalog([tmp_path]), "my_msgs/Count").fields] == ["number"]


def test_unreadable_definition_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "robot" / "A.msg").mkdir(parents=True)
    with pytest.raises(ConfigError, match=r"A\.msg: Is a directory$"):
        Catalog([tmp_path])


def test_definition_file_with_an_invalid_name_is_refused(tmp_path: Path) -> None:
    write(tmp_path, **{"msg_A-1": "int8 a\n"})
    with pytest.raises(
        ConfigError, match=r"A-1\.msg: invalid type name; use letters, digits and _, and begin with a letter$"
    ):
        Catalog([tmp_path])


def test_names_of_all_types_are_sorted(tmp_path: Path) -> None:
    known = Catalog([write(tmp_path, msg_Arm="float32 angle\n", srv_Grip="---\n")])
    assert known.message_names() == sorted({*STORE_NAMES, "robot/Arm", *Catalog().message_names()})
    assert set(known.service_names()) - set(Catalog().service_names()) == {"robot/Grip"}
    assert known.service_names() == sorted(known.service_names())


@pytest.mark.parametrize(
    ("name", "has_time"),
    [("std_msgs/Header", True), ("nav_msgs/Odometry", True), ("nav_msgs/Path", True), ("geometry_msgs/Pose2D", False)],
)
def test_has_time_includes_nested_types(catalog: Catalog, name: str, has_time: bool) -> None:
    assert message(catalog, name).has_time == has_time


def test_clock_message_is_its_time_in_nanoseconds() -> None:
    assert decode_clock(bytes.fromhex("02000000 03000000")) == 2_000_000_003


@pytest.mark.parametrize("payload", [b"", bytes(7), bytes(9)])
def test_payload_of_another_length_decodes_to_none(payload: bytes) -> None:
    assert decode_clock(payload) is None


def test_time_of_a_message_has_seconds_and_nanoseconds() -> None:
    assert to_time(2_000_000_003) == {"secs": 2, "nsecs": 3}
