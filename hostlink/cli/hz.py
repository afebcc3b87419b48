"""`hostlink hz`: the rate of a topic, by the times at which its messages reach the daemon."""

from typing import Annotated, Any

import typer

from hostlink.cli.arguments import JsonLines, Seconds, Token, TopicName, Url
from hostlink.cli.following import Followed, measure
from hostlink.cli.measuring import WINDOW, Measured, duration
from hostlink.client import DEFAULT_URL


def command(
    topic: TopicName,
    *,
    window: Annotated[int, typer.Option(min=2, help="Of the last so many messages.")] = WINDOW,
    seconds: Seconds = 0.0,
    url: Url = DEFAULT_URL,
    token: Token = None,
    json: JsonLines = False,
) -> None:
    """Measure the rate of a topic; a line each second until Ctrl-C."""
    followed = Followed(topic=topic, url=url, token=token, seconds=seconds, as_json=json)
    measured = Measured(window)
    measure(
        followed,
        measured,
        lambda message: measured.add(message.stamp_ns / 1e9),
        lambda: _view(measured),
        lambda: _line(measured),
    )


def _view(measured: Measured) -> dict[str, Any]:
    between_s = measured.between_s
    if between_s is None:
        return {"rate_hz": None}
    seconds = {"min_s": between_s.least, "max_s": between_s.most, "std_dev_s": between_s.deviation}
    rounded = {key: round(value, 6) for key, value in seconds.items()}
    return {"rate_hz": round(measured.rate_hz, 4), "window": between_s.count + 1} | rounded


def _line(measured: Measured) -> str:
    between_s = measured.between_s
    if between_s is None:
        return "one message"
    return (
        f"{measured.rate_hz:8.2f} Hz   every {duration(between_s.mean)} (min {duration(between_s.least)}, "
        f"max {duration(between_s.most)}, std dev {duration(between_s.deviation)}) of {between_s.count + 1} messages"
    )
