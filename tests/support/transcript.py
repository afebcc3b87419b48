"""A transcript in a document: commands after `$ `, keys as `^C`, and what is shown; `...` may be anything."""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field

BLOCK = re.compile(r"^```console\n(.*?)^```$", re.MULTILINE | re.DOTALL)


@dataclass
class Typed:
    """One command, what must show, and the keys that end it."""

    command: str
    shown: list[str] = field(default_factory=list)
    keys: list[str] = field(default_factory=list)

    def is_shown(self, text: str) -> bool:
        """Whether every line of it is there, in this order."""
        pattern = ".*?".join(re.escape(part) for part in re.split(r"(?:\.\.\.|\s)+", "\n".join(self.shown)) if part)
        return re.search(pattern, text, re.DOTALL) is not None


def transcript(document: str) -> Iterator[Typed]:
    """The commands of a document, in their order."""
    for block in BLOCK.findall(document):
        typed: Typed | None = None
        for line in block.splitlines():
            if line.startswith("$ "):
                if typed is not None:
                    yield typed
                typed = Typed(line.removeprefix("$ "))
            elif typed is not None:
                (typed.keys if line.startswith("^") else typed.shown).append(line)
        if typed is not None:
            yield typed
