"""FileThread: queued messages are bounded, dropped ones are counted, and nothing else is lost."""

import asyncio
import threading
from pathlib import Path
from typing import Any

import pytest

from hostlink.components.recorder import mcap_writer
from hostlink.components.recorder.channel import EVENTS, Channel
from hostlink.components.recorder.mcap_writer import (
    MAX_CHANNELS,
    MAX_EXPECTED,
    MAX_WAITING_BYTES,
    MESSAGE_BYTES,
    FileThread,
)
from hostlink.components.recorder.reader import McapReader
from tests.support.stopwatch import Stopwatch
from tests.support.waiting import expect

WHOLE: dict[str, Any] = {"max_file_bytes": 10**12, "max_file_s": 1e9}


def count(folder: Path) -> int:
    return sum(1 for path in folder.iterdir() for _ in McapReader(path).messages())


@pytest.mark.slow
async def test_ten_seconds_of_a_flood_at_once_lose_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The end waits as long as the disk accepts data."""
    monkeypatch.setattr(mcap_writer, "CLOSE_TIMEOUT_S", 0.25)
    thread = FileThread(
        lambda number: tmp_path / f"{number}.mcap", **WHOLE, loop=asyncio.get_running_loop(), metadata={}
    )
    for number in range(50_000):
        thread.put(EVENTS, number, b"x" * 24)
    await thread.aclose()
    assert (thread.dropped, thread.messages, thread.failure) == (0, 50_000, None)
    assert count(tmp_path) == 50_000


class StandingDisk:
    """Disk on which the second file cannot be created before `may_go_on`."""

    def __init__(self) -> None:
        self.is_standing, self.may_go_on = threading.Event(), threading.Event()
        self._files = 0

    def make_file(self) -> None:
        self._files += 1
        if self._files == 2:
            self.is_standing.set()
            self.may_go_on.wait(30.0)

    async def recorder(self, folder: Path) -> FileThread:
        """Create the writer, which waits for the disk."""
        thread = FileThread(
            lambda number: folder / f"{number}.mcap",
            max_file_bytes=1,
            max_file_s=1e9,
            loop=asyncio.get_running_loop(),
            metadata={},
            on_file=self.make_file,
        )
        thread.put(EVENTS, 0, b"first")
        await expect(self.is_standing.is_set)
        return thread


def test_blocked_disk_at_the_end_is_not_awaited(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The disk may recover after the loop has ended."""
    monkeypatch.setattr(mcap_writer, "CLOSE_TIMEOUT_S", 0.1)
    disk = StandingDisk()

    async def record() -> FileThread:
        thread = await disk.recorder(tmp_path)
        thread.put(EVENTS, 1, b"second")
        await thread.aclose()
        return thread

    thread = asyncio.run(record())
    assert thread.failure == "the disk accepted no data for 0.1 s"
    disk.may_go_on.set()
    for each in threading.enumerate():
        if each.name == "recording":
            each.join()  # an error in the thread fails the test
    assert count(tmp_path) == 2


async def test_blocked_disk_drops_messages_above_the_bound_without_delay(tmp_path: Path) -> None:
    disk = StandingDisk()
    thread = await disk.recorder(tmp_path)
    payload, watch = bytes(64 * 1024 - MESSAGE_BYTES), Stopwatch()
    for number in range(300):
        thread.put(EVENTS, number, payload)
    assert watch.seconds < 1.0
    assert thread.dropped == 300 - MAX_WAITING_BYTES // (64 * 1024)
    disk.may_go_on.set()
    await thread.aclose()
    assert thread.failure is None
    assert thread.messages + thread.dropped == 301
    assert count(tmp_path) == thread.messages


@pytest.mark.slow
async def test_more_channels_than_a_file_can_have_do_not_end_the_recording(tmp_path: Path) -> None:
    """A program may advertise any number of topics, but a channel number in the format has 16 bits."""
    thread = FileThread(
        lambda number: tmp_path / f"{number}.mcap", **WHOLE, loop=asyncio.get_running_loop(), metadata={}
    )
    thread.put(EVENTS, 1, b"{}")
    for number in range(MAX_CHANNELS + 100):
        channel = Channel(f"/{number}", "json", "", "")
        thread.announce(channel)
        thread.put(channel, number, b"")
    thread.put(EVENTS, 2, b"{}")
    await expect(lambda: thread.messages + thread.dropped == MAX_CHANNELS + 102)
    await thread.aclose()
    assert thread.failure is None
    assert thread.messages == MAX_CHANNELS + 1
    assert thread.has_no_room
    assert [
        message.stamp_ns for message in McapReader(tmp_path / "0.mcap").messages() if message.channel == EVENTS
    ] == [
        1,
        2,
    ]


async def test_file_without_free_channel_numbers_is_followed_by_one_with_the_newest_channels(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A program that makes a topic a minute has made 8192 in a week."""
    monkeypatch.setattr(mcap_writer, "FULL_FILE_S", 0.0)
    thread = FileThread(
        lambda number: tmp_path / f"{number}.mcap", **WHOLE, loop=asyncio.get_running_loop(), metadata={}
    )
    channels = [Channel(f"/{number}", "json", "", "") for number in range(MAX_CHANNELS + 100)]
    for number, channel in enumerate(channels):
        thread.announce(channel)
        thread.put(channel, number, b"")
    await thread.aclose()
    assert (thread.messages, thread.dropped, thread.has_no_room) == (len(channels), 0, False)
    later = McapReader(tmp_path / "1.mcap")
    assert [message.channel for message in later.messages()] == channels[MAX_CHANNELS:]
    assert set(channels[-MAX_EXPECTED:]) <= set(later.channels)
