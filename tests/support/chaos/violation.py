"""Violation: a promise that was broken, as data."""

from dataclasses import dataclass, field


@dataclass(frozen=True)
class Violation:
    """`figure` is what was measured, `limit` what is allowed; for a promise without a number both are 0."""

    promise: str
    figure: float
    limit: float
    detail: str = ""
    at_s: float = 0.0  # monotonic
    step: int = 0
    under_way: tuple[str, ...] = field(default=())

    def __str__(self) -> str:
        numbers = f": {self.figure:.4g}, the limit is {self.limit:.4g}" if self.figure or self.limit else ""
        return f"step {self.step}: {self.promise}{numbers}{'; ' if self.detail else ''}{self.detail}"
