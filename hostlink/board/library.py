"""Arduino library: selected types, generated headers, and a reproducible ZIP. Pure."""

import io
import json
import re
import zipfile
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from importlib.metadata import version
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Final, TypeVar

from hostlink.board.headers import class_name, message_header, service_header
from hostlink.core.messages.catalog import Catalog
from hostlink.core.messages.message_type import MessageType, ServiceType
from hostlink.errors import ConfigError

# -- archive ----------------------------------------------------------------------------------------------------------

TIME: Final = (1980, 1, 1, 0, 0, 0)  # the earliest time of a ZIP
_PLAIN_FILE: Final = 0o100644 << 16
_UNIX: Final = 3

RESERVED_PACKAGES: Final = frozenset({"ros", "std", "hostlink"})  # C++ namespaces of others, and of the library

T = TypeVar("T", MessageType, ServiceType)

NAME: Final = "hostlink_rosserial"  # also its folder in the ZIP
CHECKOUT: Final = Path(__file__).parents[2] / "firmware" / "rosserial"  # used when hostlink runs from its sources
PARTS: Final = ("src", "examples")
SUFFIXES: Final = (".h", ".cpp", ".ino", ".md")


def pack(files: Mapping[str, bytes]) -> bytes:
    """Pack files, by their paths in the ZIP. The bytes depend only on the files."""
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for path in sorted(files):
            entry = zipfile.ZipInfo(path, TIME)
            entry.create_system, entry.external_attr = _UNIX, _PLAIN_FILE
            entry.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(entry, files[path])
    return packed.getvalue()


# -- selection --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class TypeSelection:
    """Selected types, sorted by name, with all nested types."""

    messages: tuple[MessageType, ...]
    services: tuple[ServiceType, ...]

    @property
    def names(self) -> list[str]:
        """Names of all selected types."""
        return [*(message.name for message in self.messages), *(service.name for service in self.services)]

    @property
    def packages(self) -> list[str]:
        """Packages of the selected types."""
        return sorted({name.partition("/")[0] for name in self.names})


def known_names(catalog: Catalog) -> list[str]:
    """List the names that can be selected: packages, and types with their packages."""
    types = {*catalog.message_names(), *catalog.service_names()}
    return sorted(types | {name.partition("/")[0] for name in types})


def select(catalog: Catalog, wanted: Iterable[str] | None) -> TypeSelection:
    """Select the `wanted` packages and types, with all nested types; None selects all packages.

    Raises:
        ConfigError: a definition is wrong, or two names clash in C++.
    """
    chosen = None if wanted is None else frozenset(wanted)
    messages: dict[str, MessageType] = {}
    services: dict[str, ServiceType] = {}
    for name in catalog.message_names():
        if _is_chosen(name, chosen) and (message := catalog.message(name)):
            _add(message, messages)
    for name in catalog.service_names():
        if _is_chosen(name, chosen) and (service := catalog.service(name)):
            services[name] = service
            for part in (service.request, service.response):
                for nested in part.nested.values():
                    _add(nested, messages)
    _check_names(messages, services)
    return TypeSelection(_sorted(messages), _sorted(services))


def _is_chosen(name: str, chosen: frozenset[str] | None) -> bool:
    return chosen is None or name in chosen or name.partition("/")[0] in chosen


def _add(message: MessageType, messages: dict[str, MessageType]) -> None:
    if message.name not in messages:
        messages[message.name] = message
        for nested in message.nested.values():
            _add(nested, messages)


def _check_names(messages: Collection[str], services: Collection[str]) -> None:
    """Check that C++ names and header names are unique, also on file systems that ignore case."""
    for name in (*messages, *services):
        if name.partition("/")[0] in RESERVED_PACKAGES:
            raise ConfigError(name, "the package has the name of a C++ namespace of the library; rename the package")
    classes = set(messages)
    headers = {name.lower(): name for name in sorted(classes, reverse=True)}
    for service in services:
        if both := classes & {service, f"{service}Request", f"{service}Response"}:
            raise ConfigError(
                service, f"the service header needs the name of the message {min(both)}; rename one of them"
            )
        headers.setdefault(service.lower(), service)
    names: dict[str, str] = {}
    for name in (*messages, *services):
        if (other := names.setdefault(class_name(name), name)) != name:
            raise ConfigError(name, f"its C++ name {class_name(name)[2:]} is also that of {other}; rename one of them")
        if headers[name.lower()] != name:
            raise ConfigError(
                name, f"differs from {headers[name.lower()]} only in upper and lower case; rename one of them"
            )


def _sorted(types: dict[str, T]) -> tuple[T, ...]:
    return tuple(types[name] for name in sorted(types))


# -- library ----------------------------------------------------------------------------------------------------------

_INCLUDED: Final = re.compile(rb'^\s*#\s*include\s*[<"]([A-Za-z]\w*/[A-Za-z]\w*)\.h[>"]', re.MULTILINE)
_SENTENCE: Final = "rosserial for any board: topics, services, parameters and time, with hostlink or ROS as the host."


def sources() -> dict[str, bytes]:
    """Read the files of firmware/rosserial for the library, by their paths there, and the licence."""
    installed = files("hostlink.board") / "rosserial"
    root, terms = (installed, installed) if installed.is_dir() else (CHECKOUT, CHECKOUT.parents[1])
    found = {path: entry.read_bytes() for part in PARTS for path, entry in _walk(root / part, part)}
    found |= {entry.name: entry.read_bytes() for entry in root.iterdir() if entry.name.endswith(".md")}
    return {**found, "LICENSE": (terms / "LICENSE").read_bytes()}


def types_needed(texts: Mapping[str, bytes]) -> set[str]:
    """Return the types whose headers these sources include and that are not among them."""
    included = {name.decode() for text in texts.values() for name in _INCLUDED.findall(text)}
    return {name for name in included if f"src/{name}.h" not in texts}


def headers(selection: TypeSelection) -> dict[str, str]:
    """Write the header of each type, by its path: "std_msgs/String.h"."""
    made = {f"{each.name}.h": message_header(each) for each in selection.messages}
    return made | {f"{each.name}.h": service_header(each) for each in selection.services}


def library(texts: Mapping[str, bytes], selection: TypeSelection) -> dict[str, bytes]:
    """Return all files of the library, by their paths in the ZIP.

    Raises:
        ConfigError: a type's header has the same name as one of the sources.
    """
    made = {f"src/{path}": text for path, text in headers(selection).items()}
    there = {path.lower() for path in texts}  # some file systems ignore case
    for path in made:
        if path.lower() in there:
            name = path.removeprefix("src/").removesuffix(".h")
            raise ConfigError(name, "the library has a header of this name; rename the type")
    made["library.properties"] = _properties()
    made["library.json"] = _platformio()
    made["CMakeLists.txt"] = _CMAKE
    made["keywords.txt"] = _keywords(selection)
    encoded = {path: text.encode() for path, text in made.items()}
    return {f"{NAME}/{path}": text for path, text in {**encoded, **texts}.items()}


def _walk(folder: Traversable, path: str) -> Iterator[tuple[str, Traversable]]:
    for entry in folder.iterdir():
        below = f"{path}/{entry.name}"
        if entry.is_dir():
            yield from _walk(entry, below)
        elif entry.name.endswith(SUFFIXES):
            yield below, entry


def _properties() -> str:
    """Write library.properties for the Arduino IDE."""
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


def _keywords(selection: TypeSelection) -> str:
    """Write keywords.txt for the Arduino IDE's highlighting. The separator is a tab."""
    classes = {name.partition("/")[2] for name in selection.names}
    rows = [f"{name}\tKEYWORD1" for name in sorted({*classes, *_CLASSES.split()})]
    return "\n".join([*rows, *(f"{name}\tKEYWORD2" for name in sorted(_METHODS.split()))]) + "\n"


_CLASSES: Final = """
    CommandWatchdog DiagnosticsPublisher Duration KeyedLink NodeHandle Parameter Publisher ServiceClient
    ServiceServer BoardSettings Subscriber Time TransformBroadcaster Updates WifiStation
"""
_METHODS: Final = """
    advertise advertiseService attach call connected getParam initNode logdebug logerror logfatal loginfo logwarn
    now publish requestParam serviceClient setNamespace spinOnce subscribe
"""
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
