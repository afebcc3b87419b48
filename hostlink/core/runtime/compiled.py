"""Options of classes for mypyc (`make compiled`). They do nothing where the sources run as they are."""

from collections.abc import Callable
from typing import TYPE_CHECKING, TypeVar

__all__ = ["mypyc_attr"]

if TYPE_CHECKING:
    from mypy_extensions import mypyc_attr
else:
    C = TypeVar("C", bound=type)

    def mypyc_attr(*_: str, **__: bool) -> Callable[[C], C]:
        """Return a decorator that returns the class."""
        return lambda decorated: decorated
