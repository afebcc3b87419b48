"""Files of the library, and its ZIP."""

import io
import json
import zipfile
from pathlib import Path

import pytest

from hostlink.board.library import headers, library, pack, select, sources, types_needed
from hostlink.core.messages.catalog import Catalog
from hostlink.errors import ConfigError

SELECTION = select(Catalog(), ["std_msgs", "std_srvs"])


def test_library_has_headers_sources_and_the_files_of_each_ide() -> None:
    files = library(sources(), SELECTION)
    below = {path.removeprefix("hostlink_rosserial/") for path in files}
    assert all(path.startswith("hostlink_rosserial/") for path in files)
    assert {
        "library.properties",
        "library.json",
        "keywords.txt",
        "CMakeLists.txt",
        "LICENSE",
        "src/ros/wire.cpp",
    } <= below
    assert {f"src/{path}" for path in headers(SELECTION)} <= below
    properties = dict(
        line.split("=", 1) for line in files["hostlink_rosserial/library.properties"].decode().splitlines()
    )
    assert {"name", "version", "author", "maintainer", "sentence", "paragraph", "url"} <= properties.keys()  # mandatory
    described = json.loads(files["hostlink_rosserial/library.json"])
    assert (properties["name"], properties["architectures"]) == (described["name"], "*")
    assert properties["version"] == described["version"]
    rows = [line.split("\t") for line in files["hostlink_rosserial/keywords.txt"].decode().splitlines()]
    assert ["SetBool", "KEYWORD1"] in rows
    assert {len(row) for row in rows} == {2}
    assert len({word for word, _ in rows}) == len(rows)
    assert all(path.isascii() and " " not in path for path in files)
    sketches = {path.split("/")[2]: path for path in files if path.startswith("hostlink_rosserial/examples/")}
    assert sketches == {name: f"hostlink_rosserial/examples/{name}/{name}.ino" for name in sketches}


@pytest.mark.parametrize("name", ["tf/tf", "tf/transform_broadcaster", "ROS/Node", "hostLink/wifi"])
def test_type_cannot_replace_a_header_of_the_library(tmp_path: Path, name: str) -> None:
    path = tmp_path / f"{name}.msg"
    path.parent.mkdir()
    path.write_text("")
    selection = select(Catalog([tmp_path]), [name])
    with pytest.raises(ConfigError, match=f"{name}: the library has a header of this name; rename the type"):
        library(sources(), selection)


def test_types_that_sources_include_are_found() -> None:
    texts = {
        "src/ros.h": b'#include "ros/node.h"\n  #  include <tf/tfMessage.h>\n',
        "src/ros/node.h": b'#include "wire.h"\n',
        "examples/a/a.ino": b"#include <std_msgs/String.h>\n// #include <std_msgs/Gone.h>\n",
    }
    assert types_needed(texts) == {"tf/tfMessage", "std_msgs/String"}


def test_zip_of_equal_files_has_equal_bytes() -> None:
    packed = pack({"b/two": b"2", "a": b"1"})
    assert packed == pack({"a": b"1", "b/two": b"2"})
    with zipfile.ZipFile(io.BytesIO(packed)) as archive:
        assert archive.namelist() == ["a", "b/two"]
        assert archive.read("b/two") == b"2"
        assert {entry.date_time for entry in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}
        assert {entry.external_attr >> 16 for entry in archive.infolist()} == {0o100644}
