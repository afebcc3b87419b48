"""Which types of the catalogue a library gets: those that are named, and all that stand in them. Pure."""

from collections.abc import Collection, Iterable
from dataclasses import dataclass
from typing import Final, TypeVar

from hostlink.board.identifiers import class_name
from hostlink.errors import ConfigError
from hostlink.messages.catalog import Catalog
from hostlink.messages.message_type import MessageType, ServiceType

RESERVED_PACKAGES: Final = frozenset({"ros", "std", "hostlink"})  # C++ namespaces of others, and of the library

T = TypeVar("T", MessageType, ServiceType)


@dataclass(frozen=True, slots=True)
class Selection:
    """Types, sorted by name; every type that stands in another one is there too."""

    messages: tuple[MessageType, ...]
    services: tuple[ServiceType, ...]

    @property
    def names(self) -> list[str]:
        """Of all of them."""
        return [*(message.name for message in self.messages), *(service.name for service in self.services)]

    @property
    def packages(self) -> list[str]:
        """The packages of which something is there."""
        return sorted({name.partition("/")[0] for name in self.names})


def known_names(catalog: Catalog) -> list[str]:
    """Packages, and types with their packages: what can be selected."""
    types = {*catalog.message_names(), *catalog.service_names()}
    return sorted(types | {name.partition("/")[0] for name in types})


def select(catalog: Catalog, wanted: Iterable[str] | None) -> Selection:
    """The types of the packages and the types that are `wanted`, with all that stand in them; None: of all packages.

    Raises:
        ConfigError: a definition is wrong, or a name cannot be one of C++ beside the others.
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
    return Selection(_sorted(messages), _sorted(services))


def _is_chosen(name: str, chosen: frozenset[str] | None) -> bool:
    return chosen is None or name in chosen or name.partition("/")[0] in chosen


def _add(message: MessageType, messages: dict[str, MessageType]) -> None:
    if message.name not in messages:
        messages[message.name] = message
        for nested in message.nested.values():
            _add(nested, messages)


def _check_names(messages: Collection[str], services: Collection[str]) -> None:
    """A header has the name of its type, and some file systems know no capital letters."""
    for name in (*messages, *services):
        if name.partition("/")[0] in RESERVED_PACKAGES:
            raise ConfigError(name, "its package has the name of a namespace of the library; rename the package")
    classes = set(messages)
    headers = {name.lower(): name for name in sorted(classes, reverse=True)}
    for service in services:
        if both := classes & {service, f"{service}Request", f"{service}Response"}:
            raise ConfigError(service, f"its header needs the name of the message {min(both)}; rename one of them")
        headers.setdefault(service.lower(), service)
    names: dict[str, str] = {}
    for name in (*messages, *services):
        if (other := names.setdefault(class_name(name), name)) != name:
            raise ConfigError(name, f"its C++ name is {class_name(name)[2:]}, as that of {other}; rename one of them")
        if headers[name.lower()] != name:
            raise ConfigError(
                name, f"differs from {headers[name.lower()]} by capital letters alone; rename one of them"
            )


def _sorted(types: dict[str, T]) -> tuple[T, ...]:
    return tuple(types[name] for name in sorted(types))
