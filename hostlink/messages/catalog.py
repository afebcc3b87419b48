"""Every type by its name: the Noetic typestore of rosbags, the definitions beside this file, and the user's own.

A user's definition goes before a built-in one of the same name. Built-in types are parsed when they are first
requested; with folders of the user's, all are at once, so that a broken file stops the start and nothing later.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from rosbags.typesys import Stores, get_typestore

from hostlink.errors import ConfigError, WrongType
from hostlink.messages.fields import BUILT_IN, Field
from hostlink.messages.folders import check_folder, find_definitions, read_definition
from hostlink.messages.message_type import SEPARATOR, MessageType, ServiceType
from hostlink.messages.parsing import Definition, parse_message, parse_service

DEFINITIONS: Final = Path(__file__).with_name("definitions")
NESTING_MAX: Final = 32  # messages in messages; ROS has none deeper than 6
MESSAGE_BYTES_MAX: Final = 65535  # what a rosserial frame can claim


class Catalog:
    """Types by name, each built once."""

    def __init__(self, folders: Sequence[Path] = ()) -> None:
        """`folders` hold packages of .msg and .srv files; the first one that has a name wins."""
        for folder in folders:
            check_folder(folder)
        store = get_typestore(Stores.ROS1_NOETIC)
        self._store = {_short(name): name for name in store.fielddefs if not name.startswith("builtin_interfaces/")}
        self._definition_text = store.generate_msgdef
        self._message_files: dict[str, Path] = {}
        self._service_files: dict[str, Path] = {}
        for folder in (DEFINITIONS, *reversed(folders)):
            self._message_files |= find_definitions(folder, ".msg")
            self._service_files |= find_definitions(folder, ".srv")
        self._messages: dict[str, MessageType] = {}
        self._services: dict[str, ServiceType] = {}
        if folders:
            self._build_all()

    def message_names(self) -> list[str]:
        """Of all types that are known, "pkg/Type", sorted."""
        return sorted({*self._store, *self._message_files})

    def service_names(self) -> list[str]:
        """Of all service types that are known, "pkg/Type", sorted."""
        return sorted(self._service_files)

    def message(self, name: str) -> MessageType | None:
        """The type of that name, "pkg/Type" or "pkg/msg/Type"; None: unknown."""
        return self._message(_short(name), ())

    def service(self, name: str) -> ServiceType | None:
        """The service type of that name, "pkg/Type" or "pkg/srv/Type"; None: unknown."""
        name = _short(name)
        if name not in self._services and name in self._service_files:
            path = self._service_files[name]
            request, response = parse_service(name, read_definition(path), str(path))
            self._services[name] = ServiceType(name, self._build(request, ()), self._build(response, ()))
        return self._services.get(name)

    def check_message(self, topic: str, type_name: str, md5: str) -> MessageType | None:
        """The type that a device announced for a topic; None: unknown; WrongType: its md5 sum is another."""
        return _checked(topic, self.message(type_name), md5)

    def check_request(self, service: str, type_name: str, md5: str) -> MessageType | None:
        """As `check_message`, for the requests of a service type."""
        known = self.service(type_name)
        return _checked(service, known.request if known else None, md5)

    def check_response(self, service: str, type_name: str, md5: str) -> MessageType | None:
        """As `check_message`, for the responses of a service type."""
        known = self.service(type_name)
        return _checked(service, known.response if known else None, md5)

    def _build_all(self) -> None:
        for name in (*self._message_files, *self._store):
            self.message(name)
        for name in self._service_files:
            self.service(name)

    def _message(self, name: str, outer: tuple[str, ...]) -> MessageType | None:
        if name not in self._messages:
            definition = self._definition(name)
            if definition is None:
                return None
            self._messages[name] = self._build(definition, (*outer, name))
        return self._messages[name]

    def _definition(self, name: str) -> Definition | None:
        if path := self._message_files.get(name):
            return parse_message(name, read_definition(path), str(path))
        if stored := self._store.get(name):
            text = self._definition_text(stored, ros_version=1)[0].partition(SEPARATOR)[0]
            return parse_message(name, text, f"built-in {name}")
        return None

    def _build(self, definition: Definition, outer: tuple[str, ...]) -> MessageType:
        """`outer`: the types that this one is being built for, and itself."""
        nested = {
            field.type: self._nested(definition, field, outer)
            for field in definition.fields
            if field.type not in BUILT_IN
        }
        message = MessageType(definition, nested)
        if message.layout.room > MESSAGE_BYTES_MAX:
            problem = f"a message takes at least {message.layout.room} bytes, a frame holds {MESSAGE_BYTES_MAX}"
            raise ConfigError(definition.where, problem)
        return message

    def _nested(self, definition: Definition, field: Field, outer: tuple[str, ...]) -> MessageType:
        if field.type in outer:
            raise definition.error(field, f"{field.type} contains itself")
        if len(outer) > NESTING_MAX:
            raise definition.error(field, f"messages in messages, more than {NESTING_MAX} deep")
        message = self._message(field.type, outer)
        if message is None:
            raise definition.error(field, f"no type is named {field.type}")
        return message


def _short(name: str) -> str:
    """ "pkg/msg/Type" -> "pkg/Type"."""
    package, _, rest = name.partition("/")
    kind, _, base = rest.rpartition("/")
    return f"{package}/{base}" if kind in {"msg", "srv"} else name


def _checked(name: str, known: MessageType | None, md5: str) -> MessageType | None:
    if known is not None and known.md5 != md5:
        raise WrongType(name, f"{known.name} md5 {known.md5}", f"md5 {md5}")
    return known
