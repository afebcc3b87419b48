"""Generated headers: each kind of field and constant, and names that C++ reserves."""

from pathlib import Path

import pytest

from hostlink.board.headers import message_header, service_header
from hostlink.core.messages.catalog import Catalog
from hostlink.core.messages.message_type import MessageType
from tests.support.fake_device import message_type, service_type

CATALOG = Catalog()


def made(tmp_path: Path, text: str) -> MessageType:
    package = tmp_path / "my_msgs"
    package.mkdir()
    (package / "Mine.msg").write_text(text)
    found = Catalog([tmp_path]).message("my_msgs/Mine")
    assert found is not None
    return found


def header(tmp_path: Path, text: str) -> str:
    return message_header(made(tmp_path, text))


def test_fixed_message_has_its_type_md5_and_size() -> None:
    message = message_type("geometry_msgs/Twist")
    text = message_header(message)
    assert '#include "geometry_msgs/Vector3.h"' in text
    assert "  ::geometry_msgs::Vector3 linear;\n  ::geometry_msgs::Vector3 angular;\n" in text
    assert 'text[] ROS_IN_FLASH = "geometry_msgs/Twist";' in text
    assert 'text[] ROS_IN_FLASH = "9f195f881246fdfa2798d1d3eebca84a";' in text
    assert "::ros::Size(48, 48)" in text


def test_service_has_classes_for_request_and_response_under_both_names() -> None:
    service = service_type("std_srvs/SetBool")
    text = service_header(service)
    assert "class SetBoolRequest : public ::ros::Msg {" in text
    assert "class SetBoolResponse : public ::ros::Msg {" in text
    assert "struct SetBool {\n  typedef SetBoolRequest Request;\n  typedef SetBoolResponse Response;\n" in text
    assert text.count('"std_srvs/SetBool"') == 3
    assert all(f'"{each.md5}"' in text for each in (service, service.request, service.response))


@pytest.mark.parametrize(
    ("line", "members"),
    [
        ("float64 x", ["double x = 0;"]),
        ("byte x", ["int8_t x = 0;"]),
        ("char x", ["uint8_t x = 0;"]),
        ("string x", ['const char* x = "";']),
        ("time x", ["::ros::Time x;"]),
        ("duration[2] x", ["::ros::Duration x[2] = {};"]),
        ("int64[3] x", ["int64_t x[3] = {};"]),
        ("uint16[] x", ["uint32_t x_length = 0;", "uint16_t* x = nullptr;"]),
        ("string[] x", ["uint32_t x_length = 0;", "::ros::Texts x = nullptr;"]),
        ("float64[] x", ["uint32_t x_length = 0;", "::ros::Doubles x = nullptr;"]),
        ("string[2] x", ["const char* x[2] = {};"]),
        ("Header[] x", ["uint32_t x_length = 0;", "::std_msgs::Header* x = nullptr;"]),
        ("uint8[] x\nuint8 x_length", ["uint32_t x_length_ = 0;", "uint8_t* x = nullptr;", "uint8_t x_length = 0;"]),
        ("int8 class", ["int8_t class_ = 0;"]),
        ("int8 PI", ["int8_t PI_ = 0;"]),
        ("int8 Mine", ["int8_t Mine_ = 0;"]),
        ("int8 getMD5", ["int8_t getMD5_ = 0;"]),
        ("int8 in\nint8 out\nint8 text", ["int8_t in = 0;", "int8_t out = 0;", "int8_t text = 0;"]),
        ("int8 new\nint8 new_", ["int8_t new_ = 0;", "int8_t new__ = 0;"]),
    ],
)
def test_fields_have_the_members_of_ros_lib(tmp_path: Path, line: str, members: list[str]) -> None:
    text = header(tmp_path, line)
    found = text.partition(" public:\n")[2].partition("\n\n")[0]
    assert [each.strip() for each in found.splitlines()] == members


@pytest.mark.parametrize(
    ("constants", "lines"),
    [
        ("uint8 A=1\nuint8 B=2", ["enum : uint8_t {", "A = 1,", "B = 2,", "};"]),
        ("bool A=True", ["enum : bool {", "A = true,", "};"]),
        ("bool A=0", ["enum : bool {", "A = false,", "};"]),
        ("bool A=+1\nbool B=false", ["enum : bool {", "A = true,", "B = false,", "};"]),
        ("int64 A=-9223372036854775808", ["enum : int64_t {", "A = (-9223372036854775807LL - 1),", "};"]),
        ("uint64 A=18446744073709551615", ["enum : uint64_t {", "A = 18446744073709551615ULL,", "};"]),
        ("uint32 A=4294967295", ["enum : uint32_t {", "A = 4294967295LL,", "};"]),
        ("int32 HIGH=1_000", ["enum : int32_t {", "HIGH_ = 1000,", "};"]),
        ("float32 A=0.1", ["static constexpr float A = 0.10000000149011612f;"]),
        ("float32 A=1e39", ["static constexpr float A = INFINITY;"]),
        ("float64 A=nan", ["static constexpr double A = NAN;"]),
        ("float64 A=-1e300", [
            "#if __SIZEOF_DOUBLE__ > 4", "static constexpr double A = -1e+300;",
            "#else", "static constexpr double A = -INFINITY;", "#endif",
        ]),
        ('string A=write "??=" \\ #1 µ',
         [r'static constexpr const char* A = "write \042\077\077=\042 \134 #1 \302\265";']),
    ],
)  # fmt: skip
def test_constants_are_written_as_c_literals(tmp_path: Path, constants: str, lines: list[str]) -> None:
    text = header(tmp_path, constants)
    found = text.partition(" public:\n")[2].partition("\n\n")[0]
    assert [each.strip() for each in found.splitlines()] == lines
    assert ("#include <math.h>" in text) == ("INFINITY" in found or "NAN" in found)


def test_constants_that_are_members_are_defined_once_each(tmp_path: Path) -> None:
    text = header(tmp_path, "float64 A=-1e300\nstring B=b\nuint8 C=1")
    assert text.partition("};\n#if __cplusplus")[2].splitlines()[:4] == [
        " < 201703L",
        "constexpr double Mine::A __attribute__((weak));",
        "constexpr const char* Mine::B __attribute__((weak));",
        "#endif",
    ]


def test_message_longer_than_a_frame_has_the_largest_size(tmp_path: Path) -> None:
    assert "::ros::Size(4, 65535)" in header(tmp_path, "uint8[] data")
