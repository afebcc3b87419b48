"""The documented commands that only read and end at once, run against a daemon with a robot."""

import pytest

from tests.support.daemon import daemon
from tests.support.documented import documented
from tests.support.process import run
from tests.support.simulated import simulated_robot
from tests.support.waiting import expect

pytestmark = pytest.mark.quiet

READERS = {"clients", "doctor", "incidents", "links", "robots", "services", "stop", "topics"}
SHORT = {"5": "1"}  # of --seconds


def quick_commands() -> set[tuple[str, ...]]:
    """Return the documented commands that need nothing but a daemon, and end by themselves."""
    complete = {each.words for each in documented() if each.is_complete or len(each.words) == 1}
    plain = {words for words in complete if not any(word.isupper() for word in words)}
    readers = {words for words in plain if words[0] in READERS and "--save" not in words and "-o" not in words}
    once = {words for words in plain if words[0] in ("echo", "hz", "find") and {"--once", "--seconds"} & {*words}}
    return readers | once | {("record", "--list"), ("serve", "--example", "config"), ("--version",)} & plain


async def test_documented_commands_that_end_by_themselves_succeed() -> None:
    async with daemon(has_black_box=True) as host, simulated_robot(host.tcp):
        await expect(lambda: host.hub.robots.find("robot_0").link is not None)
        commands = sorted(quick_commands())
        assert len(commands) >= 12
        for command in commands:
            words = tuple(SHORT.get(word, word) for word in command)
            status, out, errors = await run(*words, environment={"HOSTLINK_URL": host.url})
            assert (status, "Traceback" in errors) == (0, False), f"{words}: {errors}"
            assert out, words
