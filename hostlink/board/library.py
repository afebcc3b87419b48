"""The files of the Arduino library: the NodeHandle's sources, a header for each type, and what IDEs need."""

import json
import re
from collections.abc import Iterator, Mapping
from importlib.metadata import version
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Final

from hostlink.board.headers import message_header, service_header
from hostlink.board.selection import Selection
from hostlink.errors import ConfigError

NAME: Final = "hostlink_rosserial"  # of the library, and of its folder in the ZIP
CHECKOUT: Final = Path(__file__).parents[2] / "firmware" / "rosserial"  # where hostlink runs from its sources
PARTS: Final = ("src", "examples")
SUFFIXES: Final = (".h", ".cpp", ".ino", ".md")
_INCLUDED: Final = re.compile(rb'^\s*#\s*include\s*[<"]([A-Za-z]\w*/[A-Za-z]\w*)\.h[>"]', re.MULTILINE)
_SENTENCE: Final = "rosserial for any board: topics, services, parameters and time, with hostlink or ROS as the host."


def sources() -> dict[str, bytes]:
    """The files of firmware/rosserial that belong into a library, by their paths there, and the licence."""
    installed = files("hostlink.board") / "rosserial"
    root, terms = (installed, installed) if installed.is_dir() else (CHECKOUT, CHECKOUT.parents[1])
    found = {path: entry.read_bytes() for part in PARTS for path, entry in _walk(root / part, part)}
    found |= {entry.name: entry.read_bytes() for entry in root.iterdir() if entry.name.endswith(".md")}
    return {**found, "LICENSE": (terms / "LICENSE").read_bytes()}


def types_needed(texts: Mapping[str, bytes]) -> set[str]:
    """The types whose headers these sources include, and that are not among them."""
    included = {name.decode() for text in texts.values() for name in _INCLUDED.findall(text)}
    return {name for name in included if f"src/{name}.h" not in texts}


def headers(selection: Selection) -> dict[str, str]:
    """The header of each type, by its path: "std_msgs/String.h"."""
    made = {f"{each.name}.h": message_header(each) for each in selection.messages}
    return made | {f"{each.name}.h": service_header(each) for each in selection.services}


def library(texts: Mapping[str, bytes], selection: Selection) -> dict[str, bytes]:
    """All files of the library, by their paths in the ZIP.

    Raises:
        ConfigError: the header of a type has the name of one of the sources.
    """
    made = {f"src/{path}": text for path, text in headers(selection).items()}
    there = {path.lower() for path in texts}  # some file systems know no capital letters
    for path in made:
        if path.lower() in there:
            name = path.removeprefix("src/").removesuffix(".h")
            raise ConfigError(name, "the library has a header of this name; rename the type")
    made["library.properties"] = _properties()
    made["library.json"] = _platformio()
    made["CMakeLists.txt"] = _CMAKE
    made["keywords.txt"] = _keywords(selection)
    return {f"{NAME}/{path}": text for path, text in {**_encoded(made), **texts}.items()}


def _encoded(texts: Mapping[str, str]) -> dict[str, bytes]:
    return {path: text.encode() for path, text in texts.items()}


def _walk(folder: Traversable, path: str) -> Iterator[tuple[str, Traversable]]:
    for entry in folder.iterdir():
        below = f"{path}/{entry.name}"
        if entry.is_dir():
            yield from _walk(entry, below)
        elif entry.name.endswith(SUFFIXES):
            yield below, entry


def _properties() -> str:
    """For the Arduino IDE."""
    facts = {
        "name": NAME,
        "version": version("hostlink"),
        "author": "hostlink",
        "maintainer": "hostlink",
        "sentence": _SENTENCE,
        "paragraph": "The API reads like ros_lib's. No heap; every length from the wire is checked.",
        "category": "Communication",
        "url": "",
        "architectures": "*",
        "includes": "ros.h",
    }
    return "".join(f"{key}={value}\n" for key, value in facts.items())


def _platformio() -> str:
    facts = {
        "name": NAME,
        "version": version("hostlink"),
        "description": _SENTENCE,
        "keywords": "ros, rosserial, robot, hostlink",
        "license": "MIT",
        "frameworks": "*",
        "platforms": "*",
        "headers": "ros.h",
    }
    return json.dumps(facts, indent=2) + "\n"


def _keywords(selection: Selection) -> str:
    """For the Arduino IDE, which colours them; the separator is a tab."""
    classes = {name.partition("/")[2] for name in selection.names}
    rows = [f"{name}\tKEYWORD1" for name in sorted({*classes, *_CLASSES})]
    return "\n".join([*rows, *(f"{name}\tKEYWORD2" for name in sorted(_METHODS))]) + "\n"


_CLASSES: Final = (
    "CommandWatchdog",
    "DiagnosticsPublisher",
    "Duration",
    "KeyedLink",
    "NodeHandle",
    "Parameter",
    "Publisher",
    "ServiceClient",
    "ServiceServer",
    "BoardSettings",
    "Subscriber",
    "Time",
    "TransformBroadcaster",
    "Updates",
    "WifiStation",
)
_METHODS: Final = (
    "advertise",
    "advertiseService",
    "attach",
    "call",
    "connected",
    "getParam",
    "initNode",
    "logdebug",
    "logerror",
    "logfatal",
    "loginfo",
    "logwarn",
    "now",
    "publish",
    "requestParam",
    "serviceClient",
    "setNamespace",
    "spinOnce",
    "subscribe",
)

_CMAKE: Final = """\
# add_subdirectory(hostlink_rosserial), then target_link_libraries(your_program hostlink::rosserial).
cmake_minimum_required(VERSION 3.12)
project(hostlink_rosserial CXX)

file(GLOB_RECURSE HOSTLINK_ROSSERIAL_SOURCES CONFIGURE_DEPENDS ${CMAKE_CURRENT_SOURCE_DIR}/src/*.cpp)
add_library(hostlink_rosserial STATIC ${HOSTLINK_ROSSERIAL_SOURCES})
add_library(hostlink::rosserial ALIAS hostlink_rosserial)
target_include_directories(hostlink_rosserial PUBLIC ${CMAKE_CURRENT_SOURCE_DIR}/src)
target_compile_features(hostlink_rosserial PUBLIC cxx_std_11)
"""
