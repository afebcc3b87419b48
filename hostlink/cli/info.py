"""`hostlink info`: what is in a recording; or who publishes and subscribes, of a topic, a node or a service."""

from pathlib import Path
from typing import Annotated

import typer

from hostlink.cli.arguments import Json, Token, Url
from hostlink.cli.completion import graph_names
from hostlink.cli.graph_info import show_name
from hostlink.cli.recording_info import show_recording
from hostlink.client import DEFAULT_URL

_RECORDING = ".mcap"
_BAG_METADATA = "metadata.yaml"  # of a folder of rosbag2


def command(
    name: Annotated[
        str,
        typer.Argument(
            metavar="NAME|FILE",
            help="A topic, a node or a service; or a recording, as `hostlink record` made it.",
            show_default=False,
            autocompletion=graph_names,
        ),
    ],
    *,
    url: Url = DEFAULT_URL,
    token: Token = None,
    json: Json = False,
) -> None:
    """Show who publishes and subscribes, of a topic, a node or a service; or what is in a recording.

    Of a recording: topics, types, rates, what of the file is damaged.
    """
    if is_recording(name):
        show_recording(Path(name), as_json=json)
    else:
        show_name(name, url, token, as_json=json)


def is_recording(name: str) -> bool:
    """Whether it is meant as a file or a folder of rosbag2; what can be no file's name is one of the graph."""
    try:
        return name.endswith(_RECORDING) or Path(name).is_file() or (Path(name) / _BAG_METADATA).is_file()
    except (OSError, ValueError):  # too long, or with a zero byte
        return False
