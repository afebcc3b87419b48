"""`hostlink bw`: the bandwidth of a topic: its messages as they are serialised, without rosserial's 8 bytes a frame."""

from typing import Any

from hostlink.cli.measuring import Measured, size
from hostlink.cli.topic_figures import Figures, command_of

WINDOW = 100  # messages, as rostopic has it


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


command = command_of(
    Figures(
        text="Measure the bandwidth of a topic; a line each second until Ctrl-C.",
        view=_view,
        line=_line,
        figure=lambda message: len(message.payload),
        window=WINDOW,
    )
)
