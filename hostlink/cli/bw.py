"""`hostlink bw`: the bandwidth of a topic: its messages as they are serialised, without rosserial's 8 bytes a frame."""

from typing import Annotated, Any

import typer

from hostlink.cli.arguments import JsonLines, Seconds, Token, TopicName, Url
from hostlink.cli.following import Followed, measure
from hostlink.cli.measuring import Measured, size
from hostlink.client import DEFAULT_URL

WINDOW = 100  # messages, as rostopic has it


def command(
    topic: TopicName,
    *,
    window: Annotated[int, typer.Option(min=2, help="Of the last so many messages.")] = WINDOW,
    seconds: Seconds = 0.0,
    url: Url = DEFAULT_URL,
    token: Token = None,
    json: JsonLines = False,
) -> None:
    """Measure the bandwidth of a topic; a line each second until Ctrl-C."""
    followed = Followed(topic=topic, url=url, token=token, seconds=seconds, as_json=json)
    measured = Measured(window)
    measure(
        followed,
        measured,
        lambda message: measured.add(message.stamp_ns / 1e9, len(message.payload)),
        lambda: _view(measured),
        lambda: _line(measured),
    )


def _view(measured: Measured) -> dict[str, Any]:
    bytes_ = measured.figures
    if bytes_ is None:
        return {"bytes_s": None}
    return {
        "bytes_s": round(measured.rate_hz * bytes_.mean, 1),
        "mean_bytes": round(bytes_.mean, 1),
        "min_bytes": int(bytes_.least),
        "max_bytes": int(bytes_.most),
        "window": bytes_.count,
    }


def _line(measured: Measured) -> str:
    bytes_ = measured.figures
    if bytes_ is None or measured.between_s is None:
        return "one message"
    return (
        f"{size(measured.rate_hz * bytes_.mean)}/s   {measured.rate_hz:.1f} messages a second of {size(bytes_.mean)} "
        f"(min {size(bytes_.least)}, max {size(bytes_.most)})"
    )
