"""Catalog of message and service types from folders of .msg and .srv files."""

import functools
import math
import re
import struct
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

from hostlink.core.messages.fields import BUILT_IN, Field
from hostlink.core.messages.message_type import SEPARATOR, MessageType, ServiceType
from hostlink.core.messages.parsing import Definition, parse_message, parse_service
from hostlink.core.runtime.text_file import read_text
from hostlink.core.runtime.units import NS_PER_S
from hostlink.errors import ConfigError, WrongType

# -- folders ----------------------------------------------------------------------------------------------------------

KINDS: Final = ("msg", "srv")
_DEEPER: Final = ("*/*/{0}/*.{0}", "*/*/*/{0}/*.{0}")  # the layout of a catkin workspace's sources
SUFFIXES: Final = tuple(f".{kind}" for kind in KINDS)
_NAME: Final = re.compile(r"[A-Za-z][A-Za-z0-9_]*")

CLOCK: Final = "/clock"
CLOCK_TYPE: Final = "rosgraph_msgs/Clock"

DEFINITIONS: Final = Path(__file__).with_name("definitions")
STANDARD: Final = Path(__file__).with_name("noetic.txt")  # written by tools/message_definitions.py
NESTING_MAX: Final = 32  # ROS has no message nested deeper than 6
MESSAGE_BYTES_MAX: Final = 65535  # the longest payload of a rosserial frame


def find_definitions(folder: Path, suffix: str) -> dict[str, Path]:
    """Return the files in the folder's packages by type name: <package>/msg/Type.msg or <package>/Type.msg."""
    kind = suffix.removeprefix(".")
    found: dict[str, Path] = {}
    for package in filter(Path.is_dir, _entries(folder)):
        for path in (*_files(package, suffix), *_files(package / kind, suffix)):
            found[f"{package.name}/{path.stem}"] = path
    return found


def check_folder(folder: Path) -> None:
    """Check a folder that the user named for its packages.

    Raises:
        ConfigError: the folder does not exist, or is itself a package.
    """
    if not folder.is_dir():
        raise ConfigError(str(folder), "the folder does not exist")
    for kind in KINDS:
        if _files(folder / kind, f".{kind}") or _files(folder, f".{kind}"):
            raise ConfigError(str(folder), "this is a package; give the folder that contains it")


def check_not_empty(folder: Path) -> None:
    """Check a folder that the user named for the definitions in it.

    Raises:
        ConfigError: none of the folder's packages has a definition.
    """
    if any(find_definitions(folder, suffix) for suffix in SUFFIXES):
        return
    for pattern in _DEEPER:  # limited depth, because the user may give the root of the disk
        for kind in KINDS:
            if found := min(folder.glob(pattern.format(kind)), default=None):
                place = found.parents[2]
                raise ConfigError(
                    str(folder), f"the packages are in subfolders; give each folder that has some, such as {place}"
                )
    raise ConfigError(str(folder), "contains no package with .msg or .srv files")


def read_definition(path: Path) -> str:
    """Read a definition file.

    Raises:
        ConfigError: the file cannot be read or is not UTF-8.
    """
    try:
        return read_text(path)
    except OSError as error:
        raise ConfigError(str(path), error.strerror or "cannot be read") from None
    except UnicodeDecodeError as error:
        line = error.object[: error.start].count(b"\n") + 1
        raise ConfigError(f"{path}:{line}", "not UTF-8") from None


def _files(folder: Path, suffix: str) -> list[Path]:
    """Return the definitions directly in the folder; an empty list when the folder does not exist."""
    try:
        entries = _entries(folder)
    except ConfigError:
        # Ignore lost+found and the like.
        if _NAME.fullmatch(folder.parent.name if folder.name in KINDS else folder.name):
            raise
        return []
    paths = [path for path in entries if path.suffix == suffix]
    for path in paths:
        if not _NAME.fullmatch(path.stem) or not _NAME.fullmatch(folder.name):
            raise ConfigError(str(path), "invalid type name; use letters, digits and _, and begin with a letter")
    return paths


def _entries(folder: Path) -> list[Path]:
    """Return the folder's entries that are not hidden; an empty list when it is not a folder.

    Raises:
        ConfigError: the folder cannot be read.
    """
    try:
        return sorted(path for path in folder.iterdir() if not path.name.startswith("."))
    except (FileNotFoundError, NotADirectoryError):
        return []
    except OSError as error:
        raise ConfigError(str(folder), error.strerror or "cannot be read") from None


# -- full definition --------------------------------------------------------------------------------------------------

_NEXT = re.compile(rf"^{re.escape(SEPARATOR)}\s*\nMSG: *(\S+) *\n", re.MULTILINE)


def read_full_definition(name: str, text: str) -> MessageType:
    """Build a type from a text that also contains every nested type.

    Raises:
        ConfigError: the text is not a definition, or lacks a type.
    """
    first, *rest = _NEXT.split(text)
    texts = {name: first} | dict(zip(rest[::2], rest[1::2], strict=True))
    definitions = {each: parse_message(each, part, each) for each, part in texts.items()}
    return _Builder(definitions.get).build(definitions[name], (name,))


class _Builder:
    """Builds each type once, with those in it, from the definitions that `define` returns by name."""

    def __init__(self, define: Callable[[str], Definition | None], most_bytes: float = math.inf) -> None:
        """`most_bytes`: the smallest message of a type takes no more."""
        self._define, self._most_bytes = define, most_bytes
        self._built: dict[str, MessageType] = {}

    def find(self, name: str, outer: tuple[str, ...] = ()) -> MessageType | None:
        """Return the type of this name; None if it is not defined. `outer` holds the types that contain it."""
        if name not in self._built:
            definition = self._define(name)
            if definition is None:
                return None
            self._built[name] = self.build(definition, (*outer, name))
        return self._built[name]

    def build(self, definition: Definition, outer: tuple[str, ...] = ()) -> MessageType:
        """Build a type. `outer` holds the types that contain it, and itself."""
        nested = {
            field.type: self._nested(definition, field, outer)
            for field in definition.fields
            if field.type not in BUILT_IN
        }
        message = MessageType(definition, nested)
        if message.layout.room > self._most_bytes:
            problem = f"a message takes at least {message.layout.room} bytes, a frame holds {self._most_bytes}"
            raise ConfigError(definition.where, problem)
        return message

    def _nested(self, definition: Definition, field: Field, outer: tuple[str, ...]) -> MessageType:
        if field.type in outer:
            raise definition.error(field, f"{field.type} contains itself")
        if len(outer) > NESTING_MAX:
            raise definition.error(field, f"messages nested more than {NESTING_MAX} deep")
        message = self.find(field.type, outer)
        if message is None:
            raise definition.error(field, f"unknown type {field.type}")
        return message


# -- time -------------------------------------------------------------------------------------------------------------

_TIME = struct.Struct("<II")


def decode_clock(payload: bytes) -> int | None:
    """Decode a message of CLOCK_TYPE to nanoseconds; None when the payload is not one."""
    if len(payload) != _TIME.size:
        return None
    secs, nsecs = _TIME.unpack(payload)
    return int(secs * NS_PER_S + nsecs)


def to_time(stamp_ns: int) -> dict[str, int]:
    """Return a time as a message has it."""
    secs, nsecs = divmod(stamp_ns, NS_PER_S)
    return {"secs": secs, "nsecs": nsecs}


# -- catalog ----------------------------------------------------------------------------------------------------------


@functools.cache
def standard_definitions() -> dict[str, str]:
    """Return the definitions of ROS 1 Noetic's message types by name, without nested types."""
    parts = _NEXT.split(STANDARD.read_text(encoding="utf-8"))[1:]
    return dict(zip(parts[::2], parts[1::2], strict=True))


class Catalog:
    """Message and service types by name. Each type is built once."""

    def __init__(self, folders: Sequence[Path] = ()) -> None:
        """Read the definitions in `folders` of packages.

        The first folder that has a name wins, also over built-in types.
        """
        for folder in folders:
            check_folder(folder)
        self._standard = standard_definitions()
        self._message_files: dict[str, Path] = {}
        self._service_files: dict[str, Path] = {}
        for folder in (DEFINITIONS, *reversed(folders)):
            self._message_files |= find_definitions(folder, ".msg")
            self._service_files |= find_definitions(folder, ".srv")
        self._types = _Builder(self._definition, MESSAGE_BYTES_MAX)
        self._services: dict[str, ServiceType] = {}
        if folders:
            self._build_all()

    def message_names(self) -> list[str]:
        """Return the names of all known message types, "pkg/Type", sorted."""
        return sorted({*self._standard, *self._message_files})

    def service_names(self) -> list[str]:
        """Return the names of all known service types, "pkg/Type", sorted."""
        return sorted(self._service_files)

    def message(self, name: str) -> MessageType | None:
        """Return the type named "pkg/Type" or "pkg/msg/Type"; None if unknown."""
        return self._types.find(short_name(name))

    def least_bytes(self, name: str) -> int:
        """Return the size of the smallest message of a type; 0 if the type is unknown."""
        found = self.message(name)
        return 0 if found is None else found.least_bytes

    def service(self, name: str) -> ServiceType | None:
        """Return the service type named "pkg/Type" or "pkg/srv/Type"; None if unknown."""
        name = short_name(name)
        if name not in self._services and name in self._service_files:
            path = self._service_files[name]
            request, response = parse_service(name, read_definition(path), str(path))
            self._services[name] = ServiceType(name, self._types.build(request), self._types.build(response))
        return self._services.get(name)

    def check_message(self, topic: str, type_name: str, md5: str) -> MessageType | None:
        """Return the type that a device announced for a topic; None if unknown.

        Raises:
            WrongType: the type has another md5 sum here.
        """
        return _checked(topic, self.message(type_name), md5)

    def check_request(self, service: str, type_name: str, md5: str) -> MessageType | None:
        """Return the request type of an announced service, as `check_message` does."""
        known = self.service(type_name)
        return _checked(service, known.request if known else None, md5)

    def check_response(self, service: str, type_name: str, md5: str) -> MessageType | None:
        """Return the response type of an announced service, as `check_message` does."""
        known = self.service(type_name)
        return _checked(service, known.response if known else None, md5)

    def _build_all(self) -> None:
        for name in (*self._message_files, *self._standard):
            self.message(name)
        for name in self._service_files:
            self.service(name)

    def _definition(self, name: str) -> Definition | None:
        if path := self._message_files.get(name):
            return parse_message(name, read_definition(path), str(path))
        text = self._standard.get(name)
        return None if text is None else parse_message(name, text, f"built-in {name}")


def short_name(name: str) -> str:
    """Shorten "pkg/msg/Type" to "pkg/Type"."""
    package, _, rest = name.partition("/")
    kind, _, base = rest.rpartition("/")
    return f"{package}/{base}" if kind in {"msg", "srv"} else name


def _checked(name: str, known: MessageType | None, md5: str) -> MessageType | None:
    if known is not None and known.md5 != md5:
        raise WrongType(name, f"{known.name} md5 {known.md5}", f"md5 {md5}")
    return known
