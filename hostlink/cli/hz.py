"""`hostlink hz`: the rate of a topic, by the times at which its messages reach the daemon."""

from typing import Any

from hostlink.cli.measuring import Measured, duration
from hostlink.cli.topic_figures import Figures, command_of


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


command = command_of(
    Figures(text="Measure the rate of a topic; a line each second until Ctrl-C.", view=_view, line=_line)
)
