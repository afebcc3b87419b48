"""Sentences of `hostlink serve` on a terminal, instead of the log's lines of level info."""

import io
import json
import logging
from collections.abc import Iterator, Mapping
from typing import Any

import pytest
import structlog

from hostlink.cli.serve_command import Sentences
from hostlink.core.runtime import logs

WITHOUT_GATEWAY = {"event": "daemon.started", "tcp": "0.0.0.0:11411"}
STARTED = {"event": "daemon.started", "api": "http://127.0.0.1:9090", "tcp": "0.0.0.0:11411"}
APPEARED = {"event": "robot.appeared", "robot": "mule", "velocity": "/mule/cmd_vel"}


class _Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.fixture
def restored() -> Iterator[None]:
    before = structlog.get_config()
    yield
    structlog.configure(**before)
    logging.captureWarnings(capture=False)
    logs.listeners.clear()


def written(*events: dict[str, Any], stream: io.StringIO, level: str = "info", is_brief: bool = True) -> str:
    """Return what the log writes about the events, as `hostlink serve` configures it."""
    logs.configure(level=level, stream=stream, sentences=Sentences() if is_brief else None)
    for event in events:
        facts = {key: value for key, value in event.items() if key not in ("event", "level")}
        getattr(structlog.get_logger(), event.get("level", "info"))(event["event"], **facts)
    return stream.getvalue()


@pytest.mark.usefixtures("restored")
def test_a_terminal_shows_the_address_a_line_for_each_robot_and_what_needs_a_person() -> None:
    recorded: list[object] = []
    logs.listeners["test"] = lambda _, event: recorded.append(event["event"])
    text = written(
        STARTED,
        {"event": "link.opened", "link": 1},
        APPEARED,
        {"event": "drives.lost", "reason": "No space left on device", "level": "warning"},
        {"event": "daemon.stopping"},
        {"event": "daemon.stopped"},
        stream=_Terminal(),
    )
    page, boards, ready, lost, *ends = text.splitlines()
    assert page == "hostlink runs: http://127.0.0.1:9090  (open it in a browser)"
    assert boards == "boards connect to 0.0.0.0:11411; Ctrl-C ends hostlink"
    assert ready == "mule is ready; to drive it: hostlink teleop mule"
    assert "drives.lost" in lost
    assert ends == ["stopping the robots ...", "hostlink has ended"]
    assert "link.opened" in recorded  # a recording has every line


@pytest.mark.usefixtures("restored")
def test_a_file_and_a_level_that_is_asked_for_have_the_log_itself() -> None:
    assert json.loads(written(APPEARED, stream=io.StringIO()))["event"] == "robot.appeared"
    assert "robot.appeared" in written(APPEARED, stream=_Terminal(), is_brief=False)


@pytest.mark.parametrize(
    ("events", "wanted"),
    [
        ([{**STARTED, "udp": "0.0.0.0:11413"}], "boards connect to 0.0.0.0:11411, over UDP to 0.0.0.0:11413;"),
        ([{**STARTED, "api": "https://10.0.0.5:9443"}, APPEARED], "hostlink teleop mule --url https://10.0.0.5:9443"),
        ([WITHOUT_GATEWAY], "hostlink runs, without an address for programs\nboards connect to 0.0.0.0:11411; Ctrl-C"),
        ([STARTED, {**APPEARED, "robot": "a;reboot"}], "to drive it: hostlink teleop 'a;reboot'"),
        ([{**APPEARED, "velocity": None}], "mule is connected; it takes no velocity"),
    ],
)
def test_a_sentence_has_the_facts_of_its_event(events: list[Mapping[str, object]], wanted: str) -> None:
    sentences = Sentences()
    *_, last = [sentences(event) for event in events]
    assert wanted in (last or "")


def test_other_events_have_no_sentence() -> None:
    assert Sentences()({"event": "link.opened"}) is None


@pytest.mark.usefixtures("restored")
def test_a_terminal_shows_a_missing_serial_port_with_the_next_step_and_that_it_is_waited_for() -> None:
    facts = {"port": "/dev/ttyUSB7", "reason": "/dev/ttyUSB7: no such port", "next_step": "plug the board in"}
    text = written(
        {"event": "serial.waiting", "level": "warning", **facts},
        STARTED | {"serial": ["/dev/ttyACM0", "/dev/ttyACM1"], "missing": ["/dev/ttyUSB7"]},
        STARTED | {"udp": "0.0.0.0:11412", "serial": ["/dev/ttyACM0"], "missing": []},
        stream=_Terminal(),
    )
    assert text.splitlines() == [
        "/dev/ttyUSB7 cannot be used: no such port",
        "  next: plug the board in",
        "hostlink runs: http://127.0.0.1:9090  (open it in a browser)",
        "boards connect to 0.0.0.0:11411, and are at /dev/ttyACM0, /dev/ttyACM1; waiting for /dev/ttyUSB7; "
        "Ctrl-C ends hostlink",
        "hostlink runs: http://127.0.0.1:9090  (open it in a browser)",
        "boards connect to 0.0.0.0:11411, over UDP to 0.0.0.0:11412, and are at /dev/ttyACM0; Ctrl-C ends hostlink",
    ]
