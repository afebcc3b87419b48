"""`hostlink info`: what is in a recording."""

from pathlib import Path
from typing import Annotated

import typer

from hostlink.cli.recording_info import show_recording


def command(
    file: Annotated[Path, typer.Argument(help="As `hostlink record` made it.", show_default=False)],
    *,
    as_json: Annotated[bool, typer.Option("--json", help="JSON, for programs.")] = False,
) -> None:
    """Show what is in a recording: topics, types, rates, what of the file is damaged."""
    show_recording(file, as_json=as_json)
