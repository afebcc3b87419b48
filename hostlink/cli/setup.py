"""The commands for the configuration: `setup` asks ten questions and writes a file, `reload` has the daemon read it."""

import ipaddress
import json
import json as json_text
import os
import secrets
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from hostlink.cli.arguments import Json, Token, Url
from hostlink.cli.connecting import ask
from hostlink.cli.files import check_new_file, replacing
from hostlink.cli.output import write, write_error
from hostlink.cli.settings import load
from hostlink.client import DEFAULT_URL
from hostlink.core.config import MAX_PORT
from hostlink.errors import HostlinkError

# -- questions --------------------------------------------------------------------------------------------------------

Answers = Mapping[str, str]
Complaint = Callable[[str], str]  # what to answer with; empty if the answer is right

WAYS = ("wifi", "usb", "both")
REACHES = ("computer", "network")
MAX_BAUD = 4_000_000
LEAST_NUMBER = 0.01  # m, m/s, m/s2

PLACES = (
    "serial/by-id/*",
    "ttyACM*",
    "ttyUSB*",
)  # names in the first one do not change when a port is plugged in again
OWNER_ONLY = 0o600  # the file contains a token


@dataclass(frozen=True, slots=True)
class Question:
    """Question with its default, the check of an answer, and the condition under which it is asked."""

    key: str
    text: str
    default: str
    complaint: Complaint
    is_asked: Callable[[Answers], bool] = lambda _: True


def questions(serial_ports: Sequence[str]) -> list[Question]:
    """Return all ten questions. `serial_ports` are those of this computer."""
    seen = f" (this computer has: {', '.join(serial_ports)})" if serial_ports else " (none is plugged in now)"
    port = serial_ports[0] if serial_ports else "/dev/ttyACM0"
    path = _described("a path that begins with /dev/, for example /dev/ttyACM0", lambda answer: answer.startswith("/"))
    name = _described("letters, digits and _, a letter first", lambda answer: answer == "-" or _is_name(answer))
    return [
        Question("way", "How do robots connect: wifi, usb or both?", "wifi", _one_of(WAYS)),
        Question(
            "network",
            "From which network may robots connect, for example 192.168.4.0/24? Empty: any",
            "",
            _network,
            _has_wifi,
        ),
        Question("device_port", "TCP port for robots?", "11411", _whole(1, MAX_PORT), _has_wifi),
        Question("serial", f"Which serial port{seen}?", port, path, _has_usb),
        Question("baud", "Its baud rate?", "57600", _whole(300, MAX_BAUD), _has_usb),
        Question(
            "robot",
            "The robot's name, as in its firmware? The next questions are its limits; -: no limits",
            "robot_0",
            name,
        ),
        Question(
            "separation_m",
            "Distance between the two driven wheels in m? Empty: unknown, or another kind of drive",
            "",
            _number(10.0, may_be_empty=True),
            _has_robot,
        ),
        Question("speed_m_s", "The highest speed of the robot, in m/s?", "0.5", _number(20.0), _has_robot),
        Question(
            "deceleration_m_s2",
            "The strongest braking, in m/s2? Empty: no limit",
            "",
            _number(100.0, may_be_empty=True),
            _has_robot,
        ),
        Question(
            "reach",
            "Who may use the page and the API: this computer, or the network (with a token)?",
            "computer",
            _one_of(REACHES),
        ),
    ]


def configuration(answers: Answers, *, token: str) -> str:
    """Return the configuration as TOML; `token` is for an API that the network reaches."""
    parts = [
        "# Written by `hostlink setup`; all other settings: hostlink serve --example config",
        *_tcp(answers),
        *_serial(answers),
        *_api(answers, token),
        *_robot(answers),
    ]
    return "\n".join(parts) + "\n"


def _tcp(answers: Answers) -> list[str]:
    if not _has_wifi(answers):
        return ["", "[tcp]", 'host = "127.0.0.1"  # robots connect by USB only']
    allow = [f"allow = [{_toml(answers['network'])}]"] if answers["network"] else []
    return ["", "[tcp]", f"port = {answers['device_port']}", *allow]


def _serial(answers: Answers) -> list[str]:
    if not _has_usb(answers):
        return []
    return ["", "[[serial]]", f"path = {_toml(answers['serial'])}", f"baud = {answers['baud']}"]


def _api(answers: Answers, token: str) -> list[str]:
    if answers["reach"] == "computer":
        return []
    return [
        "",
        "[api]",
        'host = "0.0.0.0"',
        "",
        "[[api.tokens]]",
        'name = "driver"',
        'role = "drive"',
        f'token = "{token}"',
    ]


def _robot(answers: Answers) -> list[str]:
    if not _has_robot(answers):
        return []
    settings = {
        "max_linear_m_s": answers["speed_m_s"],
        "wheel_separation_m": answers["separation_m"],
        "max_linear_deceleration_m_s2": answers["deceleration_m_s2"],
    }
    if answers["separation_m"]:
        settings = {"kinematics": _toml("differential"), **settings}
    if answers["way"] == "usb":
        settings = {"address": _toml(answers["serial"]), **settings}
    lines = [f"{key} = {_toml_number(value)}" for key, value in settings.items() if value]
    return ["", f"[robots.{answers['robot']}]", *lines]


def _toml_number(value: str) -> str:
    return value if value.startswith('"') else repr(float(value))


def _has_wifi(answers: Answers) -> bool:
    return answers["way"] != "usb"


def _has_usb(answers: Answers) -> bool:
    return answers["way"] != "wifi"


def _has_robot(answers: Answers) -> bool:
    return answers["robot"] != "-"


def _is_name(text: str) -> bool:
    return text.isascii() and text.isidentifier() and not text.startswith("_")


def _described(wanted: str, is_right: Callable[[str], bool]) -> Complaint:
    """Return the check of an answer, which complains with what is wanted."""
    return lambda answer: "" if is_right(answer) else wanted


def _one_of(known: Sequence[str]) -> Complaint:
    return _described(f"one of {', '.join(known)}", lambda answer: answer in known)


def _network(answer: str) -> str:
    try:
        if answer:
            ipaddress.ip_network(answer, strict=False)
    except ValueError:
        return "an address or a network, as 192.168.4.7 or 192.168.4.0/24"
    return ""


def _whole(least: int, most: int) -> Complaint:
    return _described(
        f"a whole number from {least} to {most}",
        lambda answer: answer.isascii() and answer.isdecimal() and len(answer) < 9 and least <= int(answer) <= most,  # noqa: PLR2004
    )


def _number(most: float, *, may_be_empty: bool = False) -> Complaint:
    def is_right(answer: str) -> bool:
        try:
            return (may_be_empty and not answer) or LEAST_NUMBER <= float(answer) <= most
        except ValueError:
            return False

    return _described(f"a number from {LEAST_NUMBER:g} to {most:g}", is_right)


def _toml(text: str) -> str:
    """Quote a text for TOML: JSON's escapes, except DEL and characters beyond 16 bits."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


# -- setup ------------------------------------------------------------------------------------------------------------


def setup(
    file: Annotated[Path, typer.Argument(help="The file to write.")] = Path("hostlink.toml"),
    *,
    yes: Annotated[bool, typer.Option("--yes", help="Take the default answer to every question, for scripts.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace an existing file.")] = False,
) -> None:
    """Ask ten questions and write a configuration. An empty answer means the default. Ctrl-C writes no file."""
    check_new_file("setup", file, is_forced=force, example="hostlink.toml")
    answers: dict[str, str] = {}
    asked = questions(list(_serial_ports()))
    for number, question in enumerate(asked, 1):
        is_skipped = yes or not question.is_asked(answers)
        answers[question.key] = question.default if is_skipped else _ask(question, f"{number}/{len(asked)}")
    _write(file, configuration(answers, token=secrets.token_urlsafe(24)))
    write(f"{file} is written. Next:", f"  hostlink serve --check-config {file}", f"  hostlink serve --config {file}")
    if answers["reach"] == "network":
        write(
            "Page and API need the token in that file.",
            "Without a certificate under [api] others can read it on the network.",
        )


def _serial_ports() -> Iterator[str]:
    for place in PLACES:
        yield from map(str, sorted(Path("/dev").glob(place)))


def _ask(question: Question, place: str) -> str:
    """Ask until an answer is accepted.

    Raises:
        HostlinkError: standard input ends.
    """
    shown = f" [{question.default}]" if question.default else ""
    while True:
        try:
            answer = input(f"{place}  {question.text}{shown} ").strip() or question.default
        except EOFError:
            write("")  # the question has no end of a line
            raise HostlinkError(
                f"standard input ended at question {place}, and nothing was written; answer all questions, or use --yes"
            ) from None
        complaint = question.complaint(answer)
        if not complaint:
            return answer
        write_error(f"     answer with {complaint}")


def _write(file: Path, text: str) -> None:
    """Write the whole file or nothing; the daemon accepts what is written.

    Raises:
        ConfigError: the file cannot be written.
    """
    with replacing("setup", file) as beside:
        descriptor = os.open(beside, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, OWNER_ONLY)
        with os.fdopen(descriptor, "w", encoding="utf-8") as out:
            out.write(text)
        load(beside)


# -- reload -----------------------------------------------------------------------------------------------------------


def reload(*, url: Url = DEFAULT_URL, token: Token = None, json: Json = False) -> None:
    """Let the daemon read its configuration again: names and limits of robots, tokens and origins.

    A wrong setting leaves all of them unchanged. Settings that need a restart are listed.
    """
    reloaded = ask(url, token, lambda host: host.post("/api/reload"))
    write(*([json_text.dumps(reloaded)] if json else _lines(reloaded)))


def _lines(reloaded: dict[str, Any]) -> list[str]:
    lines = [f"changed: {name}" for name in reloaded["changed"]]
    lines += [f"renamed: {old} is now {new}" for old, new in reloaded["renamed"].items()]
    lines += [f"needs a restart: {name}" for name in reloaded["needs_restart"]]
    return lines or ["nothing has changed"]
