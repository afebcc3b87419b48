"""Common parts of all exports: choice of topics, report of omissions, and cleanup after a failure."""

import contextlib
import fnmatch
import shutil
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from hostlink.errors import BadPayload, RecordingFailed, UnknownFormat
from hostlink.recording.channel import Channel
from hostlink.recording.definitions import why_unknown
from hostlink.recording.source import Source, open_source

MAX_NAMED = 10  # topics named in a refusal


@dataclass(slots=True)
class Exported:
    """Result of an export."""

    messages: int = 0
    left_out: dict[str, str] = field(default_factory=dict)  # topic -> what was omitted, and why
    damage: list[str] = field(default_factory=list)  # of the source
    _bad: Counter[str] = field(default_factory=Counter)

    def leave_out(self, topic: str, error: BadPayload) -> None:
        """Count a message that cannot be converted."""
        self._bad[topic] += 1
        if self._bad[topic] == 1:
            self.left_out[topic] = f"a message cannot be decoded: {error}"
        else:
            first = self.left_out[topic].partition(": ")[2]
            self.left_out[topic] = f"{self._bad[topic]} messages cannot be decoded, the first: {first}"


def chosen_channels(path: Path, patterns: Iterable[str], done: Exported, *, skips_unknown: bool) -> set[Channel]:
    """Return the channels to export: those whose topics match a pattern, or all without patterns.

    `skips_unknown`: channels that cannot be converted are noted in `done` and omitted.

    Raises:
        UnknownFormat: some channels cannot be converted; the text names them.
        RecordingFailed: no topic matches, or the recording cannot be read.
    """
    listed, channels = tuple(patterns), open_source(path).read_channels()
    chosen = {channel for channel in channels if not listed or matches(channel.topic, listed)}
    if listed and not chosen:
        topics = ", ".join(sorted({channel.topic for channel in channels}))
        raise RecordingFailed(f"{path} has no topic {' '.join(listed)}; available: {topics or 'none'}")
    unknown = {channel: why for channel in chosen if (why := why_unknown(channel))}
    named = {channel.topic: f"{channel.type_name}: {why}" for channel, why in unknown.items()}
    if unknown and not skips_unknown:
        lines = [f"{topic} ({why})" for topic, why in sorted(named.items())]
        more = f"; and {len(lines) - MAX_NAMED} more" if len(lines) > MAX_NAMED else ""
        raise UnknownFormat(
            f"{path}: cannot convert {'; '.join(lines[:MAX_NAMED])}{more}. "
            "Name the topics to export, or add --skip-unknown"
        )
    done.left_out |= named
    return chosen - unknown.keys()


def matches(topic: str, patterns: Iterable[str]) -> bool:
    """Whether the topic matches one of the patterns, which may contain *."""
    return any(fnmatch.fnmatchcase(topic, pattern) for pattern in patterns)


@contextlib.contextmanager
def new_output(path: Path) -> Iterator[None]:
    """Create a file or folder in the block. If the block fails, remove it.

    Raises:
        FileExistsError: the path exists.
    """
    if path.exists() or path.is_symlink():
        raise FileExistsError(17, "already exists", str(path))
    try:
        yield
    except BaseException:
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            with contextlib.suppress(OSError):  # of a failing disk; the first error is raised
                path.unlink(missing_ok=True)
        raise


def check_done(source: Source, done: Exported) -> None:
    """Check that at least one message was exported.

    Raises:
        RecordingFailed: nothing was exported; the text says why.
    """
    if not done.messages:
        why = "; ".join(f"{topic}: {reason}" for topic, reason in list(done.left_out.items())[:MAX_NAMED])
        raise RecordingFailed(f"{source.path} has no message to export{f': {why}' if why else ''}")
    done.damage = source.damage
