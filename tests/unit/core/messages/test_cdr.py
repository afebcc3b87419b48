"""CDR and the serialisation of ROS 1: bytes of common types, what differs, what is left over, and what is refused."""

import contextlib
import gc
import struct
import tracemalloc
import weakref
from pathlib import Path
from random import Random

import pytest

from hostlink.core.messages.catalog import Catalog
from hostlink.core.messages.cdr import ENCAPSULATION, Cdr, cdr_of
from hostlink.core.messages.fields import EMPTY_ELEMENTS_MAX, ENCODED_BYTES_MAX
from hostlink.core.messages.message_type import MessageType
from hostlink.errors import BadPayload, WrongType
from tests.support.cdr_writer import written
from tests.support.random_messages import damaged, random_message

CATALOG = Catalog()
DEFINITIONS = {
    "Empty": "uint8 ONLY_A_CONSTANT=1\n",
    "Empties": "Empty[] some\nEmpty[3] three\n",
    "Small": "uint8 a\n",
    "Padded": "uint8 a\nfloat64 b\nuint16 c\n",
    "Loose": "float64 a\nuint8 b\n",  # in a list, only the first is aligned
    "Late": "uint16 a\nuint32 b\n",
    "Colors": "float32 r\nfloat32[2] gb\nstd_msgs/ColorRGBA[2] more\n",
    "Named": "string name\nuint8[3] rgb\n",
    "Nothing": "Empty a\nEmpty[9] b\nuint8 c\n",
    "Huge": "Empty[60000] a\nuint8 b\n",
    "Grown": "Huge[] some\n",
    "Everything": (
        "Header header\nbool on\nbyte octet\nchar letter\nPadded padded\nPadded[] list\nLoose[] loose\nLate[2] late\n"
        "Colors[] colors\nColors two\nint16[] steps\nuint8 pad1\nint64[] far\nuint8[5] five\nfloat64[3] xyz\n"
        "uint8 pad2\ntime[] times\nduration span\nNamed[] named\nNamed[2] pair\nstring[] texts\nstring[2] more\n"
        "Empty nothing\nEmpties empties\nEmpty[] none\nSmall[] small\nuint8 last\nHeader[] headers\nfloat64 end\n"
    ),
}
TRANSLATED = [name for name in DEFINITIONS if name not in ("Huge", "Grown")]  # those take long


@pytest.fixture(scope="module")
def own(tmp_path_factory: pytest.TempPathFactory) -> Catalog:
    folder = tmp_path_factory.mktemp("definitions")
    write(folder, "t", DEFINITIONS)
    return Catalog([folder])


def write(folder: Path, package: str, definitions: dict[str, str]) -> None:
    (folder / package).mkdir()
    for name, text in definitions.items():
        (folder / package / f"{name}.msg").write_text(text)


def message(name: str, catalog: Catalog = CATALOG) -> MessageType:
    found = catalog.message(name)
    assert found is not None
    return found


def cdr(name: str, catalog: Catalog = CATALOG) -> Cdr:
    return cdr_of(message(name, catalog))


@pytest.mark.parametrize("name", TRANSLATED)
def test_translation_is_that_of_a_plain_writer(own: Catalog, name: str) -> None:
    type_ = message(f"t/{name}", own)
    random = Random(name)
    for _ in range(100):
        value = random_message(random, type_.layout)
        ros1, ros2 = type_.encode(value), written(type_.layout, value)
        assert cdr_of(type_).from_ros1(ros1) == ros2
        back = cdr_of(type_).to_ros1(ros2)
        assert written(type_.layout, type_.decode(back)) == ros2
        assert cdr_of(type_).to_ros1(ENCAPSULATION + ros2, is_encapsulated=True) == back
        assert cdr_of(type_).from_ros1(ros1, is_encapsulated=True) == ENCAPSULATION + ros2


@pytest.mark.parametrize("name", TRANSLATED)
def test_damaged_payload_raises_only_bad_payload(own: Catalog, name: str) -> None:
    type_ = message(f"t/{name}", own)
    random = Random(name)
    for _ in range(100):
        value = random_message(random, type_.layout)
        for translate, payload in (
            (cdr_of(type_).from_ros1, type_.encode(value)),
            (cdr_of(type_).to_ros1, written(type_.layout, value)),
        ):
            with contextlib.suppress(BadPayload):
                translate(damaged(random, payload))


# -- common types -----------------------------------------------------------------------------------------------------


def test_velocity_has_the_same_bytes_in_both() -> None:
    payload = struct.pack("<6d", 0.5, 0, 0, 0, 0, -1.25)
    twist = cdr("geometry_msgs/Twist")
    assert twist.to_ros1(payload) is payload
    assert twist.from_ros1(payload) is payload


@pytest.mark.parametrize(
    ("name", "is_copy"),
    [
        ("geometry_msgs/Twist", True),
        ("geometry_msgs/Pose2D", True),
        ("geometry_msgs/PoseWithCovariance", True),
        ("std_msgs/Int32", True),
        ("std_msgs/Bool", True),
        ("std_msgs/Time", True),
        ("std_msgs/Empty", False),
        ("std_msgs/String", False),
        ("geometry_msgs/TwistStamped", False),
        ("geometry_msgs/Polygon", False),
        ("nav_msgs/Odometry", False),
        ("nav_msgs/MapMetaData", False),  # three numbers of four bytes before a double
        ("sensor_msgs/NavSatStatus", False),  # an int8, a byte of padding and a uint16
    ],
)
def test_types_with_the_same_bytes_are_known(name: str, is_copy: bool) -> None:
    assert cdr(name).is_copy is is_copy


def test_header_loses_its_seq_and_its_frame_gains_a_nul() -> None:
    imu = cdr("sensor_msgs/Imu")
    values = struct.pack("<37d", *range(37))
    ros2 = struct.pack("<iII", 12, 34, 4) + b"imu\0" + values
    ros1 = struct.pack("<IIII", 0, 12, 34, 3) + b"imu" + values
    assert imu.to_ros1(ros2) == ros1
    assert imu.from_ros1(ros1) == ros2
    assert imu.from_ros1(struct.pack("<I", 77) + ros1[4:]) == ros2


def test_empty_list_has_no_padding_after_its_count() -> None:
    joints = cdr("sensor_msgs/JointState")
    ros2 = struct.pack("<iII4xIIII", 1, 2, 1, 0, 0, 0, 0)
    assert joints.to_ros1(ros2) == struct.pack("<9I", 0, 1, 2, 0, 0, 0, 0, 0, 0)[: 4 * 8]
    assert joints.from_ros1(struct.pack("<8I", 0, 1, 2, 0, 0, 0, 0, 0)) == ros2


def test_message_without_fields_has_a_byte() -> None:
    trigger = CATALOG.service("std_srvs/Trigger")
    assert trigger is not None
    request = cdr_of(trigger.request)
    assert request.from_ros1(b"") == b"\0"
    assert request.to_ros1(b"\0") == b""
    with pytest.raises(BadPayload, match="0 bytes are not such a message: 1 bytes are missing at 0"):
        request.to_ros1(b"")


# -- what a writer may leave after a message --------------------------------------------------------------------------


def test_padding_after_a_message_of_fixed_size_is_ignored() -> None:
    """DDS pads to four bytes."""
    one = cdr("std_msgs/UInt8")
    assert one.to_ros1(b"\x05\0\0\0") == b"\x05"
    with pytest.raises(BadPayload, match="5 bytes are not such a message: the message ends after 1 bytes"):
        one.to_ros1(b"\x05\0\0\0\0")
    with pytest.raises(BadPayload, match="ends after 1 bytes"):
        one.from_ros1(b"\x05\0")


def test_text_that_micro_ros_never_set_is_empty() -> None:
    """The length is 0, without the NUL for which a byte is announced; the next double may then be eight bytes early."""
    imu = cdr("sensor_msgs/Imu")
    values = struct.pack("<37d", *range(37))
    payload = struct.pack("<iIIxxxx", 1, 2, 0) + values
    expected = struct.pack("<IIII", 0, 1, 2, 0) + values
    assert imu.to_ros1(payload) == expected
    assert imu.to_ros1(payload + bytes(15)) == expected
    text = cdr("std_msgs/String")
    assert text.to_ros1(bytes(5)) == bytes(4)


def test_more_than_texts_may_leave_is_refused() -> None:
    text = cdr("std_msgs/String")
    payload = struct.pack("<I", 4) + b"abc\0"
    assert text.to_ros1(payload + bytes(7)) == struct.pack("<I", 3) + b"abc"
    with pytest.raises(BadPayload, match="16 bytes are not such a message: the message ends after 8 bytes"):
        text.to_ros1(payload + bytes(8))
    assert text.to_ros1(ENCAPSULATION + payload + bytes(3), is_encapsulated=True)
    with pytest.raises(BadPayload, match="12 bytes are not such a message: the message ends after 8 bytes"):
        text.to_ros1(ENCAPSULATION + payload + bytes(4), is_encapsulated=True)


def test_text_without_a_nul_is_refused() -> None:
    with pytest.raises(BadPayload, match="the text at 0 has no NUL at its end"):
        cdr("std_msgs/String").to_ros1(struct.pack("<I", 3) + b"abc")


# -- types that ROS 2 has changed -------------------------------------------------------------------------------------


def test_range_has_a_variance_in_ros_2() -> None:
    """Since Iron. A board of an earlier one sends none, and ignores it."""
    sonar = cdr("sensor_msgs/Range")
    ros1 = struct.pack("<IIII", 0, 1, 2, 1) + b"a" + struct.pack("<B4f", 0, 0.1, 0.2, 3.0, 1.5)
    ros2 = struct.pack("<iII", 1, 2, 2) + b"a\0" + struct.pack("<Bx4f", 0, 0.1, 0.2, 3.0, 1.5)
    assert sonar.from_ros1(ros1) == ros2 + bytes(4)
    assert sonar.to_ros1(ros2) == ros1
    assert sonar.to_ros1(ros2 + struct.pack("<f", 0.5)) == ros1
    assert sonar.to_ros1(ENCAPSULATION + ros2 + struct.pack("<f", 0.5), is_encapsulated=True) == ros1


@pytest.mark.parametrize(
    ("name", "changed"),
    [
        ("rosgraph_msgs/Log", "rosgraph_msgs/Log"),
        ("visualization_msgs/MarkerArray", "visualization_msgs/Marker"),
        ("visualization_msgs/InteractiveMarkerInit", "visualization_msgs/Marker"),
    ],
)
def test_type_with_other_fields_in_ros_2_is_refused(name: str, changed: str) -> None:
    with pytest.raises(WrongType, match=f"{name}: wanted the fields that {changed} has in ROS 2, got those of ROS 1"):
        cdr(name)


def test_definition_in_a_folder_of_the_user_is_used_unchanged(tmp_path: Path) -> None:
    marker = message("visualization_msgs/Marker").definition
    sonar = message("sensor_msgs/Range").definition
    write(tmp_path, "visualization_msgs", {"Marker": f"{marker}string texture_resource\n"})
    write(tmp_path, "sensor_msgs", {"Range": f"{sonar}float32 variance\n"})
    write(tmp_path, "t", {"Sonars": "sensor_msgs/Range[] all\n"})
    catalog = Catalog([tmp_path])
    assert cdr("visualization_msgs/Marker", catalog)
    assert cdr("t/Sonars", catalog)
    assert len(cdr("sensor_msgs/Range", catalog).from_ros1(message("sensor_msgs/Range", catalog).encode({}))) == 36


def test_definition_of_ros_2_with_a_time_is_translated(tmp_path: Path) -> None:
    write(
        tmp_path,
        "t",
        {"Stamped": "std_msgs/Header header\nbuiltin_interfaces/Time at\nbuiltin_interfaces/Duration[] d\n"},
    )
    stamped = message("t/Stamped", Catalog([tmp_path]))
    assert stamped.has_time
    ros1 = stamped.encode({"at": {"secs": 5, "nsecs": 6}, "d": [{"secs": -1, "nsecs": 7}]})
    assert cdr_of(stamped).from_ros1(ros1) == struct.pack("<iIIxxxxiIIiI", 0, 0, 1, 5, 6, 1, -1, 7)


def test_header_of_the_user_without_a_text_loses_its_seq_in_lists_too(tmp_path: Path) -> None:
    write(tmp_path, "std_msgs", {"Header": "uint32 seq\ntime stamp\n"})
    write(tmp_path, "t", {"Headers": "Header[] all\n"})
    headers = cdr("t/Headers", Catalog([tmp_path]))
    ros1 = struct.pack("<7I", 2, 0, 1, 2, 0, 3, 4)
    assert headers.from_ros1(ros1) == struct.pack("<5I", 2, 1, 2, 3, 4)
    assert headers.to_ros1(struct.pack("<5I", 2, 1, 2, 3, 4)) == ros1


def test_range_in_another_message_is_refused(tmp_path: Path) -> None:
    """The bytes that it has more would be in the middle."""
    write(tmp_path, "t", {"Sonars": "sensor_msgs/Range[] all\n"})
    with pytest.raises(WrongType, match="t/Sonars: wanted the fields that sensor_msgs/Range has in ROS 2"):
        cdr("t/Sonars", Catalog([tmp_path]))


# -- encapsulation, bounds --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("begin", [b"", b"\0\1\0", b"\0\0\0\0", b"\0\7\0\0"])
def test_encapsulation_that_is_not_little_endian_cdr_is_refused(begin: bytes) -> None:
    payload = begin + bytes(48) if len(begin) == 4 else begin
    with pytest.raises(BadPayload, match=f"begins with {begin.hex()}, "):
        cdr("geometry_msgs/Twist").to_ros1(payload, is_encapsulated=True)


def test_options_of_the_encapsulation_are_ignored() -> None:
    assert cdr("std_msgs/UInt8").to_ros1(b"\0\1\0\3\7\0\0\0", is_encapsulated=True) == b"\7"


@pytest.mark.parametrize(
    ("name", "before"),
    [
        ("std_msgs/String", 0),
        ("geometry_msgs/Polygon", 0),
        ("tf2_msgs/TFMessage", 0),
        ("std_msgs/Float64MultiArray", 0),
        ("sensor_msgs/Joy", 16),
        ("sensor_msgs/JointState", 16),
    ],
)
def test_lying_length_costs_nothing(name: str, before: int) -> None:
    """Each length is checked against the bytes that are left before anything is made."""
    translate, number = cdr(name), struct.Struct("<I")
    for direction in (translate.to_ros1, translate.from_ros1):
        for lie in (2**32 - 1, 2**31, 65):
            payload = bytes(before) + number.pack(lie) + b"\1" * 64
            tracemalloc.start()
            try:
                with pytest.raises(BadPayload):
                    direction(payload)
                assert tracemalloc.get_traced_memory()[1] < 65536
            finally:
                tracemalloc.stop()


def test_list_of_messages_without_fields_is_short(own: Catalog) -> None:
    """The bytes of ROS 1 do not bound it."""
    empties = cdr("t/Empties", own)
    full = struct.pack("<I", EMPTY_ELEMENTS_MAX)
    assert empties.from_ros1(full) == full + bytes(EMPTY_ELEMENTS_MAX + 3)
    assert empties.to_ros1(full + bytes(EMPTY_ELEMENTS_MAX + 3)) == full
    more = struct.pack("<I", EMPTY_ELEMENTS_MAX + 1)
    for direction, payload in ((empties.from_ros1, more), (empties.to_ros1, more + bytes(EMPTY_ELEMENTS_MAX + 4))):
        with pytest.raises(BadPayload, match="17 elements without fields"):
            direction(payload)


def test_message_that_grows_in_cdr_has_a_limit(own: Catalog) -> None:
    grown = cdr("t/Grown", own)
    assert len(grown.from_ros1(struct.pack("<I3x", 3))) == 4 + 3 * 60001
    with pytest.raises(BadPayload, match=f"more than {ENCODED_BYTES_MAX} bytes in CDR"):
        grown.from_ros1(struct.pack("<I", 100_000) + bytes(100_000))


def test_translation_is_compiled_once_and_dropped_with_its_type(own: Catalog) -> None:
    type_ = message("t/Padded", own)
    assert cdr_of(type_) is cdr_of(type_)
    alone = Catalog().message("geometry_msgs/Twist")
    assert alone is not None
    known = weakref.ref(cdr_of(alone))
    del alone
    gc.collect()
    assert known() is None
