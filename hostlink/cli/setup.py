"""`hostlink setup`: asks ten questions, and writes a configuration."""

import os
import secrets
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import typer

from hostlink.cli.files import check_new_file, replacing
from hostlink.cli.output import write, write_error
from hostlink.cli.setup_plan import Question, configuration, questions
from hostlink.config import load
from hostlink.errors import HostlinkError

PLACES = ("serial/by-id/*", "ttyACM*", "ttyUSB*")  # the first has names that stay
OWNER_ONLY = 0o600  # a token stands in it


def command(
    file: Annotated[Path, typer.Argument(help="What is written.")] = Path("hostlink.toml"),
    *,
    yes: Annotated[bool, typer.Option("--yes", help="The usual answer to every question.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Write over a file that is there.")] = False,
) -> None:
    """Ask ten questions and write a configuration. An empty answer means what is in brackets; Ctrl-C writes nothing."""
    check_new_file("FILE", file, is_forced=force, example="hostlink.toml")
    answers: dict[str, str] = {}
    asked = questions(list(_serial_ports()))
    for number, question in enumerate(asked, 1):
        is_skipped = yes or not question.is_asked(answers)
        answers[question.key] = question.default if is_skipped else _ask(question, f"{number}/{len(asked)}")
    _write(file, configuration(answers, token=secrets.token_urlsafe(24)))
    write(f"{file} is written. Next:", f"  hostlink serve --check-config {file}", f"  hostlink serve --config {file}")
    if answers["reach"] == "network":
        write("Page and API want the token that stands in it; without [api] certificate it can be read on the network.")


def _serial_ports() -> Iterator[str]:
    for place in PLACES:
        yield from map(str, sorted(Path("/dev").glob(place)))


def _ask(question: Question, place: str) -> str:
    """The first answer that is none of those that are refused.

    Raises:
        HostlinkError: standard input ends.
    """
    shown = f" [{question.default}]" if question.default else ""
    while True:
        try:
            answer = input(f"{place}  {question.text}{shown} ").strip() or question.default
        except EOFError:
            write("")  # the question has no end of a line
            raise HostlinkError(f"no answer to question {place}; nothing is written") from None
        complaint = question.complaint(answer)
        if not complaint:
            return answer
        write_error(f"     answer with {complaint}")


def _write(file: Path, text: str) -> None:
    """Complete or not at all; what is written can be served.

    Raises:
        ConfigError: it cannot be written.
    """
    with replacing("FILE", file) as beside:
        descriptor = os.open(beside, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, OWNER_ONLY)
        with os.fdopen(descriptor, "w", encoding="utf-8") as out:
            out.write(text)
        load(beside)
